"""Our controller on a robot under ros2_control, and our plant under its manager."""

import signal

from lifecycle_msgs.msg import Transition
import numpy as np
import pytest
import yaml

from test.nodes.runs import assert_replays
from test.processes import ROOT
from test.ros2_control_peer import Manager, Robot

EXAMPLE = ROOT / 'examples' / 'ros2_control'
CONFIG = EXAMPLE / 'axis.yaml'
GIVEN = yaml.safe_load(CONFIG.read_text())
REMAPPED = '--ros-args', '-r', 'effort_commands:=/forward_effort_controller/commands'
RESPONSES, DURATION = 20, 0.6


def controller(graph, **parameters):
    # the peer waits for the controller, which must not give up on a busy machine
    given = {'state_timeout': 0.0, 'lifecycle': False} | parameters
    given['command_joints'] = [*Robot.command_joints]
    return graph.start('controller', *REMAPPED, config=CONFIG, **given)


def responses(robot, seed=1):
    """Yield step [m], error [m] towards the far side, impulses [bool], of each response."""
    random, x_r = np.random.default_rng(seed), 0.0
    for k in range(RESPONSES):
        step = random.uniform(0.3, 0.55) * (-1) ** k
        x_r = robot.position + step
        errors, impulses = robot.respond(float(x_r), DURATION)
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
    for _, errors, impulses in responses(robot):
        out = np.flatnonzero(np.abs(errors) > 0.01)
        figures.append(((out[-1] + 1) * period, errors.max(), impulses[len(errors) // 2 :].sum()))
    settled, overshoot, resting = np.transpose(figures)
    print(f'settled {settled.min()} to {settled.max()} s, overshoot up to {overshoot.max()} m')
    assert settled.max() < 0.3
    assert overshoot.max() < 0.015
    assert resting.max() == 0
    for node in (recorder, process):
        assert node.interrupt() == 0, node.output
    assert_replays(bag, '--controller')


def test_no_excursion_at_1_khz_with_a_sixth_of_the_states_lost_exceeds_twice_the_step(
    graph, client
):
    process = controller(
        graph, time_step=0.001, position_deadband=4e-3, stiction_wait_samples=10
    )
    robot = Robot(client, 1000, lost=0.17)
    excursions = [np.abs(errors).max() / step for step, errors, _ in responses(robot)]
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
