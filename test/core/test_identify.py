"""Identification: simulated records with known truth, the errors that it states, its refusals."""

from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np
import pytest

import impulse_control_ros as ic
from impulse_control_ros.core.axis_motion import motion_of
from impulse_control_ros.core.axis_record import encoder_step, record_of, samples_of
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.identification import IDENTIFIED, Record
from impulse_control_ros.core.identify import identify
from impulse_control_ros.core.nonidealities import Actuator, Disturbance, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.regression import fit, student
from impulse_control_ros.core.weak_form import windows_of
from impulse_control_ros.errors import ParameterError
from scripts.identification import bound_ratios, interval_hits, moves, random_axis, TARGETS
from test.conftest import CONFIG

PD = ControlGains(impulses=False, time_step=1e-3)
AXIS = Plant(x_0=0.0, F_c=1.0, time_step=1e-3, damping=Damping(value=0.5))
TRUTH = {'m': 0.1, 'd': 0.5, 'F_c': 1.0, 'offset': 0.0}


def simulated(name, duration=2.0, **gains):
    experiment = ic.load_experiment(CONFIG / f'{name}.yaml')
    made = replace(experiment.gains, supervision=False, **gains)
    return ic.simulate(experiment.plant, made, duration)


def errors(found, truth):
    """Return the relative errors of what is not 0, in per cent."""
    return {
        name: 100.0 * (found.parameters[name].value / value - 1.0)
        for name, value in truth.items()
        if value
    }


def shaken(**sensor):
    """Return a record that excites everything, whose axis has an offset of 0.2 N."""
    plant = replace(AXIS, sensor=Sensor(**sensor), disturbance=Disturbance(force=-0.2))
    return moves(plant, PD, TARGETS, 1.0).record


# Values.


@pytest.mark.parametrize(('name', 'F_c'), [('underdamped', 0.0), ('coulomb', 1.0)])
def test_a_run_with_impulses_identifies_the_ideal_axis(name, F_c):
    found = identify(simulated(name), has_offset=False)
    for key, value in {'m': 0.1, 'd': 0.15, 'F_c': F_c}.items():
        assert found.parameters[key].value == pytest.approx(value, rel=5e-5, abs=1e-6)
        assert found.parameters[key].verdict == IDENTIFIED


def test_one_stroke_with_an_encoder_gives_the_axis_though_no_errors():
    run = simulated('encoder', position_deadband=2.302e-4)
    pieces = samples_of(record_of(run), 0, 1.0)
    windows = windows_of([motion_of(piece, 0.03) for piece in pieces], 0.03)
    m, d, F_c = fit(windows.symmetric[:, :3], windows.effort('after'), windows.clusters).values
    assert m == pytest.approx(0.1, rel=1e-3)
    assert d == pytest.approx(0.15, rel=2.7e-2)
    assert F_c == pytest.approx(1.0, rel=1.6e-2)
    assert not identify(run).is_identified


@pytest.mark.parametrize(
    ('time_step', 'resolution', 'window', 'bounds'),
    [
        (1e-4, 1.534e-4, 0.05, {'m': 0.015, 'd': 0.015, 'F_c': 0.015}),
        (1e-3, 6.1e-3, None, {'m': 0.3, 'd': 0.6, 'F_c': 1.9}),
    ],
)
def test_moves_with_an_encoder_identify_the_axis(time_step, resolution, window, bounds):
    sensor = Sensor(resolution=resolution, velocity_noise=1e-2)
    plant = replace(AXIS, time_step=time_step, sensor=sensor)
    record = moves(plant, replace(PD, time_step=time_step), TARGETS, 1.0).record
    found = identify(record, window=window)
    for name, error in errors(found, TRUTH).items():
        assert abs(error) < bounds[name]
    assert found.encoder_step == pytest.approx(resolution, rel=1e-6)
    assert found.velocity_noise == pytest.approx(1e-2, rel=0.1)
    assert all(one.is_identified for one in found.parameters.values())
    assert found.parameters['offset'].interval[1] > 0.0 > found.parameters['offset'].interval[0]


@pytest.mark.parametrize(
    ('force', 'length', 'sign'), [(35.0, 1.0, 1.0), (1.0, 3.0, -1.0), (0.01, 1000.0, 1.0)]
)
def test_units_scale_the_estimates(force, length, sign):
    record = replace(shaken(resolution=1e-5), velocity=None)
    plain = identify(record)
    other = identify(
        replace(record, position=length * sign * record.position, effort=sign * record.effort),
        effort_scale=force,
    )
    scales = {'m': force / length, 'd': force / length, 'F_c': force, 'offset': sign * force}
    for name, scale in scales.items():
        assert other.parameters[name].value == pytest.approx(
            scale * plain.parameters[name].value, rel=1e-6
        )
    assert other.d_bar == pytest.approx(force / length * plain.d_bar, rel=1e-6)


def test_several_records_are_one_fit():
    record = shaken(resolution=1e-4)
    parts = [
        Record(time=record.time[part], position=record.position[part], effort=record.effort[part])
        for part in (slice(0, 2500), slice(2500, 5000))
    ]
    whole, both = identify(replace(record, velocity=None)), identify(parts)
    for name, value in (TRUTH | {'offset': 0.2}).items():
        assert both.parameters[name].value == pytest.approx(value, rel=0.01)
        assert both.parameters[name].value == pytest.approx(whole.parameters[name].value, rel=0.01)
    assert set(both.d_blocks.record.tolist()) == {0, 1}


def test_the_damping_of_each_direction_is_told_apart():
    record = shaken(resolution=1e-5)
    assert abs(identify(record).asymmetry_z) < 4.0
    # twice the damping in one direction: the effort that it takes is added
    extra = 0.5 * np.maximum(np.gradient(record.position, 1e-3), 0.0)
    found = identify(replace(record, effort=record.effort + extra, velocity=None))
    assert found.asymmetry_z > 10.0
    assert found.asymmetric['d_plus'].value == pytest.approx(1.0, rel=0.02)
    assert found.asymmetric['d_minus'].value == pytest.approx(0.5, rel=0.02)
    assert any('depends on the direction' in text for text in found.warnings)


# Times and efforts.


@pytest.mark.parametrize('held', ['after', 'before'])
def test_an_effort_is_taken_to_act_as_it_is_said_to(held):
    record = shaken()
    effort = record.effort if held == 'after' else np.roll(record.effort, 1)
    found = identify(replace(record, effort=effort), effort_held=held)
    for name, error in errors(found, TRUTH | {'offset': 0.2}).items():
        assert abs(error) < 0.2, name


def driven(delay=0, seed=1):
    """Return the record of an axis that is driven by effort steps and not by feedback."""
    dt, count, rng = 1e-3, 8000, np.random.default_rng(seed)
    effort = np.repeat(rng.normal(0.0, 3.0, count // 40), 40)
    position, velocity = np.zeros(count), 0.0
    late = np.concatenate([np.zeros(delay), effort])
    for k in range(count - 1):
        force = late[k] - 2.0 * velocity - 20.0 * position[k]  # a known spring
        velocity += dt * force / 0.5
        position[k + 1] = position[k] + dt * velocity
    shown = effort - 20.0 * np.concatenate([position[delay:], np.zeros(delay)])
    return Record(time=np.arange(count) * dt, position=position, effort=shown)


@pytest.mark.parametrize('delay', [0, 4])
def test_a_delay_of_the_effort_is_seen_where_the_effort_has_steps(delay):
    found = identify(driven(delay), effort_held='after')
    assert found.effort_delay == pytest.approx(delay * 1e-3, abs=1e-3)
    assert any('later than its times' in text for text in found.warnings) == (delay > 0)


def test_a_delay_is_not_claimed_in_a_pure_pd_loop():
    plant = replace(AXIS, actuator=Actuator(delay=5))
    found = identify(moves(plant, PD, TARGETS, 1.0).record)
    assert math.isnan(found.effort_delay)
    assert any('does not show whether the effort acts late' in text for text in found.warnings)


def test_jittered_times_are_resampled_and_gaps_divide_a_record():
    record = shaken(resolution=1e-5)
    rng = np.random.default_rng(1)
    time = record.time + 2e-4 * rng.uniform(-1.0, 1.0, len(record.time))
    kept = np.ones(len(time), bool)
    kept[2400:2450] = False
    # what a logger that jitters would have seen
    position = np.interp(time, record.time, record.position)
    found = identify(
        Record(time=time[kept], position=position[kept], effort=record.effort[kept], name='bag')
    )
    assert any(text.startswith('bag: its times are up to') for text in found.warnings)
    assert any('divide it into 2 pieces' in text for text in found.warnings)
    for name, error in errors(found, TRUTH).items():
        assert abs(error) < 5.0, name


@pytest.mark.parametrize('step', [0.0, 5e-8, 1.7e-4])
@pytest.mark.parametrize('speed', [1e-3, 1.0])
def test_the_step_of_the_encoder_is_found(step, speed):
    position = speed * np.sin(np.arange(5000) * 2e-3)
    position = step * np.round(position / step) if step else position
    assert encoder_step(position) == pytest.approx(step, rel=1e-6)


def test_noise_is_that_of_the_position_beside_its_steps():
    noise = np.random.default_rng(1).normal(0.0, 2e-5, 5000)
    position = 0.1 * np.sin(np.arange(5000) * 2e-3) + noise
    (samples,) = samples_of(
        record_of({'time': np.arange(5000) * 1e-3, 'position': position, 'effort': noise}), 0, 1.0
    )
    assert samples.position_noise == pytest.approx(2e-5, rel=0.1)


def wandering(resolution=0.0, **gains):
    """Return the record of a hundred moves that turn in all ways, d = 0.5 N s/m."""
    sensor = Sensor(resolution=resolution, velocity='none')
    axis = replace(AXIS, F_c=0.3, sensor=sensor)
    targets = np.random.default_rng(1).uniform(-0.3, 0.3, 100).tolist()
    return moves(axis, replace(PD, **gains), targets, 0.5).record


@pytest.mark.parametrize('resolution', [0.0, 2e-5, 1.5e-4])
def test_turns_and_creeping_do_not_raise_the_bound_of_a_constant_damping(resolution):
    found = identify(replace(wandering(resolution), effort_held='after'))
    assert 0.5 <= found.d_bar < 1.5


def test_a_timing_that_no_hold_explains_is_not_taken_for_one():
    found = identify(wandering(2e-5, D=1.0))
    assert found.effort_held == 'after'
    assert found.parameters['d'].value == pytest.approx(0.5, rel=1e-3)


def test_commands_are_held_after_their_time_whatever_the_timing_shows():
    record = driven()
    assert identify(record).effort_held == 'sampled'
    commands = SimpleNamespace(time=record.time, position=record.position, effort=record.effort)
    assert identify(commands).effort_held == 'after'


# Refusals.


def test_a_negative_damping_is_refused():
    record = shaken()
    pushed = record.effort - 2.0 * np.gradient(record.position, 1e-3)
    found = identify(replace(record, effort=pushed, velocity=None))
    assert 'its value is negative, -1.5' in found.parameters['d'].verdict
    assert math.isnan(found.parameters['d'].value)


def test_one_direction_identifies_the_mass_alone():
    record = moves(AXIS, PD, (0.2, 0.5, 1.0, 1.6, 1.8), 0.35).record
    found = identify(record)
    assert found.parameters['m'].value == pytest.approx(0.1, rel=0.01)
    for name in ('d', 'F_c', 'offset'):
        assert 'one direction of motion only' in found.parameters[name].verdict
        assert math.isnan(found.parameters[name].value)
    assert 'one direction' in found.d_bar_verdict
    assert math.isnan(found.d_bar)
    assert not found.is_identified
    assert 'move in both directions' in found.advice


def test_constant_speed_does_not_identify_the_mass():
    time = np.arange(6000) * 1e-3
    rng = np.random.default_rng(1)
    speed = np.where(time % 2.0 < 1.0, 0.2, -0.2)
    force = 0.5 * speed + np.sign(speed) + 0.05 * np.sin(40.0 * time) * (1 + rng.normal(size=6000))
    still = np.minimum(time % 1.0, 1.0 - time % 1.0) > 0.15  # away from reversals
    ends = np.flatnonzero(np.diff(np.concatenate([[0], still, [0]])))
    position = np.concatenate([[0.0], np.cumsum(speed[:-1] * 1e-3)])
    parts = [
        Record(time=time[a:b], position=position[a:b], effort=force[a:b])
        for a, b in zip(ends[::2], ends[1::2], strict=True)
    ]
    found = identify(parts)
    assert not found.parameters['m'].is_identified
    assert found.d_bar_verdict == 'not excited: m is not identified'
    assert any('accelerate' in text for text in found.advice)


def test_an_axis_that_stands_is_refused():
    noise = np.random.default_rng(1).normal(0.0, 1e-6, 3000)
    time = np.arange(3000) * 1e-3
    for position in (np.zeros(3000), noise):
        found = identify({'time': time, 'position': position, 'effort': np.ones(3000)})
        assert not any(one.is_identified for one in found.parameters.values())
        assert not found.is_identified
        assert found.advice


def test_a_model_without_what_the_axis_has_drifts_with_the_window():
    record = driven()
    assert not any('the model is not the axis' in text for text in identify(record).warnings)
    # the actuator lags this effort by 10 ms
    lagged = record.effort + 10.0 * np.diff(record.effort, prepend=record.effort[0])
    found = identify(replace(record, effort=lagged), effort_held='after')
    assert found.sweep.drift['m'] > 5.0
    assert any('the model is not the axis' in text for text in found.warnings)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'time': np.zeros(100)}, r'record 1: time\[1\] = 0.0: must be later'),
        ({'effort': np.full(100, math.nan)}, r'record 1: effort\[0\] = nan: must be finite'),
        ({'effort': np.zeros(99)}, 'record 1: shape of effort'),
        ({'position': None}, 'record 1: position = None: must be a column'),
    ],
)
def test_a_record_that_cannot_be_used_is_refused_by_name(change, message):
    record = {'time': np.arange(100) * 1e-3, 'position': np.zeros(100), 'effort': np.zeros(100)}
    with pytest.raises(ParameterError, match=message):
        identify(record | change)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ({'effort_held': 'during'}, "effort_held = 'during': must be one of after, sampled"),
        ({'effort_scale': 0.0}, 'effort_scale = 0.0: must be finite and not 0'),
        ({'window': -1.0}, 'window = -1.0: must be > 0'),
    ],
)
def test_an_argument_that_cannot_be_used_is_refused_by_name(arguments, message):
    with pytest.raises(ParameterError, match=message):
        identify(shaken(), **arguments)


def test_a_short_record_is_refused():
    record = {name: np.arange(49.0) for name in ('time', 'position', 'effort')}
    with pytest.raises(ParameterError, match='number of samples = 49: must be >= 50'):
        identify(record)


# Sources.


def test_a_run_a_frame_and_a_record_give_the_same():
    run = simulated('encoder')
    record = Record(
        time=run.time,
        position=run.measured_position,
        velocity=run.measured_velocity,
        effort=run.effort,
    )
    frame = run.to_pandas()
    frame['position'], frame['velocity'] = run.measured_position, run.measured_velocity
    of_run, of_record, of_frame = (identify(one) for one in (run, record, frame))
    for name, one in of_run.parameters.items():
        assert of_record.parameters[name] == one or math.isnan(one.value)
        assert of_frame.parameters[name].standard_error == pytest.approx(
            one.standard_error, nan_ok=True
        )


def test_states_that_no_command_answers_are_left_out():
    record = replace(shaken(resolution=1e-5), velocity=None)
    effort = record.effort.copy()
    effort[[0, 2000, -1]] = math.nan
    recording = SimpleNamespace(time=record.time, position=record.position, effort=effort)
    found = identify(recording)
    for name, error in errors(found, TRUTH).items():
        assert abs(error) < 1.0, name


# Errors and bounds.


def test_intervals_cover_and_d_bar_bounds_a_few_axes():
    assert np.nanmean(interval_hits(range(1000, 1010))) >= 0.85
    ratios = bound_ratios(range(1000, 1005), 'noise')
    assert np.nanmin(ratios) > 0.95
    assert np.nanmedian(ratios) < 1.6


def test_the_mass_does_not_suffer_from_a_position_in_coarse_steps():
    moved, truth = random_axis(3)
    found = identify(moved.record)
    assert found.attenuation < 1e-3
    assert found.parameters['m'].value == pytest.approx(truth['m'], rel=0.01)


@pytest.mark.parametrize(
    ('freedom', 'value'), [(5, 2.571), (10, 2.228), (24, 2.064), (200, 1.972)]
)
def test_the_quantile_is_students(freedom, value):
    assert student(0.975, freedom) == pytest.approx(value, rel=2e-3)


@pytest.mark.soak
def test_intervals_of_95_percent_cover_in_90_to_99_percent_of_200_records():
    hits = interval_hits(range(200))
    assert 0.90 <= np.nanmean(hits) <= 0.99
    assert np.all(np.nanmean(hits, axis=0) >= 0.90)


@pytest.mark.soak
@pytest.mark.parametrize('kind', ['noise', 'sinusoidal'])
def test_d_bar_covers_the_true_maximum_in_95_percent_of_60_records(kind):
    ratios = bound_ratios(range(60), kind)
    known = ratios[np.isfinite(ratios)]
    assert np.mean(known >= 1.0) >= 0.95
    assert np.median(known) < 1.5
