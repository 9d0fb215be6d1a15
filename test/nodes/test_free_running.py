"""A plant that does not wait for commands, and what its controller leaves behind."""

from array import array
from itertools import pairwise
import time

from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from impulse_control_ros.core.protocol import FOREIGN, name_of, parse_command, parse_state
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import assert_replays, messages, stamp_of
from test.processes import busy_loops

COARSE = {'time_step': 0.001}
FREE = COARSE | {'lockstep': False, 'real_time_factor': 0.2}  # 200 samples a second


def controller_of(state):
    return name_of(parse_state(state.header.frame_id).controller)


def efforts(states, count=5):
    """Return the efforts of the last states."""
    return [state.effort[0] for state in states[-count:]]


def wait_for_zero(client, states):
    states.clear()
    client.spin_until(lambda: len(states) > 5 and efforts(states) == [0.0] * 5, 'zero efforts')


def test_a_foreign_controller_of_a_free_plant_stamps_its_commands_as_it_likes(graph, client):
    plant = graph.start('plant_simulator', **FREE)
    recorder = graph.start('recorder', bag=graph.folder / 'bag')
    states = client.listen('/joint_states', JointState)
    publisher = client.publisher('/joint_commands', JointState, 'plant_simulator', 'recorder')
    client.reported('plant_simulator', recorders=1)
    assert abs(stamp_of(states[0]) - time.time_ns()) < 600 * 10**9  # it begins at the wall clock
    assert controller_of(states[0]) == ''

    def command(effort, stamp_ns):
        sec, nanosec = divmod(stamp_ns, 10**9)
        made = JointState(name=['axis'], effort=[effort])
        made.header.stamp = Time(sec=sec, nanosec=nanosec)
        publisher.publish(made)

    def acts(effort, stamp_ns):
        def held():  # who reads best effort may not have discovered us
            command(effort, stamp_ns)
            return states[-1].effort[0] == effort

        client.spin_until(held, f'{effort} N')

    now = time.time_ns()
    for effort, stamp_ns in ((1.0, now), (2.0, now + 5), (3.0, 0), (4.0, now + 10**12)):
        acts(effort, stamp_ns)

    def ignored():
        command(5.0, now + 6)  # older than the newest
        return client.count_of('plant_simulator', 'stale')

    client.spin_until(ignored, 'a command that is too old')
    acts(6.0, now + 10**12 + 1)
    assert 5.0 not in [state.effort[0] for state in states]
    assert client.count_of('plant_simulator', 'accepted') >= 4
    assert controller_of(states[-1]) == FOREIGN
    assert recorder.interrupt() == 0, recorder.output
    recorded = [
        deserialize_message(raw, JointState)
        for topic, *_, raw in messages(graph.folder / 'bag')
        if topic == '/joint_commands'
    ]
    assert {one.effort[0] for one in recorded} == {1.0, 2.0, 3.0, 4.0, 5.0, 6.0}
    assert read_bag(graph.folder / 'bag').recording_summary['missing'] == '0'
    plant.kill()
    plant = graph.start('plant_simulator', **FREE)
    plant.says('running from')
    heard = len(states)
    client.spin_until(lambda: len(states) > heard + 10, 'states')
    stamps = [stamp_of(state) for state in states]
    assert all(before < after for before, after in pairwise(stamps))
    assert plant.interrupt() == 0


def test_a_free_plant_holds_the_effort_of_a_killed_controller_and_another_takes_over(
    graph, client
):
    plant = graph.start('plant_simulator', **FREE)
    states = client.listen('/joint_states', JointState)
    commands = client.listen('/joint_commands', JointState)
    controllers = [
        graph.start('controller', '--ros-args', '-r', f'__node:={name}', **COARSE, x_r=x_r)
        for name, x_r in (('one', 0.2), ('two', -0.2))
    ]
    client.spin_until(lambda: states and controller_of(states[-1]), 'a controller')
    first, second = sorted(('/one', '/two'), key=lambda name: name != controller_of(states[-1]))
    client.spin_until(lambda: client.count_of(second[1:], 'standby'), 'who stands by')
    begun = len(commands)
    client.spin_until(lambda: len(commands) > begun + 50, 'commands')
    # also without states a controller that stands by sends nothing
    assert client.call('/plant_simulator/pause', SetBool, data=True).success
    client.reported(first[1:], steps_per_second='0.0')
    assert client.call('/plant_simulator/pause', SetBool, data=False).success
    assert {name_of(parse_command(one.header.frame_id).author) for one in commands[begun:]} == {
        first
    }
    assert '0 N' not in controllers[first == '/one'].output
    controllers[first == '/two'].kill()
    client.spin_until(lambda: controller_of(states[-1]) == second, 'the one that takes over')
    left = max(at for at, state in enumerate(states) if controller_of(state) == first)
    assert len({state.effort[0] for state in states[left - 50 : left]}) == 1  # held meanwhile
    begun = len(states)
    client.spin_until(lambda: len({*efforts(states[begun:])}) > 1, 'new efforts')
    assert controllers[first == '/one'].interrupt() == plant.interrupt() == 0


def test_a_free_plant_without_a_controller_says_which_effort_it_holds(graph):
    plant = graph.start('plant_simulator', **FREE)
    plant.says('holding')
    assert plant.interrupt() == 0


def test_a_controller_that_is_deactivated_or_ends_leaves_a_free_plant_without_effort(
    graph, client
):
    plant = graph.start('plant_simulator', **FREE)
    controller = graph.start('controller', **COARSE, lifecycle=True)
    states = client.listen('/joint_states', JointState)
    client.activate()
    client.spin_until(lambda: any(efforts(states)), 'efforts')
    assert client.change_state(Transition.TRANSITION_DEACTIVATE) == 'inactive'
    wait_for_zero(client, states)
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'active'
    client.spin_until(lambda: any(efforts(states)), 'efforts')
    # what passed while it was not active is not counted as lost
    lost = int(client.reported('controller', message='answering')['lost'])
    assert lost < 20
    assert controller.interrupt() == 0  # as when it is ended
    wait_for_zero(client, states)
    assert plant.interrupt() == 0
    for process in (plant, controller):
        assert 'Traceback' not in process.output


def test_a_free_plant_whose_states_no_longer_reach_the_controller_gets_zero(graph, client):
    plant = graph.start('plant_simulator', '--ros-args', '-r', 'joint_states:=measured', **FREE)
    controller = graph.start('controller', **COARSE, state_timeout=0.2)
    states = client.listen('/measured', JointState)
    relay = client.publisher('/joint_states', JointState, 'controller')

    def relayed():
        for one in states:
            relay.publish(one)
        moving = any(efforts(states))
        states.clear()
        return moving

    client.spin_until(relayed, 'efforts')
    wait_for_zero(client, states)
    for process in (plant, controller):
        assert process.interrupt() == 0


@pytest.mark.parametrize('free', [False, True])
def test_a_free_plant_that_is_paused_gets_zero_and_a_plant_in_lockstep_does_not(
    graph, client, free
):
    states = client.listen('/joint_states', JointState)
    commands = client.listen('/joint_commands', JointState)
    plant = graph.start('plant_simulator', **FREE | {'lockstep': not free})
    controller = graph.start('controller', **COARSE, state_timeout=0.05)
    client.spin_until(lambda: states and any(efforts(states)), 'efforts')
    assert client.call('/plant_simulator/pause', SetBool, data=True).success
    client.reported('controller', steps_per_second='0.0')
    zeros = [one for one in commands if stamp_of(one) == 0]
    assert bool(zeros) == free
    assert all(one.effort == array('d', [0.0]) for one in zeros)
    assert plant.interrupt() == controller.interrupt() == 0


def test_a_recorded_run_of_a_free_plant_replays_from_its_states_whatever_the_load(graph, client):
    bag = graph.folder / 'bag'
    plant = graph.start('plant_simulator', **FREE, wait_for_recorder=True)
    controller = graph.start('controller', **COARSE, position_deadband=0.005, lifecycle=True)
    recorder = graph.start('recorder', bag=bag)
    states = client.listen('/joint_states', JointState)
    client.recorded(commands=2)  # the plant and the recorder
    client.activate()
    with busy_loops(2):
        client.spin_until(lambda: len(states) > 100 and controller_of(states[-50]), 'states')
        for process in (plant, recorder, controller):
            assert process.interrupt() == 0, process.output
    run = read_bag(bag)
    assert np.array_equal(np.diff(run.states['stamp']), np.full(len(run.states) - 1, 10**6))
    assert len(run.commands) > 10
    assert run.lacks == []
    assert_replays(bag, '--controller')
