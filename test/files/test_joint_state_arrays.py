"""Bags of another recorder: rosbags writes them here, with wall times as rosbag2 does."""

import numpy as np
import pytest

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import BagError
from impulse_control_ros.files import joint_state_arrays
from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.recording import read_bag
from test.command_lines import status_of
from test.files.test_bag import RUN, START, STEP
from test.tools.bags import (
    all_told,
    CONTROLLER,
    entries,
    experiment,
    recorded_elsewhere,
    sent,
    STATES,
    told,
    TYPES,
    WALL,
)

LAG = 2


@pytest.fixture(scope='module')
def made():
    return experiment('time_varying')


@pytest.fixture(scope='module')
def run(made):
    return simulate(made.plant, made.gains, 0.3)


@pytest.fixture(params=[RUN, ''], ids=['our plant', 'foreign plant'])
def bag(request, tmp_path, made, run):
    """Return a bag in which every 50th state comes twice, and states come late, out of order."""
    begun = all_told(made, request.param)[0 if request.param else 1 :]
    changed = told(CONTROLLER, {**made.gains.flat(), 'x_r': 0.1}, ['x_r'], 1500, request.param)
    messages = []
    for at, (time, name, kind, raw) in enumerate(
        sent([*begun, *entries(run, run=request.param), changed])
    ):
        again = name == '/joint_states' and at % 50 == 0
        messages += [(time + LAG * lag, name, kind, raw) for lag in range(1 + again)]
    return recorded_elsewhere(tmp_path / 'bag', messages[::-1])


def test_the_messages_of_another_recorder_stand_at_their_stamps_each_once(bag, run):
    recording = read_bag(bag)
    assert (np.diff(recording.states['stamp']) == STEP).all()
    assert (recording.states['position'] == run.position).all()
    assert (recording.commands['effort'] == run.effort).all()
    assert len(recording.impulses) == len(run.events)
    assert recording.lacks == []


def test_damping_belongs_to_the_state_that_was_sent_before_it(bag, run):
    recording = read_bag(bag)
    ticks = (recording.damping['stamp'] - recording.states['stamp'][0]) // STEP
    assert (ticks == np.arange(10, len(run.time), 10)).all()
    assert (recording.damping['damping'] == run.damping[ticks - 1]).all()


def test_a_change_of_parameters_acts_at_its_stamp_whenever_it_came(bag, made):
    recording = read_bag(bag)
    (change,) = recording.changes
    assert (change.stamp, change.node) == (START + 1500 * STEP, '/controller')
    assert (change.changed, change.anew) == ({'x_r': 0.1}, False)
    told = {**made.gains.flat(), 'command_joints': []}
    assert change.values == {**told, 'x_r': 0.1}
    assert recording.parameters['/controller'] == told
    assert ('/plant_simulator' in recording.parameters) == bool(recording.run)


def test_a_start_is_told_for_our_plant_alone(bag):
    recording = read_bag(bag)
    assert np.flatnonzero(recording.states['is_reset']).tolist() == [0] * bool(recording.run)


def test_a_bag_without_parameters_is_analysed_with_a_warning(tmp_path, run, capsys):
    bag = recorded_elsewhere(tmp_path / 'bag', sent(entries(run, run='')))
    assert status_of('analyze', bag) == 0
    said = capsys.readouterr()
    assert 'impulses  ' in said.out
    assert said.err.splitlines() == [
        f'analyze: warning: {bag}: incomplete: the parameters of the controller are missing',
        f'analyze: warning: {bag}: no node tells its set-point x_r: 0 m is taken',
    ]


def test_a_bag_of_another_joint_is_refused_by_name(tmp_path):
    for raw in (b'\0\1\0\0' + bytes(60), JointStateLayout('elbow').encode(1, 0, 0, 0, 0)):
        bag = recorded_elsewhere(
            tmp_path / f'bag{len(raw)}', [(WALL, '/joint_states', TYPES[STATES], raw)]
        )
        with pytest.raises(BagError, match="no joint_states of joint 'lift' among its topics"):
            read_bag(bag, joint='lift')


@pytest.mark.parametrize('controller', [True, False])
def test_the_joint_is_found_that_a_controller_tells_however_late(tmp_path, controller):
    joints = ('lift', 'axis', 'grip')
    layouts = [JointStateLayout(joint, 'base', joints=joints) for joint in joints[:2]]
    messages = [
        (START + k * STEP, STATES, layouts[k % 2].encode(1, k * STEP, 1.0, 2.0, 3.0))
        for k in range(20_000)
    ]
    if controller:
        messages.append(told(CONTROLLER, {'joint_name': 'lift'}, run=''))
    states = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages))).states
    # the others are written as 0
    assert states['position'].tolist() == [float(k % 2 != controller) for k in range(20_000)]


def test_our_run_of_another_joint_needs_no_parameters(tmp_path):
    layout = JointStateLayout('lift', f'run:{RUN}.0')
    states = read_bag(
        recorded_elsewhere(
            tmp_path / 'bag',
            sent((START, STATES, layout.encode(1, k, 0.5, 0.0, 0.0)) for k in range(1, 4)),
        )
    ).states
    assert states['position'].tolist() == [0.5] * 3


def test_the_time_to_read_grows_with_the_bag_and_not_with_its_square(tmp_path, monkeypatch):
    looked_at = []
    decode_rows = JointStateLayout.decode_rows

    def counted(layout, rows):
        looked_at.append(len(rows))
        return decode_rows(layout, rows)

    monkeypatch.setattr(JointStateLayout, 'decode_rows', counted)
    count = 4000
    for different in (1, 20, count):
        layouts = [JointStateLayout('axis', f'run:{RUN}.0 /c#{at:04x}') for at in range(different)]
        bag = recorded_elsewhere(
            tmp_path / f'bag{different}',
            sent(
                (START, STATES, layouts[k % different].encode(1, k + 1, k, 0.0, 0.0))
                for k in range(count)
            ),
        )
        looked_at.clear()
        assert read_bag(bag).states['position'].tolist() == list(range(count))
        assert (
            sum(looked_at)
            <= (joint_state_arrays.KEPT + min(2 * different, joint_state_arrays.WORTH)) * count
        )
        assert len(looked_at) <= count + joint_state_arrays.KEPT * 10
