"""Figures of merit, against what is known in closed form."""

import numpy as np
import pytest

from impulse_control_ros.core.metrics import first_position_zero, overshoot, peak, settling_time

TIME = np.arange(6) * 0.5


@pytest.mark.parametrize(('error', 'expected'), [
    ([1.0, 0.5, 0.05, 0.2, 0.05, 0.01], 2.0), ([0.01] * 6, 0.0),
    ([1.0, -1.0, -0.1, 0.1, 0.0, 0.0], 1.0)])
def test_settling_is_for_good(error, expected):
    assert settling_time(TIME, np.array(error), 0.1) == expected


def test_what_never_settles_has_no_settling_time():
    assert np.isnan(settling_time(TIME, np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 0.1))


@pytest.mark.parametrize('sign', [-1.0, 1.0])
def test_overshoot_is_the_way_to_the_other_side(sign):
    assert overshoot(sign * np.array([1.0, 0.2, -0.3, 0.4, -0.1])) == 0.3
    assert overshoot(sign * np.array([1.0, 0.2, 0.1])) == 0.0


def test_the_first_zero_is_the_first_sample_at_or_past_it():
    assert first_position_zero(np.array([1.0, 0.5, 0.0, -1.0])) == 2
    assert first_position_zero(np.array([-1.0, -0.5, 0.25])) == 2
    assert first_position_zero(np.array([1.0, 0.5])) is None


def test_a_peak_has_no_sign():
    assert peak(np.array([1.0, -4.0, 2.0])) == 4.0
