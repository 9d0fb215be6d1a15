"""The law on real signals: each pitfall of encoders, noise and delay, and what ends it."""

from dataclasses import replace
from functools import partial
import math

import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import (
    COMMAND,
    control_in_place,
    POSITION_ZERO,
    STATES,
    STICKING,
    VELOCITY_ZERO,
)
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.nonidealities import Actuator, Disturbance, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import Run, simulate
from impulse_control_ros.core.supervision import SUPERVISION

M, K, STEP = 0.1, 10.0, 1e-4
Q = 2 * math.pi * 0.1 / 4096  # an encoder of 4096 steps a turn on a wheel of radius 0.1 m
NOISY = Sensor(resolution=Q, velocity_noise=1e-2)
paper_gains = partial(ControlGains, supervision=False)
WARY = paper_gains(position_deadband=1.5 * Q, velocity_deadband=0.05)  # 1.5 steps, 5 sigma
AT_REST = 2.0  # s, from which on a run of 4 s is judged


def answers(samples, gains):
    """Answer (position, velocity) or (position, velocity, x_r), nan for no velocity."""
    state, command, told = np.zeros(STATES), np.zeros(1, COMMAND), []
    memory = np.zeros(1, SUPERVISION)
    for position, velocity, *x_r in samples:
        law = replace(gains, x_r=x_r[0]) if x_r else gains
        control_in_place(state, memory, law.packed().view(float), position, velocity, command)
        told.append(command[0].copy())
    return np.array(told, COMMAND)


def impulses_per_second(run: Run) -> float:
    return float(np.sum(run.events['tick'] * STEP >= AT_REST) / (run.time[-1] - AT_REST))


def farthest(run: Run) -> float:
    """Return the largest error at rest in steps of the encoder."""
    return float(np.abs(run.position[run.time >= AT_REST]).max() / Q)


def energy(run: Run) -> np.ndarray:
    """Return what each impulse puts into the axis [J]."""
    area, v = run.events['area'], run.velocity[run.events['tick']]
    return area * v + area**2 / (2 * M)


# -- the dead bands ---------------------------------------------------------------------------


@pytest.mark.parametrize('seed', range(1, 6))
@pytest.mark.parametrize('F_c', [0.0, 0.1, 1.0])
@pytest.mark.parametrize('damping', [0.15, 1.0])
def test_an_encoder_and_noise_leave_no_impulse_at_rest_and_two_steps_of_error(seed, F_c, damping):
    axis = Plant(F_c=F_c, damping=Damping(value=damping), sensor=replace(NOISY, seed=seed))
    run = simulate(axis, WARY, 4.0)
    assert impulses_per_second(run) == 0.0
    assert farthest(run) < 2.0
    assert energy(run)[run.events['tick'] * STEP >= AT_REST].sum() == 0.0
    # and on the way there, less than the spring holds at the start
    assert energy(run).clip(0.0).sum() < 0.5 * K * axis.x_0**2


def test_without_dead_bands_the_same_signals_storm():
    run = simulate(Plant(F_c=1.0, sensor=NOISY), paper_gains(), 4.0)
    assert impulses_per_second(run) > 1000.0


def test_an_impulse_at_a_stand_puts_in_less_than_the_spring_gives_back():
    for guard, position in ((VELOCITY_ZERO, 0.3), (STICKING, 0.3), (STICKING, 1e-3)):
        told = answers([(position, 0.0)] * 2, paper_gains())[0 if guard == VELOCITY_ZERO else 1]
        assert told['guard'] == guard
        assert told['area'] ** 2 / (2 * M) < 0.6 * 0.5 * K * position**2


@pytest.mark.parametrize('F_c', [0.0, 0.3, 1.0])
def test_differences_of_an_encoder_storm_until_a_crossing_counts_once(F_c):
    axis = Plant(F_c=F_c, sensor=Sensor(resolution=Q, velocity='difference'))
    storm = simulate(axis, WARY, 4.0)
    assert impulses_per_second(storm) > 1000.0  # one step is a velocity of 1.5 m/s
    assert farthest(storm) > 10.0
    calm = simulate(axis, replace(WARY, position_hysteresis=5e-3), 4.0)
    assert impulses_per_second(calm) == 0.0
    assert farthest(calm) < 2.0


# -- the options, guard by guard --------------------------------------------------------------


def test_half_a_sample_of_lead_halves_the_delay_of_a_position_zero():
    late = {}
    for lead in (0.0, 0.5):
        phases = np.linspace(0.005, 0.995, 100)
        fired = []
        for phase in phases:  # the crossing is at sample 5 + phase
            samples = [((5 + phase - k) * 2.0 * STEP, -2.0) for k in range(10)]
            guards = answers(samples, paper_gains(guard_lookahead=lead))['guard']
            assert list(guards[guards > 0]) == [POSITION_ZERO]
            fired.append(np.flatnonzero(guards)[0] - 5 - phase)
        late[lead] = np.abs(fired)
    assert (late[0.0].mean(), late[0.0].max()) == pytest.approx((0.5, 1.0), abs=0.01)
    assert (late[0.5].mean(), late[0.5].max()) == pytest.approx((0.25, 0.5), abs=0.01)


@pytest.mark.parametrize('lead', [0.0, 0.5, 1.0])
def test_the_dead_band_is_one_of_the_error_whatever_the_lead(lead):
    gains = replace(WARY, guard_lookahead=lead)
    edge = gains.position_deadband
    assert not answers([(edge - 1e-7, 2.0), (edge - 1e-7, 0.04)] * 9, gains)['guard'].any()
    assert answers([(edge + 1e-7, -2.0), (edge + 1e-7, -0.04)], gains)['guard'][1] == (
        VELOCITY_ZERO
    )


def fired_at(samples, gains):
    """Return the samples at which a position zero fires."""
    return list(np.flatnonzero(answers(samples, gains)['guard'] == POSITION_ZERO))


def test_a_crossing_is_armed_again_by_the_error_that_the_guards_see():
    h = 1e-3
    ahead = [(2 * h, -2.0), (0.1 * h, -2.0), (0.9 * h, 2.0), (0.1 * h, -2.0)]  # 2 m/s: 0.2 h
    assert fired_at(ahead, paper_gains(guard_lookahead=1.0, position_hysteresis=h)) == [1, 3]
    behind = [(2 * h, -2.0), (-0.1 * h, -2.0), (-1.1 * h, 2.0), (0.1 * h, 2.0)]
    assert fired_at(behind, paper_gains(guard_lookahead=1.0, position_hysteresis=h)) == [1]


def test_a_crossing_that_hold_off_lets_pass_counts_for_nothing():
    h = 1e-3
    samples = [(2 * h, -2.0), (-2 * h, -2.0), (0.5 * h, 2.0), (-0.5 * h, -2.0)]
    assert fired_at(samples, paper_gains(hold_off=1, position_hysteresis=h)) == [1, 3]
    zigzag = [((-1) ** k * h, 2.0) for k in range(60)]
    assert np.diff(fired_at(zigzag, paper_gains(hold_off=5, guard_lookahead=1e-9))).min() == 6


def test_a_sample_that_is_zero_ahead_is_the_crossing_and_the_next_is_not():
    lead = [(3e-4, -2.0), (1e-4, -2.0), (-1e-4, -2.0)]
    assert fired_at(lead, paper_gains(guard_lookahead=0.5)) == [1]
    bounced = [(1e-3, -2.0), (1e-4, -2.0), (3e-4, 2.0)]  # ahead: 0.8, -0.1, 0.5 mm
    assert fired_at(bounced, paper_gains(guard_lookahead=1.0)) == [1, 2]


def test_a_turn_inside_the_hysteresis_is_a_stand():
    gains = paper_gains(velocity_deadband=0.05, velocity_hysteresis=0.03)
    turned = answers([(0.1, 0.2), (0.1, -0.06), (0.1, -0.07), (0.1, -0.09)], gains)
    assert list(turned['guard'][1:3]) == [VELOCITY_ZERO, STICKING]
    assert list(answers([(0.1, 0.2), (0.1, 0.06)], gains)['guard']) == [0, 0]


def test_standing_counts_from_when_all_of_the_impulse_has_left():
    gains = paper_gains(effort_limit=20.0, stiction_wait_samples=3)
    told = answers([(0.05, 0.0)] * 100, gains)
    leaving = np.flatnonzero(told['effort'] != -K * 0.05)
    last = leaving[np.flatnonzero(np.diff(leaving) > 1)[0]]
    assert last > 10
    assert np.flatnonzero(told['guard'])[1] == last + 3


def test_with_lead_the_overshoot_behind_the_first_crossing_is_smaller():
    def overshoot(lead):
        return [
            -simulate(
                Plant(F_c=0.0, damping=Damping(value=value)),
                paper_gains(guard_lookahead=lead),
                0.2,
            ).position.min()
            for value in np.linspace(0.15, 0.5, 40).tolist()
        ]

    assert np.median(overshoot(0.5)) < 0.75 * np.median(overshoot(0.0))


def test_an_encoder_that_flickers_about_the_set_point_is_one_crossing():
    flicker = [(2 * Q, -1.0), *[(0.0, -1.0), (Q, 1.0)] * 20]
    assert np.count_nonzero(answers(flicker, WARY)['guard'] == POSITION_ZERO) == 20
    wary = replace(WARY, position_hysteresis=1.5 * Q)
    assert np.count_nonzero(answers(flicker, wary)['guard'] == POSITION_ZERO) == 1
    armed_again = [*flicker, (2 * Q, -1.0), (-Q, -1.0)]
    assert np.count_nonzero(answers(armed_again, wary)['guard'] == POSITION_ZERO) == 2


def test_noise_at_the_edge_of_the_dead_band_is_one_arrival_at_zero():
    noise = 5e-3 * np.random.default_rng(1).normal(size=500)
    creep = [(0.1, 0.2), *[(0.1, 0.05 + deviation) for deviation in noise]]

    def arrivals(hysteresis):
        gains = replace(WARY, velocity_hysteresis=hysteresis, stiction_wait_samples=1000)
        return np.count_nonzero(answers(creep, gains)['guard'] == VELOCITY_ZERO)

    assert arrivals(0.0) > 100
    assert arrivals(0.03) == 1


@pytest.mark.parametrize('pause', [1, 2, 25])
def test_a_standing_axis_has_one_impulse_in_so_many_samples(pause):
    fired = np.flatnonzero(
        answers([(0.05, 0.0)] * 200, paper_gains(stiction_wait_samples=pause))['guard']
    )
    assert fired[0] == 0  # the start is an arrival
    assert (np.diff(fired) == pause).all()
    assert len(fired) == -(-200 // pause)


def test_a_set_point_ramp_at_rest_has_one_impulse_in_so_many_samples():
    ramp = [(0.0, 0.0, 1e-4 * k) for k in range(400)]
    fired = np.flatnonzero(answers(ramp, paper_gains(stiction_wait_samples=50))['guard'])
    assert len(fired) > 5
    assert np.diff(fired).min() >= 50


def test_a_set_point_step_after_a_long_stand_acts_at_once():
    told = answers(
        [*[(0.0, 0.0, 0.0)] * 100, (0.0, 0.0, 0.3)], paper_gains(stiction_wait_samples=50)
    )
    assert list(np.flatnonzero(told['guard'])) == [100]
    assert told['guard'][100] == VELOCITY_ZERO


@pytest.mark.parametrize('lead', [0.0, 0.5])
@pytest.mark.parametrize('hysteresis', [0.0, 1.5 * Q])
def test_a_set_point_jump_in_motion_is_no_position_zero(lead, hysteresis):
    gains = replace(WARY, guard_lookahead=lead, position_hysteresis=hysteresis)
    for jump in np.linspace(-0.3, 0.3, 13).tolist():
        samples = [(0.25 - 4e-4 * k, -4.0, jump * (k >= 3)) for k in range(6)]
        told = answers(samples, gains)['guard']
        assert told[3] != POSITION_ZERO


def test_behind_a_delay_one_impulse_is_not_given_again_before_it_acts():
    axis = Plant(F_c=1.0, sensor=NOISY, actuator=Actuator(delay=10))
    hasty, patient = (
        simulate(axis, replace(WARY, stiction_wait_samples=pause), 4.0) for pause in (1, 12)
    )
    alone = simulate(Plant(F_c=1.0, sensor=NOISY), WARY, 4.0)
    assert np.abs(hasty.effort).max() > 5 * np.abs(alone.effort).max()
    assert np.abs(patient.effort).max() < 1.01 * np.abs(alone.effort).max()
    assert impulses_per_second(patient) == 0.0
    assert farthest(patient) < 2.0


# -- no velocity in the message ---------------------------------------------------------------


def test_the_estimate_follows_a_steady_velocity_and_comes_to_rest_exactly():
    ride = [(min(k, 500) * 1e-4 * 2.0, math.nan) for k in range(4000)]
    velocity = answers(ride, paper_gains(impulses=False))['velocity']
    assert velocity[0] == 0.0
    assert velocity[500] == pytest.approx(2.0, rel=1e-6)
    lag = 1.0 / (2 * math.pi * 50.0)
    assert velocity[500 + round(lag / STEP)] == pytest.approx(2.0 / math.e, rel=0.01)
    assert velocity[-1] == 0.0


def test_the_estimate_knows_of_the_impulse_that_the_filter_has_not_seen():
    run = simulate(Plant(F_c=0.0, sensor=Sensor(velocity='none')), paper_gains(), 0.1)
    assert run.events['area'][0] == pytest.approx(-0.375)
    assert run.velocity[1] == pytest.approx(-3.75, rel=2e-3)
    told = answers([(0.5, math.nan), (0.4998, math.nan)], paper_gains())
    assert told['velocity'][1] == pytest.approx(-3.75, rel=0.02)


def test_the_estimate_knows_what_has_left_of_an_impulse_and_no_more():
    told = answers([(0.5, math.nan)] * 2, paper_gains(effort_limit=20.0))
    pole = math.exp(-2 * math.pi * 50.0 * STEP)
    assert told['velocity'][1] == pytest.approx(pole * (-20.0 + K * 0.5) * STEP / M)


@pytest.mark.parametrize('F_c', [0.0, 0.05, 1.0])
@pytest.mark.parametrize('damping', [0.15, 1.0])
def test_from_positions_alone_the_axis_settles_within_two_steps_and_rests(F_c, damping):
    # 4 pi 50 Hz Q = 0.096 m/s: twice what one step of the encoder makes of the estimate
    gains = replace(WARY, velocity_deadband=0.12)
    for x_0 in np.linspace(0.05, 0.6, 12).tolist():
        run = simulate(
            Plant(
                F_c=F_c,
                x_0=x_0,
                damping=Damping(value=damping),
                sensor=Sensor(resolution=Q, velocity='none'),
            ),
            gains,
            4.0,
        )
        assert impulses_per_second(run) == 0.0
        assert farthest(run) < 2.0


@pytest.mark.parametrize('limit', [0.0, 50.0, 20.0, 5.0])
def test_a_bad_velocity_is_not_looked_at_where_the_law_is_told_to_estimate(limit):
    sensor = Sensor(resolution=Q, velocity='difference', velocity_noise=0.1)
    wary = replace(WARY, velocity_deadband=0.12, effort_limit=limit)
    assert impulses_per_second(simulate(Plant(F_c=0.0, sensor=sensor), wary, 4.0)) > 50.0
    for F_c in (0.0, 0.3, 1.0):
        run = simulate(
            Plant(F_c=F_c, sensor=sensor), replace(wary, velocity_source='estimated'), 4.0
        )
        without = simulate(Plant(F_c=F_c, sensor=replace(sensor, velocity='none')), wary, 4.0)
        assert np.array_equal(run.position, without.position)
        assert impulses_per_second(run) == 0.0
        assert farthest(run) < 2.0


def test_a_dead_band_below_one_step_of_the_estimate_storms():
    axis = Plant(F_c=0.0, sensor=Sensor(resolution=Q, velocity='none'))
    run = simulate(axis, replace(WARY, velocity_deadband=0.04), 4.0)
    assert impulses_per_second(run) > 100.0


# -- the integral -----------------------------------------------------------------------------


def test_with_an_integral_gain_the_law_is_a_pid():
    error, v, gain = 0.01, -0.3, 40.0
    told = answers([(error, v)] * 20, paper_gains(K_i=gain, impulses=False))['effort']
    integral = gain * STEP * error * np.arange(1, 21)
    assert told == pytest.approx(-K * error - 0.5 * v - integral, rel=1e-12)


def test_the_integral_carries_a_constant_force_that_pd_leaves_an_error_against():
    axis = Plant(F_c=0.0, disturbance=Disturbance(force=1.0))
    last = {
        gain: simulate(axis, paper_gains(K_i=gain, impulses=False), 10.0).position[-1]
        for gain in (0.0, 20.0)
    }
    assert last[0.0] == pytest.approx(1.0 / K, abs=1e-4)
    assert abs(last[20.0]) < 1e-4


def test_an_integral_rests_while_the_effort_is_clipped_and_goes_on_when_it_is_not():
    gains = paper_gains(K_i=1e3, effort_limit=1.0, impulses=False)
    told = answers([(0.2, 0.0)] * 5000 + [(-0.01, 0.0)], gains)['effort']
    assert (told[:-1] == -1.0).all()
    assert told[-1] == pytest.approx(0.1, abs=2e-3)  # nothing has wound up


def test_an_integral_goes_on_while_the_effort_is_clipped_the_other_way():
    gains = paper_gains(K_i=1e3, effort_limit=1.0, impulses=False)
    told = answers([(0.01, -100.0)] * 100 + [(0.01, 0.0)], gains)['effort']
    assert (told[:-1] == 1.0).all()
    assert told[-1] == pytest.approx(-0.1 - 101 * 1e3 * STEP * 0.01)


def test_an_integral_gain_taken_away_leaves_nothing():
    state, command = np.zeros(STATES), np.zeros(1, COMMAND)
    memory = np.zeros(1, SUPERVISION)
    for gain in (100.0, 0.0):
        law = paper_gains(K_i=gain, impulses=False).packed().view(float)
        for _ in range(100):
            control_in_place(state, memory, law, 0.02, 0.0, command)
    assert command['effort'][0] == -K * 0.02
