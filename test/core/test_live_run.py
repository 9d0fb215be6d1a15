"""What a display keeps of a run."""

import math

import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.live_run import EARLY, IMPULSES, LiveRun, SAMPLES
from impulse_control_ros.core.tick import SECOND

LAW = ControlGains(K=10.0, D=0.5, m=0.1, x_r=0.2).flat()
MS = SECOND // 1000


@pytest.fixture
def run():
    made = LiveRun()
    made.law = LAW
    return made


def fill(run, count, name='a', first=0):
    for at in range(first, first + count):
        run.add_state(at * 1e-3, name, SECOND + at * MS, 0.5, -1.0, 3.0)


def test_the_feedback_is_that_of_the_law_and_stays_within_the_effort_limit(run):
    fill(run, 1)
    (row,) = zip(*run.samples.columns(0).values(), strict=True)
    time, position, setpoint, error, velocity, effort, feedback = row
    assert (time, position, setpoint, velocity, effort) == (1.0, 0.5, 0.2, -1.0, 3.0)
    assert error == pytest.approx(0.3)
    assert feedback == pytest.approx(-10.0 * 0.3 + 0.5)
    run.law = LAW | {'effort_limit': 1.0}
    assert run.feedback(0.3, -1.0) == -1.0


def test_of_a_foreign_law_the_positions_are_shown_and_no_feedback(run):
    run.law = {'gain': 3.0}
    fill(run, 1)
    columns = run.samples.columns(0)
    assert columns['error'] == [0.5]
    assert math.isnan(columns['feedback'][0])
    assert math.isnan(columns['setpoint'][0])


def test_an_impulse_jumps_by_its_area_over_the_mass(run):
    fill(run, 1)
    run.add_impulse('a', SECOND, 0.5, 2.0, -0.4, 'position_zero')
    assert run.impulses.columns(0)['after'] == [pytest.approx(2.0 - 0.4 / 0.1)]
    assert run.fired == {'position_zero': 1}
    assert run.last == {'position_zero': (1.0, -0.4)}


def test_rows_are_bounded_and_their_count_is_not(run):
    fill(run, SAMPLES + 10)
    for at in range(IMPULSES + 5):
        run.add_impulse('a', SECOND + at, 0.0, 1.0, 0.1, 'sticking')
    assert (run.samples.count, run.impulses.count) == (SAMPLES + 10, IMPULSES + 5)
    assert len(run.samples.columns(0)['time']) == SAMPLES
    assert len(run.impulses.columns(0)['time']) == IMPULSES
    assert run.samples.columns(SAMPLES + 8)['time'] == pytest.approx(
        [1.0 + (SAMPLES + at) * 1e-3 for at in (8, 9)]
    )
    assert run.samples.columns(SAMPLES + 10)['time'] == []


def test_repeated_states_and_impulses_count_once(run):
    fill(run, 2)
    run.add_state(0.1, 'a', SECOND + MS, 0.5, -1.0, 3.0)
    for stamp in (SECOND, SECOND + MS, SECOND + MS):
        run.add_impulse('a', stamp, 0.5, 0.0, -0.4, 'sticking')
    assert (run.samples.count, run.fired) == (2, {'sticking': 2})


def test_another_run_and_a_clock_that_goes_back_begin_afresh(run):
    fill(run, 5)
    run.add_impulse('a', SECOND, 0.5, 2.0, -0.4, 'sticking')
    assert run.episode == 1
    fill(run, 3, 'b')
    assert (run.episode, run.samples.count, run.impulses.count, run.fired) == (2, 3, 0, {})
    run.add_state(9.0, 'b', SECOND, 0.0, 0.0, 0.0)
    assert (run.episode, run.samples.count) == (3, 1)


def test_an_impulse_that_overtakes_the_first_state_of_its_run_is_kept(run):
    run.add_impulse('a', SECOND, 0.5, 0.0, -0.4, 'velocity_zero')
    assert run.impulses.count == 0
    fill(run, 1)
    assert run.fired == {'velocity_zero': 1}
    for at in range(EARLY + 5):
        run.add_impulse('b', SECOND + at, 0.5, 0.0, -0.4, 'velocity_zero')
    fill(run, 1, 'b')
    assert run.fired == {'velocity_zero': EARLY}


def test_the_rates_are_those_of_the_last_second(run):
    for at in range(3000):
        fill(run, 1, first=at)
        if at >= 1000 and at % 10 == 0:
            run.add_impulse('a', SECOND + at * MS, 0.0, 1.0, 0.1, 'sticking')
    assert run.speed.value(now=3.0) == pytest.approx(1.0)
    assert run.speed.value(now=5.1) == 0.0  # paused
    assert run.impulse_rate.value() == pytest.approx(100.0, rel=0.05)


def test_a_time_on_the_wall_clock_is_shown_from_the_first_state_on(run):
    wall = 1_700_000_000 * SECOND
    run.add_state(0.0, '', wall, 0.0, 0.0, 0.0)
    run.add_state(0.1, '', wall + 100 * MS, 0.0, 0.0, 0.0)
    assert run.samples.columns(0)['time'] == pytest.approx([0.0, 0.1])
