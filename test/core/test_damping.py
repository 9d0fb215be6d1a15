"""Damping profiles: inside the bounds of (1), reproducible, of the declared spectrum."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.damping import Damping, damping_at, packed_damping, sine, white

STEP = 1e-4


def profile(damping, count):
    packed, noise = packed_damping(damping.flat(), STEP, 1)[0], 0.0
    values = np.empty(count)
    for tick in range(count):
        values[tick], noise = damping_at(packed, noise, tick)
    return values


@settings(max_examples=50, deadline=None)
@given(
    st.sampled_from(['noise', 'sinusoidal']),
    st.floats(1e-3, 5.0),
    st.floats(0.0, 5.0),
    st.floats(0.1, 1e4),
    st.integers(0, 2**63 - 1),
)
def test_the_bounds_are_never_broken(kind, lower, width, bandwidth, seed):
    damping = Damping(kind=kind, lower=lower, upper=lower + width, bandwidth=bandwidth, seed=seed)
    values = profile(damping, 300)
    assert values.min() >= damping.lower
    assert values.max() <= damping.upper


def test_a_constant_profile_is_its_value():
    assert (profile(Damping(value=0.7), 10) == 0.7).all()


def test_a_sinusoid_swings_between_the_bounds_at_its_frequency():
    values = profile(Damping(kind='sinusoidal', bandwidth=5.0), 2000)
    expected = 0.825 + 0.675 * np.sin(2 * np.pi * 5.0 * STEP * np.arange(2000))
    assert values == pytest.approx(expected, rel=1e-12)


@settings(max_examples=300, deadline=None)
@given(st.floats(0.0, 1e4))
def test_the_sine_is_the_sine(turns):
    assert sine(turns) == pytest.approx(np.sin(2.0 * np.pi * (turns % 1.0)), abs=1e-15)


def test_a_seed_gives_the_same_bits_and_another_seed_others():
    first, again, other = (profile(Damping(kind='noise', seed=seed), 500) for seed in (3, 3, 4))
    assert first.tobytes() == again.tobytes()
    assert not np.isclose(first, other).any()


def test_the_white_noise_is_uniform_and_uncorrelated():
    values = np.array([white(1, tick) for tick in range(200_000)])
    assert abs(values.mean()) < 0.01
    assert values.var() == pytest.approx(1.0, abs=0.01)
    assert np.abs(values).max() <= np.sqrt(3.0)
    assert np.histogram(values, 10)[0] == pytest.approx(np.full(10, 20_000), rel=0.03)
    assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 0.01
    assert abs(np.corrcoef(values, [white(2, tick) for tick in range(200_000)])[0, 1]) < 0.01


def test_the_noise_profile_has_the_declared_mean_deviation_and_corner():
    damping = Damping(kind='noise', lower=1.0, upper=6.0, bandwidth=500.0)
    values = profile(damping, 100_000)
    assert values.mean() == pytest.approx(3.5, abs=0.05)
    assert values.std() == pytest.approx(1.0, abs=0.05)
    pole = np.corrcoef(values[1:], values[:-1])[0, 1]
    assert pole == pytest.approx(np.exp(-2 * np.pi * 500.0 * STEP), abs=0.01)
