"""Our controller on a robot under ros2_control, and our plant under its manager."""

import signal

from lifecycle_msgs.msg import Transition
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock

from impulse_control_ros.core.protocol import FOREIGN, parse_state
from scripts.ros2_control_loop import CONFIG, DelayedAxis, KHZ, simulated
from test.nodes.runs import assert_replays, stamp_of
from test.ros2_control_peer import Manager, Robot

REMAPPED = '--ros-args', '-r', 'effort_commands:=/forward_effort_controller/commands'
DURATION = 0.5  # s, of a response


def controller(graph, **parameters):
    # the peer has a pace of its own
    given = {'state_timeout': 0.0, 'max_age': 0.0, 'lifecycle': False} | parameters
    given['command_joints'] = [*Robot.command_joints]
    return graph.start('controller', *REMAPPED, config=CONFIG, **given)


def assert_moves_as_simulated(robot, axis, count, **changed):
    """Assert that each response is that of the loop without ROS, to the bit."""
    expected = simulated(axis, count, DURATION, **changed)
    for found, other in zip(robot.responses(count, DURATION), expected, strict=True):
        assert found.errors.tobytes() == other.errors.tobytes()
        assert np.array_equal(found.impulses, other.impulses)
    assert any(one.impulses.any() for one in expected)


# test/scripts/test_ros2_control_loop.py has what holds of the responses
def test_behind_a_manager_of_500_hz_and_5_ms_the_axis_moves_as_simulated_and_the_bag_replays(
    graph, client
):
    process, bag = controller(graph), graph.folder / 'bag'
    recorder = graph.start('recorder', config=CONFIG, bag=bag)
    robot = Robot(client, DelayedAxis(500))
    client.reported('recorder', written=0)
    client.recorded(commands=2)  # this client and the recorder
    client.spin_until(lambda: client.node.count_subscribers('/joint_states') == 2, 'both')
    assert_moves_as_simulated(robot, DelayedAxis(500), 2)
    report = client.reported('controller', learnt_delay='0.006')
    assert float(report['learnt_mass']) == pytest.approx(0.1, rel=0.05)
    assert recorder.interrupt() == 0, recorder.output
    assert process.output.count('the loop delays impulses by 3 samples, 0.006 s') == 1
    assert client.set('controller', effort_limit=0.0).successful
    process.says('0.006 s: effort_limit = 0 lets a wrong impulse act in full')
    assert process.interrupt() == 0, process.output
    assert process.output.count('[WARN]') == 1  # D is above the critical one
    assert_replays(bag, '--controller')


def test_at_1_khz_with_a_sixth_of_the_states_lost_the_axis_moves_as_simulated(graph, client):
    process = controller(graph, **KHZ)
    robot = Robot(client, DelayedAxis(1000, lost=0.17))
    assert_moves_as_simulated(robot, DelayedAxis(1000, lost=0.17), 1, **KHZ)
    assert int(client.reported('controller')['lost']) > 0
    assert process.interrupt() == 0


def test_the_last_effort_is_zero_on_deactivation_without_states_and_at_the_end(graph, client):
    process = controller(graph, lifecycle=True)
    robot = Robot(client, DelayedAxis(500))
    client.activate()
    robot.respond(0.5, 0.05)

    def last_is_zero():
        return robot.arrays and [*robot.arrays[-1].data] == [0.0, 0.0]

    assert not last_is_zero()
    assert client.set('controller', state_timeout=0.2).successful
    client.spin_until(last_is_zero, '0 N without states')
    assert client.set('controller', state_timeout=0.0).successful
    robot.respond(0.5, 0.05)
    robot.arrays.clear()
    assert client.change_state(Transition.TRANSITION_DEACTIVATE) == 'inactive'
    client.spin_until(last_is_zero, '0 N when deactivated')
    client.change_state(Transition.TRANSITION_ACTIVATE)
    robot.respond(0.5, 0.05)
    robot.arrays.clear()
    process.send(signal.SIGINT)
    client.spin_until(last_is_zero, '0 N at the end')
    assert process.wait() == 0, process.output


def plant(graph, **parameters):
    return graph.start(
        'plant_simulator', '--ros-args', '-r', '__ns:=/hardware', config=CONFIG, **parameters
    )


def run_of(state):
    return parse_state(state.header.frame_id).run


def efforts(manager):
    return [state.effort[0] for state in manager.states]


def commands(manager, effort):
    """Activate a controller, and run until its effort acts."""
    manager.effort = effort
    manager.states.clear()
    manager.run_until(lambda: efforts(manager)[-5:] == [effort] * 5, f'{effort} N')
    assert parse_state(manager.states[-1].header.frame_id).controller == FOREIGN


def run_without_controller(manager):
    """Run a manager whose controller is not active; return the effort that the plant holds."""
    manager.states.clear()
    manager.run_until(lambda: len({stamp_of(one) for one in manager.states}) > 30, 'states')
    (held,) = {*efforts(manager)}
    return held


def test_a_manager_on_the_wall_clock_commands_our_plant_and_each_may_restart(graph, client):
    below, manager = plant(graph), Manager(client, 0.002)
    assert run_without_controller(manager) == 0.0
    commands(manager, 1.5)
    manager.close()
    below.says('holding 1.5 N')
    manager = Manager(client, 0.002)
    assert run_without_controller(manager) == 1.5
    commands(manager, -1.5)
    assert below.interrupt() == 0
    assert below.totals['accepted'] >= 10
    assert below.totals['ignored'] > 0  # without an effort
    assert below.totals['stale'] == below.totals['rejected'] == below.totals['lost'] == 0
    assert '[ERROR]' not in below.output
    last = manager.states[-1]
    below = plant(graph)
    commands(manager, -2.0)
    assert run_of(manager.states[-1]) != run_of(last)
    assert stamp_of(manager.states[0]) > stamp_of(last)
    assert below.interrupt() == 0
    assert below.totals['accepted'] > 0
    assert below.totals['stale'] == below.totals['rejected'] == below.totals['lost'] == 0


def test_a_plant_in_lockstep_repeats_its_clock_with_an_unanswered_state(graph, client):
    clock = client.listen('/clock', Clock)
    below = plant(graph, lockstep=True)
    client.spin_until(lambda: len(clock) > 3, 'the clock')
    assert {message.clock.sec + message.clock.nanosec for message in clock} == {1}
    assert below.interrupt() == 0


@pytest.mark.parametrize(('manager_first', 'sim_stamps'), [(False, False), (True, True)])
def test_a_manager_by_simulated_time_and_a_plant_in_lockstep_do_not_wait_for_ever(
    graph, client, manager_first, sim_stamps
):
    def manager():
        return Manager(client, 0.002, sim_time=True, sim_stamps=sim_stamps)

    first = manager() if manager_first else None
    below = plant(graph, lockstep=True, command_timeout=0.2)
    first = first or manager()
    assert run_without_controller(first) == 0.0
    first.lost = 1
    commands(first, 1.5)
    first.close()
    second = manager()
    assert run_without_controller(second) == 1.5
    commands(second, -1.5)
    assert below.interrupt() == 0
    assert below.totals['accepted'] > below.totals['steps'] // 2
    assert below.totals['rejected'] == below.totals['ignored'] == 0
