"""``excite`` over real nodes: it moves, restores, and stops where it must."""

import argparse
import signal

import numpy as np
import pytest
from rcl_interfaces.msg import ParameterEvent
from sensor_msgs.msg import JointState

from impulse_control_ros.errors import UsageError
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.nodes.excite import add_options, limits_of
from test.nodes.runs import composed

STEP = 1e-3
AXIS = {
    'plant_simulator:time_step': STEP,
    'controller:time_step': STEP,
    'plant_simulator:real_time_factor': 2.0,
    'plant_simulator:x_0': 0.02,
    'plant_simulator:m': 0.2,
    'plant_simulator:F_c': 0.2,
    'controller:x_r': 0.02,
    'controller:K': 50.0,
    'controller:D': 4.0,
}
LIMITS = '--travel', -0.1, 0.1, '--max-speed', 0.5


@pytest.fixture
def loop(graph):
    return composed(graph, **AXIS)


def moving(client, excite, states):
    """Wait until the axis moves."""
    excite.says('impulses are off; moving within -0.1 to 0.1 m at up to 0.5 m/s')
    client.spin_until(lambda: states and abs(states[-1].velocity[0]) > 0.05, 'motion')


def stopped(client, excite, why, *held_within):
    """Assert that the motion was ended, and that the controller holds the axis there."""
    assert excite.wait() == 1
    assert f'excite: {why}' in excite.output
    assert 'stopped; the controller holds' in excite.output
    assert excite.output.count('\n') == 3
    x_r, impulses = client.get('controller', 'x_r', 'impulses')
    assert held_within[0] <= x_r <= held_within[1]
    assert impulses is False


def test_it_moves_the_axis_within_its_limits_and_restores_the_controller(graph, client, loop):
    assert client.set('controller', x_r=0.03).successful
    excite = graph.start('excite', *LIMITS)
    assert excite.wait() == 0, excite.output
    assert 'x_r and impulses are restored' in excite.output
    assert client.get('controller', 'x_r', 'impulses') == [0.03, True]
    assert loop.interrupt() == 0, loop.output
    run = read_bag(loop.folder / 'bag')
    off, on = [one.stamp for one in run.changes if 'impulses' in one.changed]
    assert [one.changed['impulses'] for one in run.changes if 'impulses' in one.changed] == [
        False,
        True,
    ]
    inside = (run.states['stamp'] >= off) & (run.states['stamp'] < on)
    assert not ((run.impulses['stamp'] >= off) & (run.impulses['stamp'] < on)).any()
    position, velocity = run.position[inside], run.velocity[inside]
    assert -0.1 <= position.min() < -0.03 < 0.05 < position.max() <= 0.1
    for side in (1.0, -1.0):
        for low, high in ((0.05, 0.15), (0.15, 0.25), (0.25, 0.45)):
            assert np.count_nonzero((side * velocity > low) & (side * velocity < high)) > 20


def test_an_interrupted_motion_is_stopped_and_held(graph, client, loop):
    states = client.listen('/joint_states', JointState)
    excite = graph.start('excite', *LIMITS)
    moving(client, excite, states)
    excite.send(signal.SIGINT)
    stopped(client, excite, 'interrupted', -0.1, 0.1)
    x_r = client.get('controller', 'x_r')[0]
    client.spin_until(lambda: abs(states[-1].position[0] - x_r) < 0.01, 'the held axis')
    assert loop.interrupt() == 0


def test_an_axis_that_is_pushed_out_of_the_travel_is_stopped_and_held(graph, client, loop):
    states = client.listen('/joint_states', JointState)
    excite = graph.start('excite', *LIMITS)
    moving(client, excite, states)
    assert client.set('plant_simulator', **{'disturbance.force': 8.0}).successful
    assert excite.wait() == 1
    assert 'is above the limit of 0.5 m/s' in excite.output or (
        'is outside of the travel from -0.1 to 0.1 m' in excite.output
    )
    stopped(client, excite, '', -0.1, 0.1)
    assert loop.interrupt() == 0


def test_states_that_stay_away_end_the_motion(graph, client, loop):
    states = client.listen('/joint_states', JointState)
    excite = graph.start('excite', *LIMITS, state_timeout=3.0)
    moving(client, excite, states)
    loop.kill()
    assert excite.wait() == 1
    assert 'for 3 s: stopped; the controller holds' in excite.output


def test_without_a_controller_it_ends_and_says_what_it_waited_for(graph):
    excite = graph.start('excite', *LIMITS, discovery_timeout=0.5)
    assert excite.wait() == 1
    assert excite.output.endswith('excite: no answer of controller for 0.5 s\n')


def test_a_set_point_outside_of_the_travel_is_refused_before_anything_moves(graph, client, loop):
    told = client.listen('/run_parameters', ParameterEvent)
    excite = graph.start('excite', '--travel', 0.05, 0.1, '--max-speed', 0.5)
    assert excite.wait() == 1
    assert 'set-point of the controller 0.02 m is outside of the travel' in excite.output
    assert client.get('controller', 'x_r', 'impulses') == [0.02, True]
    assert not [one for one in told if one.changed_parameters]
    assert loop.interrupt() == 0


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        ('--travel 0.1 -0.1 --max-speed 1', '--travel 0.1 -0.1: LOW must be below HIGH'),
        ('--travel 0 inf --max-speed 1', '--travel 0 inf: LOW must be below HIGH, both finite'),
        ('--travel -0.1 0.1 --max-speed 0', '--max-speed 0: must be > 0'),
    ],
)
def test_impossible_limits_are_refused(arguments, said):
    parser = argparse.ArgumentParser()
    add_options(parser)
    with pytest.raises(UsageError, match=said):
        limits_of(parser.parse_args(arguments.split()))


def test_bad_arguments_end_the_process_with_2(graph):
    excite = graph.start('excite', '--travel', 0.1, -0.1, '--max-speed', 1)
    assert excite.wait() == 2
    assert '--travel 0.1 -0.1: LOW must be below HIGH' in excite.output
