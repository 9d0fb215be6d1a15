"""Figures of merit, against what is known in closed form."""

import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.metrics import (
    COUNTS,
    figures,
    first_position_zero,
    impulsive,
    integral,
    overshoot,
    peak,
    settling_time,
    stuck,
    work,
)
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate

TIME = np.arange(6) * 0.5


@pytest.mark.parametrize(
    ('error', 'expected'),
    [
        ([1.0, 0.5, 0.05, 0.2, 0.05, 0.01], 2.0),
        ([0.01] * 6, 0.0),
        ([1.0, -1.0, -0.1, 0.1, 0.0, 0.0], 1.0),
    ],
)
def test_settling_is_for_good(error, expected):
    assert settling_time(TIME, np.array(error), 0.1) == expected


def test_what_never_settles_has_no_settling_time():
    assert np.isnan(settling_time(TIME, np.array([1.0, 0.0, 0.0, 0.0, 0.0, 1.0]), 0.1))
    assert np.isnan(settling_time(TIME, np.array([1.0, 0.0, 0.0, 0.0, 0.0, np.nan]), 0.1))


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


NO_EVENTS = np.zeros(0, [('tick', 'i8'), ('guard', 'i8'), ('area', 'f8')])


@pytest.mark.parametrize('rate', [1.0, 3.0])
def test_the_integrals_are_those_of_the_trapezoidal_rule(rate):
    time = np.arange(50_001) * 1e-4
    error = -0.5 * np.exp(-rate * time)
    result = figures(time, error, rate * error, 0.0 * error, NO_EVENTS, [])[0]
    whole = 1.0 - np.exp(-5.0 * rate), 1.0 - np.exp(-10.0 * rate)
    assert result['iae'] == pytest.approx(0.5 / rate * whole[0], rel=1e-7)
    assert result['ise'] == pytest.approx(0.125 / rate * whole[1], rel=1e-7)
    assert result['iae'] == pytest.approx(np.trapezoid(np.abs(error), time), rel=1e-12)
    assert result['ise'] == pytest.approx(np.trapezoid(error**2, time), rel=1e-12)


@pytest.mark.parametrize(
    'axis', [Plant(F_c=0.0), Plant(F_c=1.0, x_0=-0.15), Plant(F_c=0.0, v_0=9.0)]
)
def test_all_figures_at_once_are_the_figures_one_by_one(axis):
    run, tolerances = simulate(axis, ControlGains(x_r=0.01), 0.5), (1e-2, 1e-3, 1e-9)
    error = run.position - 0.01
    result = figures(run.time, error, run.velocity, run.effort, run.events, tolerances)[0]
    assert result['settling_time'] == pytest.approx(
        [settling_time(run.time, error, tolerance) for tolerance in tolerances],
        abs=0.0,
        nan_ok=True,
    )
    assert result['overshoot'] == overshoot(error)
    assert result['peak_effort'] == peak(run.effort)
    assert result['peak_velocity'] == peak(run.velocity)
    assert result['final_error'] == error[-1]
    assert result['impulse_area'] == pytest.approx(np.abs(run.events['area']).sum(), rel=1e-12)
    for name in COUNTS:
        assert result[name] == np.count_nonzero(run.events['guard'] == GUARDS.index(name))


def test_an_integral_follows_the_time_where_samples_are_missing():
    time = np.array([0.0, 0.1, 0.2, 0.7, 1.0])
    assert integral(time, 3.0 * time) == pytest.approx(1.5, rel=1e-12)


def test_work_is_effort_times_way_until_the_next_sample():
    assert work(np.array([0.0, 2.0, 1.0]), np.array([3.0, 5.0, 100.0])) == 1.0


def test_only_what_follows_an_impulse_without_a_gap_is_its_effort():
    feedback = np.full(8, 1.0)
    effort = np.array([1.0, 3.0, 1.0, 5.0, 4.0, 1.0, 2.0, 9.0])
    fired = np.array([0, 0, 0, 1, 0, 0, 0, 1], bool)
    assert impulsive(effort, feedback, fired).tolist() == [0, 0, 0, 4, 3, 0, 0, 8]
    assert impulsive(effort, feedback, np.zeros(8, bool)).tolist() == [0] * 8


def test_an_axis_is_stuck_from_the_second_sample_that_it_stands():
    time, error = np.arange(8) * 0.5, np.array([1, 1, 1, 1, 1, 1, 0, 0.0])
    assert stuck(time, np.array([0, 1, 0, 0, 0, 1, 0, 0.0]), error) == (1, 1.0)
    assert stuck(time, np.array([0, 0, 1, 0, 0, 0, 0, 0.0]), error) == (2, 1.5)
    assert stuck(time, np.array([0, 1, 0, 1, 0, 1, 0, 1.0]), error) == (0, 0.0)


def test_what_cannot_be_computed_is_nan():
    time, unknown = np.arange(3.0), np.array([1.0, np.nan, 1.0])
    assert np.isnan([overshoot(unknown), peak(unknown), *stuck(time, unknown, time)]).all()
