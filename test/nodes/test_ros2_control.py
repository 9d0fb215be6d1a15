"""Our controller on a robot under ros2_control, and our plant under its manager."""

import signal

from lifecycle_msgs.msg import Transition
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
import yaml

from impulse_control_ros.core.protocol import FOREIGN, parse_state
from test.nodes.runs import assert_replays, stamp_of
from test.processes import ROOT
from test.ros2_control_peer import Manager, Robot

EXAMPLE = ROOT / 'examples' / 'ros2_control'
CONFIG = EXAMPLE / 'axis.yaml'
GIVEN = yaml.safe_load(CONFIG.read_text())
REMAPPED = '--ros-args', '-r', 'effort_commands:=/forward_effort_controller/commands'
DURATION, AT_REST = 0.5, 0.3  # s, of a response and until it is to be over


def controller(graph, **parameters):
    # the peer has a pace of its own
    given = {'state_timeout': 0.0, 'max_age': 0.0, 'lifecycle': False} | parameters
    given['command_joints'] = [*Robot.command_joints]
    return graph.start('controller', *REMAPPED, config=CONFIG, **given)


def responses(robot, count):
    """Yield step [m], error [m] beyond the set-point, and impulses [bool] of each response."""
    random = np.random.default_rng(1)
    for k in range(count):
        step = float(random.uniform(0.3, 0.55) * (-1) ** k)
        errors, impulses = robot.respond(robot.position + step, DURATION)
        yield abs(step), errors * np.sign(step), impulses


def test_every_response_settles_behind_a_manager_of_500_hz_and_5_ms_and_the_bag_replays(
    graph, client
):
    process, bag = controller(graph), graph.folder / 'bag'
    recorder = graph.start('recorder', config=CONFIG, bag=bag)
    robot = Robot(client, 500)
    client.reported('recorder', written=0)
    period = GIVEN['/**/controller']['ros__parameters']['time_step']
    figures = []
    for _, errors, impulses in responses(robot, 20):
        out = np.flatnonzero(np.abs(errors) > 0.01)
        resting = impulses[round(AT_REST / period) :].sum()
        figures.append(((out[-1] + 1) * period, errors.max(), resting))
    settled, overshoot, resting = np.transpose(figures)
    print(f'settled {settled.min()} to {settled.max()} s, overshoot up to {overshoot.max()} m')
    assert settled.max() < AT_REST
    assert overshoot.max() < 0.015
    assert resting.max() == 0
    for node in (recorder, process):
        assert node.interrupt() == 0, node.output
    assert_replays(bag, '--controller')


def test_no_excursion_at_1_khz_with_a_sixth_of_the_states_lost_exceeds_twice_the_step(
    graph, client
):
    process = controller(graph, time_step=0.001, position_deadband=4e-3, stiction_wait_samples=10)
    robot = Robot(client, 1000, lost=0.17)
    excursions = [np.abs(errors).max() / step for step, errors, _ in responses(robot, 8)]
    print(f'excursions up to {max(excursions)} times the step')
    assert max(excursions) < 2.0
    lost = int(client.reported('controller')['lost'])
    assert lost > 0
    assert process.interrupt() == 0


def test_the_last_effort_is_zero_on_deactivation_without_states_and_at_the_end(graph, client):
    process = controller(graph, lifecycle=True, state_timeout=0.2)
    robot = Robot(client, 500)
    client.activate()
    robot.respond(0.5, 0.05)

    def last_is_zero():
        return robot.arrays and [*robot.arrays[-1].data] == [0.0, 0.0]

    assert not last_is_zero()
    client.spin_until(last_is_zero, '0 N without states')
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
    below = plant(graph)
    commands(manager, -2.0)
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
