"""The guaranteed window of the first zero, against adversaries that choose d(t)."""

from dataclasses import replace
import math

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.flow import first_zero, flow
from impulse_control_ros.core.plant import axis_step, Plant
from impulse_control_ros.core.promise import (
    first_zero_sample,
    gains_for,
    peak_effort,
    promise_of,
)
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import ParameterError

RANGE = (0.15, 1.3)
GAINS = ControlGains()


def first_zero_of(gains, dampings, lengths):
    """Return when the ideal loop first has e = 0 under d(t) constant in pieces."""
    e, v, time = 1.0, -gains.d_bar / (gains.c * gains.m) if gains.impulses else 0.0, 0.0
    for d, length in zip(dampings, [*lengths, math.inf], strict=True):
        rate, stiffness = (d + gains.D) / (2.0 * gains.m), gains.K / gains.m
        zero = first_zero(e, v + rate * e, rate, stiffness)
        if zero <= length:
            return time + zero
        e, v = flow(e, v, -1.0, rate, stiffness, 0.0, length)
        time += length
    raise AssertionError('the last piece has no end')


def hardest(gains, low, high, sign, seed, rounds=150):
    """Return the latest (sign 1) or earliest (-1) zero that a random search of d(t) finds."""
    rng = np.random.default_rng(seed)
    horizon = first_zero_of(gains, [high], [])

    def tried(values, lengths):
        return sign * first_zero_of(gains, values, lengths)

    values, lengths = rng.choice([low, high], 8), rng.uniform(0.0, horizon / 4.0, 7)
    best = tried(values, lengths)
    for _ in range(rounds):
        other = values.copy()
        other[rng.integers(8)] = rng.choice([low, high, rng.uniform(low, high)])
        moved = np.maximum(lengths + rng.normal(0.0, horizon / 20.0, 7) * rng.integers(0, 2, 7), 0)
        if (found := tried(other, moved)) >= best:
            best, values, lengths = found, other, moved
    return sign * best


@settings(max_examples=30)
@given(
    st.floats(0.02, 2.0),
    st.floats(0.05, 0.98),
    st.floats(0.0, 3.0),
    st.floats(1.0, 200.0),
    st.booleans(),
    st.integers(0, 2**31),
)
def test_no_course_of_the_damping_leaves_the_window_of_the_first_zero(
    low, part, D, K, impulses, seed
):
    d_bar = 2.5
    high = low + part * (d_bar - low)
    gains = ControlGains(K=K, D=D, d_bar=d_bar, impulses=impulses)
    earliest, latest = promise_of(gains, (low, high), 0.5).first_zero
    if math.isinf(latest):
        return
    assert hardest(gains, low, high, 1, seed) <= latest * (1 + 1e-9)
    assert hardest(gains, low, high, -1, seed) >= earliest * (1 - 1e-9)


def test_the_window_of_table_i_is_attained_at_both_ends():
    earliest, latest = promise_of(GAINS, RANGE, 0.5).first_zero
    assert earliest == pytest.approx(0.12143680500, abs=1e-11)
    assert latest == pytest.approx(0.43640068504, abs=1e-11)
    for d, end in zip(RANGE, (earliest, latest), strict=True):
        assert first_zero_of(GAINS, [d, d], [0.05]) == pytest.approx(end, abs=1e-15)


def sampled_zero(gains, dampings, switch):
    """Return the first sample with e <= 0; d switches within each sample, at ``switch`` of it."""
    dt, x, v = gains.time_step, 1.0, 0.0
    effort = -gains.K - gains.d_bar / (gains.c * dt)
    for k, (first, second) in enumerate(dampings, 1):
        x, v = axis_step(x, v, effort, first, gains.m, 0.0, switch * dt)
        x, v = axis_step(x, v, effort, second, gains.m, 0.0, (1.0 - switch) * dt)
        if x <= 0.0:
            return k
        effort = -gains.K * x - gains.D * v
    raise AssertionError('the axis does not reach e = 0')


@settings(max_examples=30)
@given(
    st.sampled_from([1e-4, 1e-3, 5e-3]),
    st.floats(0.0, 0.5),
    st.integers(0, 2**31),
    st.sampled_from([1, 3, 50]),
)
def test_no_course_of_the_damping_leaves_the_window_of_the_sampled_loop(dt, D, seed, hold):
    gains = ControlGains(D=D, time_step=dt)
    promise = promise_of(gains, RANGE, -0.2)
    assert promise.is_guaranteed
    earliest, latest = (round(time / dt) for time in promise.first_zero_sampled)
    rng = np.random.default_rng(seed)
    for at_the_end in (RANGE[0], RANGE[1], None):
        course = np.repeat(rng.choice(RANGE, (latest // hold + 1, 2)), hold, axis=0)[:latest]
        if at_the_end:  # bang-bang, which ends at one bound
            course[rng.integers(len(course)) :] = at_the_end
        assert earliest <= sampled_zero(gains, course, rng.uniform(0.1, 0.9)) <= latest


@pytest.mark.parametrize('dt', [1e-4, 1e-3])
@pytest.mark.parametrize('d', [0.15, 0.7, 1.3])
def test_the_sampled_window_is_that_of_the_simulated_loop(d, dt):
    gains = ControlGains(time_step=dt, position_deadband=0.0)
    plant = Plant(F_c=0.0, time_step=dt, damping=Damping(value=d))
    run = simulate(plant, gains, 0.6)
    assert first_zero_sample(gains, d) == int(np.argmax(run.position <= 0.0))


def test_damping_noise_stays_within_the_sampled_window():
    earliest, latest = promise_of(GAINS, RANGE, 0.5).first_zero_sampled
    for seed in range(20):
        damping = Damping(kind='noise', lower=RANGE[0], upper=RANGE[1], seed=seed)
        run = simulate(Plant(F_c=0.0, damping=damping), GAINS, 0.5)
        zero = run.time[np.argmax(run.position <= 0.0)]
        assert earliest - 1e-9 <= zero <= latest + 1e-9


@pytest.mark.parametrize(
    ('gains', 'F_c', 'why'),
    [
        (GAINS, 1.0, 'friction'),
        (replace(GAINS, effort_limit=100.0), 0.0, 'effort_limit'),
        (replace(GAINS, d_bar=1.2), 0.0, 'd_bar'),
        (replace(GAINS, time_step=0.1), 0.0, 'time_step'),
        (replace(GAINS, K_i=1.0), 0.0, 'K_i'),
        (replace(GAINS, position_deadband=0.6), 0.0, 'position_deadband'),
    ],
)
def test_what_is_outside_the_argument_makes_the_promise_a_prediction(gains, F_c, why):
    promise = promise_of(gains, RANGE, 0.5, F_c)
    assert not promise.is_guaranteed
    assert any(why in sentence for sentence in promise.predicted)


def test_friction_breaks_the_window():
    plant = Plant(F_c=1.0, x_0=0.5, damping=Damping(value=1.3))
    run = simulate(plant, GAINS, 0.6)
    assert run.position.min() > 0.0  # the window would end at 0.436 s


@pytest.mark.parametrize('d_range', [(0.0, 1.0), (1.0, 0.5), (0.1, math.inf)])
def test_a_range_that_is_none_is_refused(d_range):
    with pytest.raises(ParameterError, match='damping_range'):
        promise_of(GAINS, d_range, 0.5)


@pytest.mark.parametrize('time', [0.05, 0.5])
def test_the_gains_for_a_settling_time_promise_it_at_the_least_peak_effort(time):
    gains = gains_for(time, RANGE, 0.5, GAINS)
    promise = promise_of(gains, RANGE, 0.5)
    assert promise.is_guaranteed
    assert time - 20 * gains.time_step < promise.first_zero_sampled[1] <= time * (1 + 1e-9)
    assert (gains.d_bar + gains.D) ** 2 == pytest.approx(4.0 * gains.m * gains.K)
    rng = np.random.default_rng(1)
    for d_bar, K in zip(rng.uniform(1.31, 8.0, 400), 10.0 ** rng.uniform(0, 3, 400), strict=True):
        D = 2.0 * math.sqrt(GAINS.m * K) - d_bar
        if D >= 0.0:
            other = replace(GAINS, K=K, D=D, d_bar=d_bar)
            if promise_of(other, RANGE, 0.5).first_zero[1] <= time:
                assert peak_effort(other, RANGE[0], 0.5) > promise.peak_effort * (1 - 1e-3)


def test_a_settling_time_of_a_few_samples_is_refused():
    with pytest.raises(ParameterError, match='settling_time = 0.0002'):
        gains_for(2e-4, RANGE, 0.5, GAINS)
