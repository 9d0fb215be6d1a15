"""A running experiment: tuned, paused, stepped, reset and looked at."""

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import ListParameters, SetParameters
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
import yaml

from impulse_control_ros.core.parameter import declared
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.experiment import NODES
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import (
    assert_replays,
    assert_whole,
    composed,
    Run,
    stamp_of,
    START,
)
from test.processes import CONFIG

LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture
def live(graph, client):
    """Return a composed run somewhere in its middle, and its states."""
    process = composed(graph)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 20, 'states')
    return process, states


def paused(client):
    assert client.call('/plant_simulator/pause', SetBool, data=True).success


def finish(client, process, states):
    """Let the run go on for a while and end it; returns the recording."""
    client.call('/plant_simulator/pause', SetBool, data=False)
    until = stamp_of(states[-1]) + 50 * 100_000
    client.spin_until(lambda: stamp_of(states[-1]) > until, 'states')
    assert process.interrupt() == 0, process.output
    run = read_bag(process.folder / 'bag')
    assert_whole(run)
    return run


def test_gains_and_set_point_act_at_the_next_sample_and_are_told(graph, client, live):
    process, states = live
    told = client.listen('/run_parameters', ParameterEvent, LATCHED)
    assert client.set('controller', K=12, D=0.25, x_r=0.1).successful
    assert client.get('controller', 'K', 'D', 'x_r') == [12.0, 0.25, 0.1]
    assert client.set('plant_simulator', m=0.2).successful
    client.spin_until(lambda: len(told) >= 4, 'what is told')
    run = finish(client, process, states)
    assert_replays(graph.folder / 'bag')
    plant, controller, gains, mass = sorted(
        told,
        key=lambda one: (
            one.stamp.sec,
            one.stamp.nanosec,
            len(one.changed_parameters),
            '#' in one.node,
        ),
    )
    for event, kind in ((plant, 'plant_simulator'), (controller, 'controller')):
        assert not event.changed_parameters
        assert event.node.split()[0] == f'run:{run.run}'
        names = [name for name, *_ in declared(NODES[kind])]
        assert [one.name for one in event.new_parameters] == names
        assert event.stamp.sec * SECOND + event.stamp.nanosec == START
    values = [
        {one.name: parameter_value_to_python(one.value) for one in event.changed_parameters}
        for event in (gains, mass)
    ]
    assert values == [{'K': 12.0, 'D': 0.25, 'x_r': 0.1}, {'m': 0.2}]
    assert {'K': 12.0, 'd_bar': 1.5}.items() <= {
        one.name: parameter_value_to_python(one.value) for one in gains.new_parameters
    }.items()
    # the controller answers the state of that stamp with them; impulses are apart from PD
    at = gains.stamp.sec * SECOND + gains.stamp.nanosec
    rows = run.states[: len(run.commands)]
    quiet = ~np.isin(rows['stamp'], run.impulses['stamp'])
    late, efforts = rows['stamp'] >= at, run.commands['effort']
    for of, K, D, x_r in ((quiet & ~late, 10.0, 0.5, 0.0), (quiet & late, 12.0, 0.25, 0.1)):
        assert of.sum() > 10
        assert (efforts[of] == (K * (x_r - rows['position']) - D * rows['velocity'])[of]).all()


def test_a_run_of_three_processes_that_is_tuned_replays_to_the_bit(graph, client):
    run = Run(graph, client)
    for node, values in (
        ('controller', {'K': 20.0}),
        ('plant_simulator', {'F_c': 0.5}),
        ('controller', {'x_r': 0.1}),
        ('plant_simulator', {'damping.kind': 'sinusoidal', 'm': 0.2}),
    ):
        assert client.set(node, **values).successful
        run.reach(20)
    recording = run.finish()
    assert_whole(recording)
    assert [change.changed for change in recording.changes] == [
        {'K': 20.0},
        {'F_c': 0.5},
        {'x_r': 0.1},
        {'damping.kind': 'sinusoidal', 'm': 0.2},
    ]
    assert_replays(run.bag)


REFUSED = (
    ({'D': -1.0}, 'D = -1.0'),
    ({'alpha_ratio': 1.0}, '(19)'),
    ({'c': 'two'}, "c = 'two'"),
    ({'nothing': 1.0}, 'nothing = 1.0'),
    ({'m': float('nan')}, 'm = nan'),
    ({'time_step': 1e-3}, 'read-only'),
)


def test_a_bad_value_in_a_set_changes_nothing_at_all(client, live):
    process, states = live
    for bad, said in REFUSED:
        result = client.set('controller', K=99.0, **bad)
        assert not result.successful
        assert said in result.reason
    assert client.get('controller', 'K', 'D', 'alpha_ratio') == [10.0, 0.5, 0.6]
    assert client.set('controller', K=40.0).successful
    process.says('D = 2.5 N s/m')  # is right: the value is taken with a warning
    setpoint = client.publisher('/setpoint', Float64, 'controller')
    setpoint.publish(Float64(data=float('inf')))
    process.says('x_r = inf')
    setpoint.publish(Float64(data=0.25))
    client.spin_until(lambda: client.get('controller', 'x_r') == [0.25], 'x_r')
    run = finish(client, process, states)
    assert [change.changed for change in run.changes] == [{'K': 40.0}, {'x_r': 0.25}]


OTHER_VALUES = {
    'damping.kind': 'noise',
    'c': 1.0,
    'alpha_ratio': 0.75,
    'duration': 0.5,
    'damping.upper': 2.0,
    'damping.lower': 0.25,
    'impulses': False,
    'sensor.velocity': 'difference',
    'disturbance.kind': 'noise',
    'disturbance.end': 9.0,
    'velocity_source': 'estimated',
    'mass_ratio_limits.lower': 0.5,
}


def test_every_parameter_that_is_not_fixed_can_be_set_and_the_others_are_refused(
    graph, client, live
):
    process, _ = live
    paused(client)
    for node in ('plant_simulator', 'controller'):
        specs = {name: spec for name, _, spec in declared(NODES[node])}
        now = dict(zip(specs, client.get(node, *specs), strict=True))
        other = {
            name: OTHER_VALUES.get(
                name,
                not value
                if isinstance(value, bool)
                else (value + 1 if isinstance(value, (int, float)) else 'other'),
            )
            for name, value in now.items()
        }
        for name, spec in specs.items():
            result = client.set(node, **{name: other[name]})
            assert result.successful != spec.read_only, (name, result.reason)
        assert client.get(node, *specs) == [
            (now if spec.read_only else other)[name] for name, spec in specs.items()
        ]
    assert client.set('plant_simulator', real_time_factor=0.0).successful
    assert client.call('/plant_simulator/pause', SetBool, once=True, data=False).success
    assert process.wait() == 0, process.output
    run = read_bag(graph.folder / 'bag')
    assert_whole(run)
    assert len(run.states) == 5001
    assert_replays(graph.folder / 'bag')


@pytest.mark.parametrize('node', NODES)
def test_what_ros2_param_dump_writes_is_loaded_again(graph, client, live, node):
    names = client.call(f'/{node}/list_parameters', ListParameters).result.names
    assert {'use_sim_time', 'start_type_description_service'} <= {*names}
    values = dict(zip(names, client.get(node, *names), strict=True))
    dumped = graph.folder / 'dumped.yaml'
    dumped.write_text(yaml.safe_dump({f'/{node}': {'ros__parameters': values}}))
    loaded = parameter_dict_from_yaml_file(str(dumped))
    results = client.call(
        f'/{node}/set_parameters', SetParameters, parameters=list(loaded.values())
    ).results
    assert [one.reason for one in results if not one.successful] == []
    assert len(results) == len(names)
    assert client.get(node, *names) == list(values.values())


def test_numbers_that_ros2_param_gives_as_strings_are_set(client, live):
    assert client.set('controller', position_deadband='1e-6', K='1e1', time_step='1e-4').successful
    assert client.get('controller', 'position_deadband', 'K') == [1e-6, 10.0]
    result = client.set('controller', K=12.0, time_step='1e-3')
    assert result.reason == (
        'invalid time_step = 0.001: must be 0.0001: read-only, it is set where the node is started'
    )
    assert client.get('controller', 'K') == [10.0]


def test_steps_are_made_only_while_paused_and_as_many_as_asked(client, live):
    process, states = live
    paused(client)
    assert client.set('plant_simulator', step_ticks=7).successful
    before = int(client.reported('plant_simulator', steps_per_second='0.0')['steps'])
    assert client.call('/plant_simulator/step', Trigger, once=True).success
    client.reported('plant_simulator', steps=before + 7)
    client.call('/plant_simulator/pause', SetBool, data=False)
    refused = client.call('/plant_simulator/step', Trigger)
    assert not refused.success
    assert 'pause first' in refused.message
    finish(client, process, states)
    for said in ('paused at ', 'steps requested at ', 'resumed at '):
        assert process.output.count(said) == 1


def test_a_run_that_starts_paused_begins_at_the_first_step(graph, client):
    process = composed(graph, **{'plant_simulator:start_paused': True})
    states = client.listen('/joint_states', JointState)
    client.reported('plant_simulator', message='waiting for resume', recorders=1)
    assert states == []
    assert client.call('/plant_simulator/step', Trigger, once=True).success
    client.spin_until(lambda: {stamp_of(one) for one in states} == {START, START + 100_000}, '2')
    run = finish(client, process, states)
    assert run.states['stamp'][0] == START
    process.says('resumed at 1.000100000 s')


def test_a_reset_restores_the_start_and_time_goes_on(graph, client, live):
    process, states = live
    response = client.call('/plant_simulator/reset', Trigger, once=True)
    assert response.success
    run = finish(client, process, states)
    first, at = np.flatnonzero(run.states['is_reset'])
    assert first == 0
    for start in (first, at):
        assert run.states[start]['position'] == 0.5
        assert run.states[start]['velocity'] == 0.0
    assert f'{run.states["stamp"][at] / SECOND:.9f}' in response.message
    assert f'reset: {response.message}' in process.output
    assert list(run.impulses['guard'][run.impulses['stamp'] == run.states['stamp'][at]]) == [2]
    count = min(at, len(run.states) - at)
    assert run.states['position'][at : at + count].tobytes() == (
        run.states['position'][:count].tobytes()
    )
    assert_replays(graph.folder / 'bag')


def test_a_run_at_full_speed_serves_parameters_and_services(graph, client):
    process = composed(graph, **{'plant_simulator:real_time_factor': 0.0})
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 100, 'states')
    assert client.set('controller', x_r=0.125).successful
    client.spin_until(lambda: abs(states[-1].position[0] - 0.125) < 1e-3, 'the new set-point')
    assert client.call('/plant_simulator/reset', Trigger, once=True).success
    response = client.call('/plant_simulator/pause', SetBool, data=True)
    assert process.interrupt() == 0, process.output
    run = read_bag(graph.folder / 'bag')
    assert_whole(run)
    assert response.message == f'paused at {run.states["stamp"][-1] / SECOND:.9f} s'
    assert np.count_nonzero(run.states['is_reset']) == 2


def test_clock_damping_and_diagnostics_are_published(graph, client):
    process = composed(
        graph, CONFIG / 'time_varying.yaml', **{'plant_simulator:real_time_factor': 0.2}
    )
    clock = client.listen('/clock', Clock)
    damping = client.listen('/damping', Float64)
    reports = client.listen('/diagnostics', DiagnosticArray)
    client.spin_until(
        lambda: (
            len(clock) > 3
            and len(damping) > 30
            and {status.name for report in reports for status in report.status}
            >= {'/plant_simulator', '/controller', '/recorder'}
        ),
        'clock, damping, diagnostics',
    )
    steps = np.diff([message.clock.sec * SECOND + message.clock.nanosec for message in clock])
    assert {*steps.tolist()} - {0} == {SECOND // 100}  # a repeated state repeats its clock
    assert all(0.15 <= message.data <= 1.5 for message in damping)
    plant = client.reported('plant_simulator')
    assert {
        'run',
        'controller',
        'recorders',
        'steps_per_second',
        'real_time_factor',
        'accepted',
        'late',
        'stale',
        'rejected',
        'lost',
        'missed_deadlines',
    } <= plant.keys()
    assert process.interrupt() == 0
