"""A running experiment: tuned, paused, stepped, reset and interrupted."""

import signal
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from impulse_control_ros.core.parameter import declared
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.experiment import NODES
from impulse_control_ros.files.recording import read
from test.conftest import CONFIG, wait_for

REAL_TIME = ('-p', 'plant_simulator:real_time_factor:=0.02')


def start(graph, *arguments, config='underdamped'):
    bag = graph.folder / 'bag'
    return graph.start('closed_loop', '--ros-args', '--params-file', CONFIG / f'{config}.yaml',
                       '-p', f'recorder:bag:={bag}', *arguments), bag


def paused(graph, client, *arguments):
    """Return a run that is paused somewhere in its middle, and its bag."""
    process, bag = start(graph, *REAL_TIME, *arguments)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 20, 'states')
    assert client.call('/plant_simulator/pause', SetBool, data=True).success
    return process, bag


def finish(client, process, bag):
    if process.running:
        assert client.set('plant_simulator', real_time_factor=0.0).successful
        resume = client.node.create_client(SetBool, '/plant_simulator/pause')
        client.spin_until(resume.service_is_ready, 'the pause service')
        # not awaited: the run may be over before the response is here
        resume.call_async(SetBool.Request(data=False))
        client.spin_until(lambda: not process.running, 'the end of the run')
    assert process.wait() == 0, process.output
    return read(bag)


def pd(run, K, D, x_r):
    return K * (x_r - run.states['position']) - D * run.states['velocity']


def test_gains_and_set_point_act_at_the_next_sample(graph, client):
    process, bag = paused(graph, client, '-p', 'controller:impulses:=false')
    assert client.set('controller', K=12, D=0.25, x_r=0.1).successful
    assert client.get('controller', 'K', 'D', 'x_r') == [12.0, 0.25, 0.1]
    run = finish(client, process, bag)
    before = run.commands['effort'] == pd(run, 10.0, 0.5, 0.0)
    after = run.commands['effort'] == pd(run, 12.0, 0.25, 0.1)
    change = int(np.flatnonzero(after & ~before)[0])
    assert 20 < change < 20_000
    assert before[:change].all()
    assert after[change:].all()
    assert run.receipt['missing'] == '0'


def test_a_bad_value_in_a_set_changes_nothing_at_all(graph, client):
    process, bag = paused(graph, client, '-p', 'controller:impulses:=false')
    for bad, said in (({'D': -1.0}, 'D = -1.0'), ({'alpha_ratio': 1.0}, '(19)'),
                      ({'c': 'two'}, "c = 'two'"), ({'nothing': 1.0}, 'nothing = 1.0'),
                      ({'m': float('nan')}, 'm = nan'), ({'time_step': 1e-3}, 'read-only')):
        result = client.set('controller', K=99.0, **bad)
        assert not result.successful
        assert said in result.reason
    assert client.get('controller', 'K', 'D', 'alpha_ratio') == [10.0, 0.5, 0.6]
    run = finish(client, process, bag)
    assert (run.commands['effort'] == pd(run, 10.0, 0.5, 0.0)).all()


OTHER_VALUES = {'damping.kind': 'noise', 'c': 1.0, 'alpha_ratio': 0.75, 'duration': 1.5,
                'damping.upper': 2.0, 'damping.lower': 0.25, 'impulses': False,
                'sensor.velocity': 'difference', 'disturbance.kind': 'noise',
                'disturbance.end': 9.0, 'velocity_source': 'estimated'}


def test_every_parameter_that_is_not_fixed_can_be_set_and_the_others_are_refused(graph, client):
    process, bag = paused(graph, client)
    for node in ('plant_simulator', 'controller'):
        for name, _, spec in declared(NODES[node]):
            now = client.get(node, name)[0]
            other = OTHER_VALUES.get(name, not now if isinstance(now, bool) else (
                now + 1 if isinstance(now, (int, float)) else 'other'))
            result = client.set(node, **{name: other})
            assert result.successful != spec.read_only, (name, result.reason)
            assert (client.get(node, name) == [other]) != spec.read_only
    run = finish(client, process, bag)
    assert run.states['stamp'][-1] == int(2.5 * SECOND)
    assert run.receipt['missing'] == '0'


def test_an_unwise_value_is_taken_with_a_warning_that_names_the_right_one(graph, client):
    process, _ = paused(graph, client)
    assert client.set('controller', K=40.0).successful
    process.says('D = 2.5 N s/m is')


def test_a_composed_run_at_full_speed_serves_parameters_services_and_outside_subscribers(
        graph, client):
    process, bag = start(graph, '-p', 'plant_simulator:duration:=0.0')
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 100, 'states')
    assert client.set('controller', x_r=0.125).successful
    client.spin_until(lambda: abs(states[-1].position[0] - 0.125) < 1e-3, 'the new set-point')
    assert client.call('/plant_simulator/reset', Trigger).success
    response = client.call('/plant_simulator/pause', SetBool, data=True)
    assert process.interrupt() == 0, process.output
    run = read(bag)
    assert response.message == f'paused at {run.states["stamp"][-1] / SECOND:.9f} s'
    assert run.receipt['missing'] == '0'
    assert (np.diff(run.states['stamp']) == 100_000).all()
    started = (run.states['position'] == 0.5) & (run.states['velocity'] == 0.0)
    assert np.count_nonzero(started) == 2


def test_the_setpoint_topic_sets_the_parameter_that_follows(graph, client):
    process, _ = paused(graph, client)
    publisher = client.node.create_publisher(Float64, '/setpoint', 10)
    client.spin_until(publisher.get_subscription_count, 'a subscriber of setpoint')
    publisher.publish(Float64(data=0.25))
    client.spin_until(lambda: client.get('controller', 'x_r') == [0.25], 'x_r')
    publisher.publish(Float64(data=float('inf')))
    process.says('x_r = inf is refused')
    assert client.get('controller', 'x_r') == [0.25]


def test_steps_are_made_only_while_paused_and_as_many_as_asked(graph, client):
    process, bag = paused(graph, client)
    states = client.listen('/joint_states', JointState)
    assert client.set('plant_simulator', step_ticks=7).successful
    assert client.call('/plant_simulator/step', Trigger, once=True).success
    client.spin_until(lambda: len(states) >= 7, 'seven states')
    assert len({state.header.stamp.nanosec for state in states}) == 7
    client.call('/plant_simulator/pause', SetBool, data=False)
    refused = client.call('/plant_simulator/step', Trigger)
    assert not refused.success
    assert 'pause first' in refused.message
    client.call('/plant_simulator/pause', SetBool, data=True)  # finish() sets, then lets go
    assert finish(client, process, bag).receipt['missing'] == '0'


def test_a_reset_restores_the_start_and_time_goes_on(graph, client):
    process, bag = paused(graph, client)
    response = client.call('/plant_simulator/reset', Trigger, once=True)
    assert response.success
    run = finish(client, process, bag)
    at = int(np.flatnonzero((run.states['position'] == 0.5) & (run.states['velocity'] == 0.0))[1])
    assert f'{run.states["stamp"][at] / SECOND:.9f}' in response.message
    assert (np.diff(run.states['stamp']) == 100_000).all()
    assert list(run.impulses['guard'][run.impulses['stamp'] == run.states['stamp'][at]]) == [2]
    first = run.states['position'][:at]
    assert run.states['position'][at:2 * at].tobytes() == first.tobytes()


def test_clock_damping_and_diagnostics_are_published(graph, client):
    process, _ = start(graph, '-p', 'plant_simulator:real_time_factor:=0.2', config='time_varying')
    clock = client.listen('/clock', Clock)
    damping = client.listen('/damping', Float64)
    reports = client.listen('/diagnostics', DiagnosticArray)
    client.spin_until(lambda: len(clock) > 3 and len(damping) > 30 and {
        status.name for report in reports for status in report.status
    } >= {'/plant_simulator', '/controller', '/recorder'}, 'clock, damping, diagnostics')
    steps = np.diff([message.clock.sec * SECOND + message.clock.nanosec for message in clock])
    assert (steps == SECOND // 100).all()
    assert all(0.15 <= message.data <= 1.5 for message in damping)
    plant = next(status for report in reports[::-1] for status in report.status
                 if status.name == '/plant_simulator')
    assert {'steps_per_second', 'real_time_factor', 'late', 'stale', 'rejected'} <= {
        value.key for value in plant.values}
    assert process.interrupt() == 0


def test_real_time_factor_holds_simulated_time_to_the_wall_clock(graph, client):
    process, bag = start(graph, '-p', 'plant_simulator:real_time_factor:=0.5',
                         '-p', 'plant_simulator:duration:=0.5')
    assert process.wait() == 0, process.output
    assert float(read(bag).receipt['wall_seconds']) > 0.9


def test_free_running_needs_no_command_and_counts_what_it_missed(graph, client):
    process = graph.start('plant_simulator', '--ros-args', '-p', 'lockstep:=false', '-p',
                          'real_time_factor:=0.5', '-p', 'duration:=0.5', '-p', 'time_step:=0.001')
    publisher = client.node.create_publisher(JointState, '/joint_commands', 10)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: states, 'states')
    command = JointState(name=['axis'], effort=[0.25])
    command.header.stamp = states[-1].header.stamp
    publisher.publish(command)
    client.spin_until(lambda: not process.running, 'the end')
    assert process.wait() == 0
    assert states[0].effort[0] == 0.0
    assert 0.25 in [state.effort[0] for state in states]
    assert len(states) > 400
    assert 'missed deadlines' in process.output


def test_stale_foreign_and_broken_commands_are_counted_and_change_nothing(graph, client):
    plant = graph.start('plant_simulator')
    publisher = client.node.create_publisher(JointState, '/joint_commands', 10)
    states = client.listen('/joint_states', JointState)
    reports = client.listen('/diagnostics', DiagnosticArray)

    def command(sec, nanosec, effort, name='axis'):
        message = JointState(name=[name], effort=effort)
        message.header.stamp = Time(sec=sec, nanosec=nanosec)
        return message

    client.spin_until(lambda: states, 'the first state')
    publisher.publish(command(0, 5, [1.0]))
    publisher.publish(command(1, 50, [1.0]))
    publisher.publish(command(1, 0, [float('nan')]))
    plant.says('rejected a command with effort nan')
    publisher.publish(command(1, 0, []))
    publisher.publish(command(1, 0, [1.0], name='elbow'))
    publisher.publish(command(1, 0, [0.5]))
    publisher.publish(command(1, 0, [0.75]))
    wanted = {'stale': '2', 'foreign': '1', 'rejected': '3', 'steps': '1'}
    client.spin_until(lambda: reports and wanted.items() <= {
        value.key: value.value for value in reports[-1].status[0].values}.items(), str(wanted))
    assert {state.effort[0] for state in states} == {0.0, 0.5}
    assert plant.interrupt() == 0


@pytest.mark.parametrize('node', ['plant_simulator', 'controller', 'recorder', 'closed_loop'])
def test_a_signal_during_the_imports_ends_a_node_without_a_traceback(graph, node):
    process = graph.start(node)
    wait_for(lambda: 'llvmlite' in process.memory_map, 'numba')
    process.send(signal.SIGINT)
    assert process.wait() == 0, process.output
    assert 'Traceback' not in process.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('node', ['plant_simulator', 'controller', 'recorder', 'closed_loop'])
def test_a_node_that_waits_ends_at_a_storm_of_signals(graph, client, node, number):
    process = graph.start(node, *(('--no-recorder',) if node == 'closed_loop' else ()))
    name = 'controller' if node == 'closed_loop' else node
    client.spin_until(lambda: name in client.node.get_node_names(), f'node {name}')
    client.get(name, 'use_sim_time')
    wait_for(lambda: not process.running, f'the end of {node}',
             lambda: process.send(number) or time.sleep(0.005))
    assert process.wait() == 0, process.output
    assert 'Traceback' not in process.output
