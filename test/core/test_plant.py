"""The exact step of the axis, against closed forms evaluated in high precision."""

from hypothesis import assume, given, settings, strategies as st
from mpmath import exp, expm1, findroot, log, mp, mpf
import numpy as np
import pytest

from impulse_control_ros.core.plant import axis_step, long_step, shapes, short_step

mp.dps = 40
STEP = 1e-4


def reference(x, v, u, d, m, friction, duration):
    """Move by the textbook solution of m v' = (u - F s) - d v, and stop where v is zero."""
    x, v, u, d, m, friction, duration = map(mpf, (x, v, u, d, m, friction, duration))
    while duration > 0:
        if v == 0:
            if abs(u) <= friction:
                return x, v
            s = 1 if u > 0 else -1
        else:
            s = 1 if v > 0 else -1
        final = (u - friction * s) / d
        tau = m / d
        stop = None
        if v != 0 and v * final < 0:
            stop = tau * log((v - final) / -final)
        step = duration if stop is None or stop > duration else stop
        x += final * step + (v - final) * tau * -expm1(-step / tau)
        v = mpf(0) if step == stop else final + (v - final) * exp(-step / tau)
        duration -= step
    return x, v


CASES = {
    'viscous': (0.5, -3.0, 5.0, 0.15, 0.1, 0.0),
    'friction without a stop': (0.1, 2.0, -1.0, 1.5, 0.1, 1.0),
    'stops and sticks': (0.04, -5e-4, 0.3, 0.15, 0.1, 1.0),
    'stops and turns': (0.04, -5e-4, 30.0, 0.15, 0.1, 1.0),
    'turns without friction': (0.04, -5e-4, 30.0, 0.15, 0.1, 0.0),
    'sticks at rest': (0.04, 0.0, -1.0, 0.15, 0.1, 1.0),
    'breaks free': (0.04, 0.0, -1.5, 0.15, 0.1, 1.0),
    'a pulse': (0.5, 0.0, -3750.0, 0.15, 0.1, 1.0),
    'very stiff damping': (0.5, 3.0, 1.0, 1e6, 0.1, 1.0),
}


@pytest.mark.parametrize('case', CASES)
def test_one_step_is_the_closed_form(case):
    x, v = axis_step(*CASES[case], STEP)
    expected_x, expected_v = reference(*CASES[case], STEP)
    assert x == pytest.approx(float(expected_x), rel=1e-15, abs=1e-18)
    assert v == pytest.approx(float(expected_v), rel=1e-12, abs=2e-15)


quantity = st.floats(-10.0, 10.0, allow_subnormal=False)
positive = st.floats(1e-3, 10.0)


@settings(max_examples=300, deadline=None)
@given(
    quantity,
    quantity,
    quantity,
    positive,
    positive,
    st.floats(0.0, 3.0),
    st.sampled_from([1e-5, 1e-4, 1e-2, 0.3]),
)
def test_any_step_is_the_closed_form(x, v, u, d, m, friction, duration):
    assume(abs(abs(u) - friction) > 1e-9)
    assume(v == 0.0 or abs(v) > 1e-9)
    got_x, got_v = axis_step(x, v, u, d, m, friction, duration)
    want_x, want_v = reference(x, v, u, d, m, friction, duration)
    assert got_x == pytest.approx(float(want_x), rel=1e-12, abs=1e-12)
    assert got_v == pytest.approx(float(want_v), rel=1e-9, abs=1e-11)


@settings(max_examples=300, deadline=None)
@given(
    quantity,
    st.floats(-0.01, 0.01),
    quantity,
    positive,
    positive,
    st.floats(0.0, 20.0),
    st.sampled_from([1e-5, 1e-4, 1e-3]),
)
def test_a_short_step_is_the_long_one_whenever_it_is_whole(x, v, u, d, m, friction, duration):
    got_x, got_v, whole = short_step(x, v, u, d, 1.0 / m, friction, duration)
    want_x, want_v = long_step(x, v, u, d, m, friction, duration)
    turns = v != 0.0 and abs(u) > friction and np.sign(want_v) != np.sign(v)
    assert whole == (d * (1.0 / m) * duration < 1e-2 and not turns)
    if whole:
        assert got_x == pytest.approx(want_x, rel=1e-13, abs=1e-15)
        assert got_v == pytest.approx(want_v, rel=1e-10, abs=1e-14)


@settings(max_examples=200, deadline=None)
@given(quantity, quantity, quantity, positive, positive, st.floats(0.0, 3.0))
def test_a_step_is_two_half_steps(x, v, u, d, m, friction):
    assume(abs(abs(u) - friction) > 1e-9)
    assume(v == 0.0 or abs(v) > 1e-9)
    half = axis_step(x, v, u, d, m, friction, 0.005)
    twice = axis_step(*half, u, d, m, friction, 0.005)
    assert twice == pytest.approx(axis_step(x, v, u, d, m, friction, 0.01), rel=1e-9, abs=1e-11)


@settings(deadline=None)
@given(quantity, st.floats(-1.0, 1.0), positive, positive)
def test_an_axis_at_rest_sticks_exactly_while_the_effort_is_within_the_friction(x, u, d, m):
    assert axis_step(x, 0.0, u, d, m, 1.0, STEP) == (x, 0.0)


def test_the_stop_is_found_inside_the_sample():
    v, d, m, friction = -5e-4, 0.15, 0.1, 1.0
    stop = findroot(lambda t: (friction / d) - (friction / d - v) * exp(-mpf(d) / m * t), 5e-5)
    assert 0 < stop < STEP
    before, _ = axis_step(0.0, v, 0.0, d, m, friction, float(stop))
    assert axis_step(0.0, v, 0.0, d, m, friction, STEP) == (
        pytest.approx(before, rel=1e-9, abs=0.0),
        0.0,
    )


@settings(max_examples=300, deadline=None)
@given(
    st.floats(-3.0, 3.0),
    st.sampled_from([0.0, 1.0]),
    st.floats(1e-2, 50.0),
    st.floats(1e-2, 1.0),
    st.sampled_from([1e-4, 1e-2, 1.0]),
)
def test_a_motion_that_decays_without_a_stop_stays_finite(v, friction, d, m, duration):
    effort = friction if v > 0.0 else -friction
    assert np.isfinite(axis_step(0.0, v, effort, d, m, friction, duration)).all()


@pytest.mark.parametrize('z', [0.0, 1e-12, 1e-5, 9.999e-3, 1.0001e-2, 0.5, 40.0])
def test_the_shapes_are_exact_on_both_sides_of_their_switch(z):
    phi1 = mpf(1) if z == 0 else -expm1(-mpf(z)) / z
    phi2 = mpf(1) / 2 if z == 0 else (1 - phi1) / z
    assert shapes(z)[0] == pytest.approx(float(phi1), rel=3e-16, abs=0.0)
    assert shapes(z)[1] == pytest.approx(float(phi2), rel=3e-14, abs=0.0)


@settings(max_examples=100, deadline=None)
@given(quantity, quantity, positive, positive, st.floats(0.0, 3.0))
def test_a_free_axis_never_gains_energy(x, v, d, m, friction):
    _, after = axis_step(x, v, 0.0, d, m, friction, 0.01)
    assert abs(after) <= abs(v)
    assert after * v >= 0.0
