"""The motion that identifies an axis: its directions, its speeds, and its limits."""

from dataclasses import replace

import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.excitation import Excitation, GAP, Limits
from impulse_control_ros.core.nonidealities import Disturbance, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.errors import ExcitationError
from test.excited import excited

LIMITS = Limits(low=-0.3, high=0.3, speed=0.5)
AXES = {
    'no friction': (Plant(m=0.1, F_c=0.0, x_0=0.0), ControlGains(K=10.0, D=0.5)),
    'friction': (Plant(m=0.1, F_c=1.0, x_0=0.0), ControlGains(K=20.0, D=1.0)),
    'gravity': (
        Plant(m=0.1, F_c=0.5, x_0=-0.02, disturbance=Disturbance(force=-0.6)),
        ControlGains(K=30.0, D=1.0),
    ),
    'no derivative gain': (Plant(m=0.1, F_c=1.0, x_0=0.0), ControlGains(K=100.0, D=0.0)),
    'heavy': (Plant(m=10.0, F_c=20.0, x_0=0.0), ControlGains(K=1000.0, D=20.0)),
    'encoder': (
        Plant(m=1.0, F_c=1.0, x_0=0.1, sensor=Sensor(resolution=1e-4)),
        ControlGains(K=400.0, D=20.0),
    ),
}


@pytest.mark.parametrize(('plant', 'gains'), AXES.values(), ids=AXES)
def test_an_axis_moves_in_both_directions_at_three_speeds_and_more_within_its_limits(plant, gains):
    moved = excited(plant, gains, LIMITS)
    assert LIMITS.low < moved.position.min() < moved.position.max() < LIMITS.high
    assert np.abs(moved.velocity).max() <= LIMITS.speed
    for side in (1.0, -1.0):  # as long as 50 ms in each of these bands
        speeds = side * moved.velocity
        for low, high in ((0.05, 0.15), (0.15, 0.25), (0.25, 0.4)):
            assert np.count_nonzero((speeds > low) & (speeds < high)) > 50
    # the steps are sharp, and there are some in both directions
    steps = np.diff(moved.set_point)
    assert np.count_nonzero(steps > 0.01) >= 4
    assert np.count_nonzero(steps < -0.01) >= 4
    assert moved.set_point[-1] == moved.set_point[0]
    assert moved.time[-1] < 40.0


def test_an_axis_whose_set_points_come_late_moves_slowly_and_is_not_refused():
    moved = excited(*AXES['friction'], replace(LIMITS, low=-0.1, high=0.2), period=3.0 * GAP)
    assert np.abs(moved.velocity).max() <= LIMITS.speed
    assert moved.set_point[-1] == moved.set_point[0]


def test_a_late_set_point_lets_a_ramp_go_on_by_little():
    motion = Excitation(LIMITS, 10.0, 0.5, 0.0, 0.0)
    time, points = 0.0, []
    while len(points) < 40:
        motion.watch(time, 0.0)
        points.append(motion.next_set_point())
        time += 0.02
    motion.watch(time + 5.0, 0.0)  # an axis that does not follow, and a state that is 5 s late
    assert 0.0 < abs(motion.next_set_point() - points[-1]) <= LIMITS.speed * GAP


@pytest.mark.parametrize(
    ('x_r', 'position', 'said'),
    [
        (0.4, 0.0, 'set-point of the controller 0.4 m is outside of the travel from -0.3 to 0.3'),
        (0.0, -0.31, 'position -0.31 m is outside'),
    ],
)
def test_a_start_outside_of_the_travel_is_refused(x_r, position, said):
    with pytest.raises(ExcitationError, match=said):
        Excitation(LIMITS, 10.0, 0.5, x_r, position)


def test_a_state_beyond_a_limit_ends_the_motion():
    motion = Excitation(LIMITS, 10.0, 0.5, 0.0, 0.0)
    motion.watch(0.0, 0.0)
    with pytest.raises(ExcitationError, match='position 0.301 m is outside'):
        motion.watch(0.02, 0.301)
    motion = Excitation(LIMITS, 10.0, 0.5, 0.0, 0.0)
    motion.watch(0.0, 0.0)
    motion.watch(0.02, 0.0099)
    with pytest.raises(ExcitationError, match=r'speed 0.51 m/s is above the limit of 0.5 m/s'):
        motion.watch(0.04, 0.0201)


def test_an_axis_that_does_not_follow_is_reported_with_the_force_that_did_not_move_it():
    plant, gains = AXES['friction']
    with pytest.raises(ExcitationError, match='does not follow: .* a larger K of the controller'):
        excited(replace(plant, F_c=10.0), gains, LIMITS)
