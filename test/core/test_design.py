"""Gains, predictions and findings, against closed forms, the exact solution and the loop."""

from dataclasses import replace
from functools import partial
import math
import re

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import (
    impulse_area,
    POSITION_ZERO,
    STICKING,
    VELOCITY_ZERO,
)
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.design import (
    alpha_bounds,
    beta,
    check_delay,
    check_gains,
    critical_damping,
    dead_zone,
    delay_margin,
    first_zero_time,
    least_stiffness,
    Level,
    peak_speed,
    quiet_error,
    sampled_floor,
)
from impulse_control_ros.core.hybrid import Reading, solve
from impulse_control_ros.core.nonidealities import Actuator, Payload, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.stribeck import Stribeck
from impulse_control_ros.files.parameter_file import load_experiment
from test.conftest import CONFIG

PD = ControlGains(impulses=False)
AXIS = Plant(x_0=0.5, F_c=0.0, damping=Damping(value=0.15))
paper_gains = partial(ControlGains, supervision=False)
ROUGH = Plant(x_0=0.15, F_c=1.0, damping=Damping(value=0.15))


def said(level, gains, axis=None):
    """Return the texts of the findings of one level."""
    return [finding.text for finding in check_gains(gains, axis) if finding.level is level]


# Gains.


@pytest.mark.parametrize(('m', 'K', 'd_bar'), [(0.2, 10.0, 1.5), (0.1, 40.0, 0.3)])
def test_the_recommended_damping_is_critical(m, K, d_bar):
    gains = ControlGains(m=m, K=K, d_bar=d_bar)
    right = critical_damping(gains)
    assert (d_bar + right) ** 2 == pytest.approx(4 * m * K)
    assert f'D = {right:g} N s/m is' in said(Level.WARNING, gains)[0]
    assert said(Level.WARNING, ControlGains(m=m, K=K, d_bar=d_bar, D=right)) == []


def test_where_the_damping_alone_is_too_much_a_stiffness_is_recommended():
    gains = ControlGains(d_bar=3.0)
    assert 'K = 22.5 N/m with D = 0 is' in said(Level.WARNING, gains)[0]
    assert critical_damping(ControlGains(d_bar=3.0, K=least_stiffness(gains))) == 0.0


def test_the_bounds_of_alpha_stop_and_reverse_the_axis():
    least, below = alpha_bounds(0.1, -3.5)
    assert -3.5 + 2 * least / 0.1 == 0.0
    assert -3.5 + 2 * below / 0.1 == 3.5
    gains = ControlGains(alpha_ratio=0.5).packed()[0]
    assert impulse_area(POSITION_ZERO, gains, 0.0, -3.5) == 2 * least


@pytest.mark.parametrize('c', [1.0, 2.0])
def test_beta_is_that_of_the_control_law(c):
    gains = ControlGains(c=c, x_r=0.1)
    assert impulse_area(STICKING, gains.packed()[0], 0.2, 0.0) == pytest.approx(-beta(gains, 0.2))
    assert impulse_area(VELOCITY_ZERO, gains.packed()[0], -0.2, 0.0) == (
        pytest.approx(2 * beta(gains, -0.2))
    )


def test_pd_alone_sticks_in_the_dead_zone_and_leaves_it_from_outside():
    zone = dead_zone(PD, ROUGH.F_c)
    assert zone == 0.1
    for factor, moves in ((1.0, False), (1.0 + 1e-9, True)):
        axis = Plant(x_0=factor * zone, F_c=1.0, damping=Damping(value=0.15))
        assert (solve(axis, PD, 1.0).end_time > 0.0) == moves


@pytest.mark.parametrize('c', [1.0, 2.0])
@pytest.mark.parametrize('step', [1e-3, 1e-4])
def test_the_sampled_loop_comes_to_rest_at_the_floor(step, c):
    gains = paper_gains(time_step=step, c=c)
    axis = Plant(x_0=0.02, F_c=1.0, time_step=step, damping=Damping(value=0.15))
    run = simulate(axis, gains, 6.0)
    floor = sampled_floor(gains, 1.0)
    assert floor == pytest.approx(c * step / 1.5)
    assert 0.5 * floor < run.position[-1] <= 1.001 * floor


# Predictions.


@pytest.mark.parametrize(
    ('d', 'time'),
    [(0.15, 0.12143680500356), (0.5, 0.149), (1.0, 0.238), (1.3, 0.436), (1.49, 2.76)],
)
def test_the_first_zero_is_predicted(d, time):
    assert first_zero_time(ControlGains(), d) == pytest.approx(time, rel=4e-3)


def test_impulses_reach_the_set_point_for_every_damping_below_its_bound_and_none_at_it():
    assert math.isfinite(first_zero_time(ControlGains(), 1.5 * (1 - 1e-12)))
    assert math.isinf(first_zero_time(ControlGains(), 1.5 * (1 + 1e-12)))
    assert math.isinf(first_zero_time(PD, 1.5))


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.02, 3.0),
    st.floats(-2.0, 2.0).filter(lambda x: abs(x) > 1e-3),
    st.floats(0.0, 2.0),
    st.booleans(),
    st.sampled_from([1.0, 2.0]),
)
def test_the_predictions_are_those_of_the_exact_solution(d, error, D, impulses, c):
    gains = ControlGains(D=D, impulses=impulses, c=c, x_r=0.25)
    zero = first_zero_time(gains, d)
    axis = Plant(x_0=error + 0.25, F_c=0.0, damping=Damping(value=d))
    solution = solve(axis, gains, min(zero, 5.0) * (1 + 1e-9), reading=Reading.ONE_JUMP)
    time = np.linspace(0.0, min(zero, 5.0) * (1 - 1e-9), 4001)
    x, v = solution.at(time)
    assert np.all((x - 0.25) * error > -1e-15)
    if zero < 5.0:
        assert solution.at(zero)[0] == pytest.approx(0.25, abs=1e-12)
    speed = peak_speed(gains, d, error)
    assert np.abs(v).max() <= speed * (1 + 1e-12)
    assert np.abs(v).max() == pytest.approx(speed, rel=2e-5)


def test_fig_2_has_its_peak_speeds():
    assert peak_speed(ControlGains(), 0.15, 0.5) == pytest.approx(4.386, abs=5e-4)
    assert peak_speed(PD, 0.15, -0.5) == pytest.approx(3.265, abs=5e-4)
    assert peak_speed(PD, 1.5, 0.5) == pytest.approx(5.0 / math.e)


# Findings.


def test_table_1_has_no_findings():
    assert check_gains(ControlGains()) == []
    assert check_gains(ControlGains(), AXIS) == []
    assert critical_damping(ControlGains()) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ('m', 'level'),
    [
        (0.05, Level.WARNING),
        (0.0833, Level.WARNING),
        (0.0834, Level.NOTE),
        (0.12, Level.NOTE),
        (0.1666, Level.NOTE),
        (0.1667, Level.ERROR),
        (1.0, Level.ERROR),
    ],
)
def test_a_wrong_mass_is_judged_by_the_bounds_of_alpha(m, level):
    texts = said(level, ControlGains(m=m), AXIS)
    assert f'm = {m:g} kg is not that of the axis, 0.1 kg' in texts[-1]
    assert 'from 0.0833333 to below 0.166667 kg' in texts[-1]
    assert not said(Level.ERROR, ControlGains(m=m, impulses=False), AXIS)


def test_the_mass_with_the_payload_is_judged_too():
    loaded = replace(AXIS, payload=Payload(mass=0.3))
    (text,) = said(Level.WARNING, ControlGains(), loaded)
    assert text.startswith('m = 0.1 kg is not that of the axis with its payload, 0.4 kg')
    relieved = replace(AXIS, m=0.2, payload=Payload(mass=-0.1))
    assert ['0.2 kg' in text for text in said(Level.WARNING, ControlGains(), relieved)] == [True]


def test_a_lag_raises_the_error_from_which_an_impulse_releases():
    patient = paper_gains(
        stiction_wait_samples=302, position_deadband=2e-3, velocity_deadband=0.05
    )
    axis = replace(ROUGH, F_c=0.3, actuator=Actuator(time_constant=1e-2))
    (text,) = said(Level.NOTE, patient, axis)
    assert 'a position_deadband above 0.00808033 m ends them' in text  # 2 c F_c T / d_bar and 1 %
    assert at_rest(axis, patient, 2.1e-3, 4e-3) == 24  # that is where even an arrival moves it
    # one that is short beside a sample changes nothing but what is not seen
    assert quiet_error(patient, 0.3, 0.1, 1e-9) == pytest.approx(
        quiet_error(patient, 0.3, 0.1), rel=2e-5
    )


@pytest.mark.parametrize(
    'damping',
    [Damping(value=1.6), Damping(kind='noise', upper=1.6), Damping(kind='sinusoidal', upper=1.6)],
    ids=lambda damping: damping.kind,
)
def test_a_damping_above_its_bound_is_a_warning(damping):
    texts = said(Level.WARNING, ControlGains(), Plant(F_c=0.0, damping=damping))
    assert len(texts) == 1
    assert 'd_bar = 1.5 N s/m is no bound' in texts[0]
    assert 'd_bar = 1.6 N s/m is' in texts[0]


def test_friction_without_impulses_is_a_note_on_the_dead_zone():
    assert ['F_c / K = 0.1 m' in text for text in said(Level.NOTE, PD, ROUGH)] == [True]


def test_a_dead_band_below_the_sampled_floor_is_a_note_with_the_one_that_ends_the_impulses():
    (text,) = said(Level.NOTE, paper_gains(), ROUGH)
    assert text.startswith('position_deadband = 1e-06 m is below 0.000133467 m, up to which')
    assert 'a position_deadband above 0.000133467 m ends them' in text
    assert said(Level.NOTE, ControlGains(), ROUGH) == []
    gains = paper_gains(position_deadband=1.34e-4)
    assert check_gains(gains, ROUGH) == []
    assert simulate(ROUGH, gains, 6.0).events['tick'][-1] < 5.0 / 1e-4


def at_rest(axis, gains, least=0.05, most=0.6):
    """Return from how many of 24 starts impulses go on after 2.8 s."""
    return sum(
        bool(np.sum(simulate(replace(axis, x_0=x_0), gains, 3.0).events['tick'] >= 28_000))
        for x_0 in np.linspace(least, most, 24).tolist()
    )


def test_what_a_velocity_dead_band_hides_of_a_release_raises_the_note_up_to_double():
    # seen above 0.5 mm/s: m 5e-4 is half of F_c dt
    hiding = paper_gains(velocity_deadband=5e-4, position_deadband=1.99e-4)
    (text,) = said(Level.NOTE, hiding, ROUGH)
    assert 'above 0.0002 m ends them' in text
    assert at_rest(ROUGH, hiding) > 0
    assert said(Level.NOTE, replace(hiding, position_deadband=2.01e-4), ROUGH) == []
    assert at_rest(ROUGH, replace(hiding, position_deadband=2.01e-4)) == 0
    loaded = replace(ROUGH, payload=Payload(mass=0.1))
    assert any(
        'above 0.000266667 m ends them' in text for text in said(Level.NOTE, hiding, loaded)
    )
    (text,) = said(Level.NOTE, replace(hiding, velocity_deadband=1.0), ROUGH)
    assert 'above 0.000266667 m ends them' in text


def test_supervision_ends_the_impulses_of_the_note_and_so_has_none():
    axis = replace(ROUGH, time_step=1e-3)
    late = {}
    for gains in (ControlGains(time_step=1e-3), paper_gains(time_step=1e-3)):
        events = simulate(axis, gains, 10.0).events
        late[gains.supervision] = np.count_nonzero(events['tick'] >= 5_000)
        assert (said(Level.NOTE, gains, axis) == []) == gains.supervision
    assert late[True] < 0.01 * late[False]


def test_an_encoder_shows_no_error_between_its_steps():
    q = 1e-4
    gains = paper_gains(velocity_deadband=1.0, position_deadband=1.5 * q)

    def noted(F_c, x_r=0.0):
        axis = replace(ROUGH, F_c=F_c, sensor=Sensor(resolution=q))
        return said(Level.NOTE, replace(gains, x_r=x_r), axis) != []

    # two steps are the first that are acted upon, and what an impulse has to release from
    assert (noted(0.74), noted(0.76)) == (False, True)
    # a set-point between two steps: 1.6 of them, on one side
    assert (noted(0.59, 0.4 * q), noted(0.61, 0.4 * q)) == (False, True)
    assert (noted(0.59, 7.6 * q), noted(0.61, 7.6 * q)) == (False, True)
    experiment = load_experiment(CONFIG / 'encoder.yaml')
    for F_c, storms in ((1.14, False), (1.16, True)):
        axis = replace(experiment.plant, F_c=F_c)
        gains = replace(experiment.gains, position_deadband=2.302e-4, supervision=False)
        assert (said(Level.NOTE, gains, axis) != []) == storms
        assert (at_rest(axis, gains) > 0) == storms


def test_an_effort_limit_within_the_friction_is_an_error():
    assert 'effort_limit = 1 N' in said(Level.ERROR, ControlGains(effort_limit=1.0), ROUGH)[0]
    assert said(Level.ERROR, ControlGains(effort_limit=1.1), ROUGH) == []
    sticky = replace(ROUGH, stribeck=Stribeck(F_s=1.5))
    assert (
        'does not exceed F_s = 1.5 N'
        in said(Level.ERROR, ControlGains(effort_limit=1.1), sticky)[0]
    )
    assert said(Level.ERROR, ControlGains(effort_limit=1.6), sticky) == []


def test_another_time_step_is_an_error():
    assert 'time_step = 0.001 s' in said(Level.ERROR, ControlGains(time_step=1e-3), AXIS)[0]


@pytest.mark.parametrize(
    ('change', 'text'), [({'c': 1.0}, 'c = 1 makes'), ({'hold_off': 8}, 'hold_off = 8 samples')]
)
def test_jumps_unlike_the_figures_are_notes_while_impulses_act(change, text):
    assert said(Level.NOTE, ControlGains(**change))[0].startswith(text)
    assert check_gains(ControlGains(impulses=False, **change)) == []


@pytest.mark.parametrize(
    ('axis', 'change', 'text'),
    [
        (
            Plant(sensor=Sensor(resolution=1e-3)),
            {'position_deadband': 1.5e-3},
            'position_deadband = 1e-06 m lets an axis at rest have impulse after impulse: '
            '0.0015 m, '
            '1.5 steps of the encoder of 0.001 m',
        ),
        (
            Plant(sensor=Sensor(position_noise=1e-3)),
            {'position_deadband': 4e-3},
            'position_deadband = 1e-06 m lets an axis at rest have impulse after impulse: 0.004 m',
        ),
        (
            Plant(sensor=Sensor(resolution=1e-9, position_noise=1e-9, velocity='none')),
            {'velocity_deadband': 1.9e-6},
            'velocity_deadband = 0 m/s lets an axis at rest have impulse '
            'after impulse: 1.88496e-06 m/s',
        ),
        (
            Plant(actuator=Actuator(delay=2, time_constant=1e-3)),
            {'stiction_wait_samples': 33},
            'stiction_wait_samples = 1 samples lets an axis at rest have impulse after '
            'impulse: 33 '
            'samples',
        ),
        (
            Plant(sensor=Sensor(velocity_noise=1e-2)),
            {'velocity_deadband': 0.04},
            'velocity_deadband = 1e-06 m/s lets an axis at rest have impulse after impulse: '
            '0.04 m/s, '
            'four times the velocity_noise of 0.01 m/s, ends them',
        ),
        (
            Plant(sensor=Sensor(resolution=1e-9, velocity='none')),
            {'velocity_deadband': 6.3e-7, 'velocity_bandwidth': 50.0},
            'velocity_deadband = 0 m/s lets an axis at rest have impulse after impulse: '
            '6.28319e-07 m/s',
        ),
        (
            Plant(actuator=Actuator(delay=7)),
            {'stiction_wait_samples': 8},
            'stiction_wait_samples = 1 samples lets an axis at rest have impulse after impulse: 8 '
            'samples, '
            'more than the actuator takes to act, its delay of 7 samples',
        ),
    ],
)
def test_a_dead_band_below_what_the_sensor_shows_at_rest_is_a_warning(axis, change, text):
    gains = ControlGains(velocity_deadband=0.0) if '0 m/s lets' in text else ControlGains()
    assert any(warning.startswith(text) for warning in said(Level.WARNING, gains, axis))
    assert said(Level.WARNING, replace(gains, **change), axis) == []
    assert said(Level.WARNING, replace(gains, impulses=False), axis) == []


def test_an_actuator_that_cuts_impulses_off_is_a_warning():
    axis = replace(AXIS, actuator=Actuator(limit=20.0))
    for limit in (0.0, 20.1):
        (text,) = said(Level.WARNING, ControlGains(effort_limit=limit), axis)
        assert text.startswith(f'effort_limit = {limit:g} N is above the 20 N of the actuator')
    assert said(Level.WARNING, ControlGains(effort_limit=20.0), axis) == []


def test_a_velocity_by_difference_of_encoder_steps_is_a_warning():
    sensor = Sensor(resolution=1e-4, velocity='difference')
    gains = ControlGains(position_deadband=1.5e-4)
    (text,) = said(Level.WARNING, gains, replace(AXIS, sensor=sensor))
    assert 'm as 1 m/s' in text
    assert text.endswith(
        'velocity_source = estimated, with velocity_deadband above 0.0628319 m/s, ends them'
    )
    assert said(Level.WARNING, gains, replace(AXIS, sensor=replace(sensor, resolution=0.0))) == []
    estimating = replace(gains, velocity_source='estimated', velocity_deadband=0.063)
    assert said(Level.WARNING, estimating, replace(AXIS, sensor=sensor)) == []
    assert (
        said(
            Level.WARNING,
            replace(estimating, velocity_deadband=0.06),
            replace(AXIS, sensor=sensor),
        )
        != []
    )


def test_the_encoder_experiment_has_no_findings():
    experiment = load_experiment(CONFIG / 'encoder.yaml')
    assert check_gains(experiment.gains, experiment.plant) == []


def test_an_integral_gain_that_is_unstable_without_damping_is_a_warning():
    limit = 0.5 * 10.0 / 0.1
    (text,) = said(Level.WARNING, ControlGains(K_i=limit))
    assert f'K_i = {limit:g} N/(m s) is unstable' in text
    assert said(Level.WARNING, ControlGains(K_i=0.99 * limit)) == []
    # and so it is: it grows above the bound and decays below it
    axis = Plant(F_c=0.0, damping=Damping(value=1e-6))
    ends = {
        factor: np.abs(
            simulate(axis, ControlGains(K_i=factor * limit, impulses=False), 20.0).position[-5000:]
        ).max()
        for factor in (0.9, 1.1)
    }
    assert ends[0.9] < axis.x_0 < ends[1.1]


def test_with_an_integral_no_dead_zone_is_claimed():
    assert said(Level.NOTE, replace(PD, K_i=12.0), ROUGH) == []


@pytest.mark.parametrize(
    'gains',
    [PD, replace(PD, K=40.0, D=2.0), replace(PD, m=0.05), replace(PD, D=2.0, K_i=30.0)],
)
def test_the_feedback_is_stable_up_to_the_delay_margin(gains):
    def grows(delay):
        samples = round(delay * delay_margin(gains) / gains.time_step)
        axis = Plant(x_0=0.1, damping=Damping(value=1e-9), actuator=Actuator(delay=samples))
        run = simulate(replace(axis, m=gains.m, F_c=0.0), gains, duration=8.0)
        halves = np.split(np.abs(run.position), [len(run.position) // 2])
        return halves[1].max() > halves[0].max()

    assert [grows(0.95), grows(1.05)] == [False, True]


def test_an_integral_that_is_unstable_has_no_delay_margin():
    assert delay_margin(replace(PD, K_i=49.0)) > 0.0
    assert delay_margin(replace(PD, K_i=51.0)) == 0.0
    assert delay_margin(replace(PD, D=0.0)) == 0.0


@pytest.mark.parametrize(
    ('gains', 'delay', 'text'),
    [
        ({'effort_limit': 50.0}, 3, 'the loop delays impulses by 3 samples, 0.0003 s'),
        ({'effort_limit': 50.0}, 500, 'response_timeout = 1000 samples .* above 1000'),
        ({}, 459, 'unstable from a delay of 0.0459 s; lower K and D'),
        ({'D': 0.05}, 60, 'unstable from a delay of 0.00495 s; lower K or raise D'),
        ({'D': 0.0}, 1, 'unstable from a delay of 0 s; lower K or raise D'),
        ({'K_i': 51.0}, 5, 'K_i = 51 .* unstable from a delay of 0 s; lower K_i'),
        ({'effort_limit': 50.0}, 1400, 'across the set-point in this time; .* = 1.05 must'),
        ({'effort_limit': 50.0, 'velocity_deadband': 0.1}, 10, 'is below 0.0001 m'),
        ({}, 1, 'effort_limit = 0 lets a wrong impulse act in full'),
    ],
)
def test_a_learnt_delay_is_told_with_what_it_asks_of_the_gains(gains, delay, text):
    found = [finding.text for finding in check_delay(ControlGains(**gains), delay)]
    assert any(re.search(text, one) for one in found)
    assert not any('unstable' in one.text for one in check_delay(ControlGains(), 458))
    assert check_delay(ControlGains(**gains), 0) == []
    assert check_delay(ControlGains(impulses=False), delay) == []
