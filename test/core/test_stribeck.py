"""Stribeck friction: an exact flow, which starts as its equation says and can be cut anywhere."""

import math

from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.plant import axis_step
from impulse_control_ros.core.stribeck import stribeck_step

M, F_C, F_S, FAST = 0.1, 1.0, 1.6, 0.02
velocities = st.one_of(st.floats(-0.1, 0.1), st.sampled_from([0.0, FAST, -FAST]))
forces = st.one_of(st.floats(-5.0, 5.0), st.sampled_from([0.0, F_C, F_S, -F_S]))


def stepped(velocity, force, duration, damping=0.15):
    return stribeck_step(0.0, velocity, force, damping, M, F_C, F_S, FAST, duration)


def friction(velocity):
    return math.copysign(F_C + (F_S - F_C) * max(0.0, 1.0 - abs(velocity) / FAST), velocity)


@settings(max_examples=500, deadline=None)
@given(velocities, forces, st.floats(1e-5, 2e-2), st.floats(0.05, 0.95))
def test_a_step_is_its_two_parts_one_after_the_other(velocity, force, duration, share):
    whole = stepped(velocity, force, duration)
    x, v = stepped(velocity, force, share * duration)
    change, v = stepped(v, force, duration - share * duration)
    assert (x + change, v) == pytest.approx(whole, rel=1e-7, abs=1e-11)


@settings(max_examples=300, deadline=None)
@given(st.floats(1e-3, 0.1), st.sampled_from([-1.0, 1.0]), forces)
def test_a_short_step_moves_as_the_equation_says(speed, way, force):
    v, dt = way * speed, 1e-9
    change, after = stepped(v, force, dt)
    assert change / dt == pytest.approx(v, abs=1e-7)
    assert (after - v) / dt == pytest.approx((force - friction(v) - 0.15 * v) / M, abs=1e-3)


@pytest.mark.parametrize('way', [-1.0, 1.0])
def test_at_rest_it_takes_more_than_the_friction_at_rest_to_break_loose(way):
    assert stepped(0.0, way * F_S, 1.0) == (0.0, 0.0)
    assert stepped(0.0, way * 1.3, 1.0) == (0.0, 0.0)  # above F_c
    position, velocity = stepped(0.0, way * 1.7, 1e-4)
    rate = ((F_S - F_C) / FAST - 0.15) / M
    assert velocity * way == pytest.approx(0.1 / M * math.expm1(rate * 1e-4) / rate, rel=1e-12)
    assert position * way > 0.0


def test_a_sliding_axis_stops_at_an_instant_and_stays():
    brake = stepped(1e-3, 0.0, 1.0)
    assert brake[1] == 0.0
    rate = (0.15 - (F_S - F_C) / FAST) / M
    start = -F_S / M - rate * 1e-3
    until = -math.log1p(1e-3 * rate / start) / rate
    times = np.linspace(0.0, until, 20_001)
    speeds = 1e-3 + start * -np.expm1(-rate * times) / rate
    assert brake[0] == pytest.approx(np.trapezoid(speeds, times), rel=1e-8)
    assert stepped(1e-3, 0.0, until) == pytest.approx((brake[0], 0.0), abs=1e-15)


@settings(max_examples=200, deadline=None)
@given(velocities, forces, st.floats(1e-5, 1e-2))
def test_with_no_more_friction_at_rest_it_is_coulombs(velocity, force, duration):
    assert stribeck_step(0.0, velocity, force, 0.15, M, F_C, F_C, FAST, duration) == (
        pytest.approx(axis_step(0.0, velocity, force, 0.15, M, F_C, duration), abs=1e-13)
    )


@settings(max_examples=300, deadline=None)
@given(velocities, forces, st.floats(1e-9, 1.0))
@example(5e-324, 1.5625, 0.25)  # a product of these signs is 0
@example(-5e-324, -1.6, 0.25)  # a quotient by the acceleration overflows
def test_friction_only_takes_energy(velocity, force, duration):
    position, after = stribeck_step(
        0.0, velocity, force, 0.15, M, F_C, F_S, 1e-6 if duration < 0.5 else FAST, duration
    )
    assert math.isfinite(position)
    gained = 0.5 * M * (after**2 - velocity**2)
    assert gained <= force * position + 1e-12
