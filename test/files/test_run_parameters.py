"""The set-point, joint and gains of a foreign bag, from what its nodes tell."""

import pytest

from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.parameter_event import encode_parameter_event, TYPE
from impulse_control_ros.files.recording import read_bag
from test.files.test_bag import START, STEP
from test.tools.bags import recorded_elsewhere, STATES, TYPES, WALL

EVENTS = '/parameter_events'
COUNT = 40


def states(joint='axis', joints=(), topic='/joint_states'):
    layout = JointStateLayout(joint, 'base', joints=joints)
    return [
        (WALL + 1000 * k, topic, TYPES[STATES], layout.encode(1, k * STEP, 0.5, 0.0, 0.0))
        for k in range(COUNT)
    ]


def event(before, node, values, changed=(), topic=EVENTS):
    """Return an event that was recorded before the state ``before``, stamped by another clock."""
    changed = {name: values[name] for name in changed}
    new = {} if changed else values
    return (
        WALL + 1000 * before - 500,
        topic,
        TYPE,
        encode_parameter_event(7, 0, node, new, changed),
    )


def read(tmp_path, *messages, **choice):
    return read_bag(recorded_elsewhere(tmp_path / 'bag', sorted(messages)), **choice)


def test_set_point_joint_and_gains_are_those_of_parameter_events_with_their_changes(tmp_path):
    values = {'x_r': 0.2, 'K': 12.0, 'joint_name': 'lift'}
    recording = read(
        tmp_path,
        *states('lift', ('axis', 'lift')),
        event(0, '/robot/driver', {'joint_name': 'axis', 'rate': 100}),
        event(0, '/robot/law', values),
        event(10, '/robot/law', {'x_r': 0.3}, ['x_r']),
        event(20, '/robot/law', {'K': 9.0}, ['K']),
    )
    assert recording.states['position'].tolist() == [0.5] * COUNT
    assert recording.set_point.tolist() == [0.2] * 10 + [0.3] * (COUNT - 10)
    assert recording.parameters == {'/robot/law': values}
    assert [(change.stamp, change.changed) for change in recording.changes] == [
        (START + 10 * STEP, {'x_r': 0.3}),
        (START + 20 * STEP, {'K': 9.0}),
    ]
    assert recording.settings[-1].values == {'x_r': 0.3, 'K': 9.0, 'D': 0.0, 'effort_limit': 0.0}


def test_parameters_that_are_declared_one_by_one_are_those_of_one_start(tmp_path):
    recording = read(
        tmp_path,
        *states(),
        event(0, '/law', {'use_sim_time': True}),
        event(0, '/law', {'K': 12.0}),
        event(0, '/law', {'x_r': 0.2}),
    )
    assert recording.parameters == {'/law': {'use_sim_time': True, 'K': 12.0, 'x_r': 0.2}}
    assert recording.changes == []


def test_what_run_parameters_tells_counts_before_parameter_events(tmp_path):
    recording = read(
        tmp_path,
        *states(),
        event(0, '/law', {'x_r': 0.1}),
        event(0, '/law', {'x_r': 0.2}, topic='/run_parameters'),
    )
    assert recording.set_point.tolist() == [0.2] * COUNT


def test_a_set_point_before_its_first_change_that_was_recorded_is_missing(tmp_path):
    recording = read(tmp_path, *states(), event(10, '/law', {'x_r': 0.3}, ['x_r']))
    assert recording.set_point.tolist() == [0.0] * 10 + [0.3] * (COUNT - 10)
    assert 'the set-point before its change at 1.001000000 s is missing' in recording.lacks


@pytest.mark.parametrize('namespace', ['', '/left', '/right'])
def test_of_two_nodes_with_a_set_point_that_in_the_namespace_counts(tmp_path, namespace):
    recording = read(
        tmp_path,
        *states(topic=f'{namespace}/joint_states'),
        event(0, '/left/law', {'x_r': 0.1}),
        event(0, '/right/law', {'x_r': 0.2}),
    )
    told = 'several nodes have a set-point x_r, none is used: /left/law, /right/law'
    assert (told in recording.lacks) == (namespace == '')
    assert recording.set_point[0] == {'': 0.0, '/left': 0.1, '/right': 0.2}[namespace]


def test_with_the_time_of_recording_parameters_act_from_the_state_that_follows(tmp_path):
    recording = read(
        tmp_path,
        *states(),
        event(0, '/law', {'x_r': 0.2}, topic='/run_parameters'),
        event(10, '/law', {'x_r': 0.3}, topic='/run_parameters'),
        log_time=True,
    )
    assert recording.set_point.tolist() == [0.2] * 10 + [0.3] * (COUNT - 10)
