"""Sensor, actuator, payload, disturbance: each is what its name says, and nothing when off."""

from dataclasses import replace
from itertools import pairwise
import math
from statistics import NormalDist

import numpy as np
import pytest

from impulse_control_ros.core.batch import simulate_batch
from impulse_control_ros.core.closed_loop import ClosedLoop, empty_trace, Trace
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.hybrid import solve
from impulse_control_ros.core.metrics import figures
from impulse_control_ros.core.nonidealities import (
    Actuator,
    Disturbance,
    normal,
    OFF,
    Payload,
    POSITION_NOISE,
    Sensor,
    VELOCITY_NOISE,
)
from impulse_control_ros.core.parameter import build
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.plant_step import PlantState
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.simulated_plant import SimulatedPlant
from impulse_control_ros.core.stribeck import Stribeck
from impulse_control_ros.core.varied import row
from impulse_control_ros.errors import ParameterError

STEP, M, D = 1e-4, 0.1, 0.15
FREE = ControlGains(K=1e-300, D=0.0, impulses=False)  # no effort
EVERYTHING = Plant(
    F_c=0.3,
    damping=Damping(kind='noise'),
    stribeck=Stribeck(F_s=0.5, v_s=0.02),
    sensor=Sensor(resolution=1e-4, position_noise=1e-5, velocity_noise=1e-2),
    actuator=Actuator(limit=500.0, time_constant=3e-4, delay=3),
    payload=Payload(mass=0.02, time=0.1),
    disturbance=Disturbance(kind='noise', force=0.2),
)


@pytest.mark.parametrize(
    'axis',
    [
        Plant(F_c=0.0),
        Plant(F_c=1.0, x_0=0.15),
        Plant(F_c=0.3, damping=Damping(kind='noise')),
        Plant(x_0=0.0),
        Plant(damping=Damping(value=30.0)),
    ],
    ids=str,
)
@pytest.mark.parametrize(
    'controller',
    [
        ControlGains(),
        ControlGains(effort_limit=50.0),
        ControlGains(hold_off=5, c=1.0),
        ControlGains(impulses=False),
    ],
    ids=str,
)
def test_with_all_off_the_real_plant_makes_the_bits_of_the_ideal_one(axis, controller):
    traces = [empty_trace(3001, ideal) for ideal in (True, False)]
    for trace, ideal in zip(traces, (True, False), strict=True):
        ClosedLoop(axis, controller, ideal).fill(trace)
    for name, signal, too in zip(Trace._fields, *traces, strict=True):
        shifted = 1 if name == 'applied' else 0  # an ideal plant applies what is commanded
        assert signal[: 3001 - shifted].tobytes() == too[shifted:].tobytes(), name


def test_an_axis_is_ideal_until_one_of_its_parts_acts():
    assert Plant().is_ideal
    assert Plant(sensor=Sensor(seed=7), payload=Payload(time=1.0)).is_ideal
    acting = {'sensor.velocity': 'none', 'actuator.delay': 1, 'stribeck.F_s': 2.0}
    for name in OFF:
        assert not build(Plant, {name: acting.get(name, 0.5)}).is_ideal


def test_an_encoder_measures_the_nearest_of_its_steps():
    run = simulate(Plant(F_c=0.0, sensor=Sensor(resolution=1e-3)), ControlGains(), 0.3)
    steps = run.measured_position / 1e-3
    assert np.array_equal(steps, np.rint(steps))
    assert np.abs(run.measured_position - run.position).max() <= 0.5e-3 * (1 + 1e-9)
    assert len(np.unique(steps)) > 100


def test_a_velocity_by_difference_is_that_of_the_measured_positions():
    run = simulate(
        Plant(sensor=Sensor(resolution=1e-4, velocity='difference')), ControlGains(), 0.2
    )
    assert run.measured_velocity[0] == 0.0
    assert run.measured_velocity[1:] == pytest.approx(
        np.diff(run.measured_position) / STEP, abs=1e-9
    )


def test_a_position_sensor_measures_no_velocity():
    run = simulate(Plant(sensor=Sensor(velocity='none')), ControlGains(), 0.01)
    assert np.isnan(run.measured_velocity).all()
    assert np.isfinite(run.effort).all()


def test_noise_is_normal_and_no_two_streams_are_alike():
    draws = {
        (seed, start): np.array([normal(seed, start, k) for k in range(20_000)])
        for seed in (1, 2)
        for start in (POSITION_NOISE, VELOCITY_NOISE)
    }
    for values in draws.values():
        expected = np.array([NormalDist().cdf(value) for value in np.sort(values)])
        # Kolmogorov and Smirnov: 1.63 / sqrt(n) is exceeded once in a hundred seeds
        assert np.abs(expected - np.arange(20_000) / 20_000).max() < 1.63 / math.sqrt(20_000)
    assert np.abs(np.corrcoef(list(draws.values())) - np.eye(4)).max() < 0.03


def test_noise_has_the_standard_deviation_that_is_asked_for():
    sensor = Sensor(position_noise=2e-5, velocity_noise=3e-3)
    run = simulate(Plant(F_c=0.0, sensor=sensor), FREE, 2.0)
    assert np.std(run.measured_position - run.position) == pytest.approx(2e-5, rel=0.02)
    assert np.std(run.measured_velocity - run.velocity) == pytest.approx(3e-3, rel=0.02)


def test_one_seed_is_one_run_and_another_is_another():
    runs = [
        simulate(
            replace(EVERYTHING, sensor=replace(EVERYTHING.sensor, seed=seed)), ControlGains(), 0.3
        ).position.tobytes()
        for seed in (1, 1, 2)
    ]
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize('delay', [1, 7, 1000])
def test_a_delayed_command_acts_so_many_samples_later(delay):
    run = simulate(Plant(actuator=Actuator(delay=delay)), ControlGains(impulses=False), 0.2)
    assert not run.applied[:delay].any()
    assert np.array_equal(run.applied[delay:], run.effort[: -1 - delay])


def test_an_actuator_clips_what_is_above_its_limit():
    run = simulate(Plant(actuator=Actuator(limit=20.0)), ControlGains(), 0.3)
    assert np.abs(run.effort).max() > 1000.0
    assert np.array_equal(run.applied, np.clip(run.effort[:-1], -20.0, 20.0))


@pytest.mark.parametrize('time_constant', [1e-6, 1e-4, 3e-3])
def test_a_lag_keeps_the_area_of_every_command_and_delays_it_by_its_time_constant(time_constant):
    run = simulate(
        Plant(F_c=0.0, actuator=Actuator(time_constant=time_constant)),
        ControlGains(impulses=False),
        0.1,
    )
    left = run.effort[:-1] - run.applied
    # what went in and has not come out is T times what the output lacks
    output = 0.0
    for command in run.effort[:-1]:
        output = command + (output - command) * math.exp(-STEP / time_constant)
    assert left.sum() * STEP == pytest.approx(time_constant * output, rel=1e-9)


def coasted(velocity, force, mass, seconds):
    """Return where a mass comes from 0, and how fast, in ``seconds`` under damping D."""
    decay, final = math.exp(-D * seconds / mass), force / D
    return (
        final * seconds + (velocity - final) * mass / D * (1 - decay),
        final + (velocity - final) * decay,
    )


def test_a_constant_force_acts_from_its_start_to_its_end_on_the_mass_of_the_time():
    axis = Plant(
        F_c=0.0,
        x_0=0.0,
        payload=Payload(mass=0.3, time=0.2),
        disturbance=Disturbance(force=2.0, start=0.1, end=0.3),
    )
    run = simulate(axis, FREE, 0.4)
    x, v = 0.0, 0.0
    for (begin, end), force, mass in zip(
        pairwise([0.0, 0.1, 0.2, 0.3, 0.4]), [0.0, 2.0, 2.0, 0.0], [M, M, 0.4, 0.4], strict=True
    ):
        change, v = coasted(v, force, mass, end - begin)
        x += change
        at = round(end / STEP)
        assert (run.position[at], run.velocity[at]) == pytest.approx((x, v), rel=1e-9, abs=1e-15)


def test_a_sinusoidal_and_a_noisy_force_have_their_amplitude():
    heavy = {'m': 1e6, 'F_c': 0.0, 'v_0': 0.0, 'x_0': 0.0}
    wave = simulate(
        Plant(**heavy, disturbance=Disturbance(kind='sinusoidal', force=3.0, bandwidth=2.0)),
        FREE,
        1.0,
    )
    force = np.diff(wave.velocity) * 1e6 / STEP
    assert force == pytest.approx(3.0 * np.sin(4 * math.pi * wave.time[:-1]), abs=1e-2)
    noise = simulate(
        Plant(**heavy, disturbance=Disturbance(kind='noise', force=3.0, bandwidth=500.0)),
        FREE,
        2.0,
    )
    force = np.diff(noise.velocity) * 1e6 / STEP
    assert np.std(force) == pytest.approx(3.0, rel=0.05)


def noisy_force(axis, reset_at, samples=4000):
    """Return the force [N] on each sample of a heavy axis that is reset once."""
    plant, forces = SimulatedPlant(axis), []
    for k in range(samples):
        if k == reset_at:
            plant.reset()
        before = PlantState(*plant.state()).velocity
        plant.step(0.0)
        forces.append((PlantState(*plant.state()).velocity - before) * axis.m / STEP)
    return np.array(forces)


def test_noise_of_a_force_has_its_amplitude_from_the_first_sample_and_from_a_reset_on():
    wide = []
    for seed in range(200):
        axis = Plant(
            m=1e6,
            F_c=0.0,
            x_0=0.0,
            v_0=0.0,
            disturbance=Disturbance(kind='noise', force=3.0, bandwidth=5.0, seed=seed),
        )
        wide.append(noisy_force(axis, reset_at=5, samples=10)[[0, 4, 5, 9]])
    assert np.std(wide, axis=0) == pytest.approx(3.0, rel=0.15)


def test_a_force_that_is_noise_is_not_the_noise_of_the_damping():
    axis = Plant(
        m=1e6,
        F_c=0.0,
        x_0=0.0,
        v_0=0.0,
        damping=Damping(kind='noise', seed=1),
        disturbance=Disturbance(kind='noise', force=3.0, bandwidth=5.0, seed=1),
    )
    run = simulate(axis, FREE, 1.0)
    force = np.diff(run.velocity) * 1e6 / STEP
    assert abs(np.corrcoef(force[::100], run.damping[::100])[0, 1]) < 0.9


def test_a_sinusoidal_force_begins_with_zero_at_its_start():
    axis = Plant(
        m=1e6,
        F_c=0.0,
        x_0=0.0,
        v_0=0.0,
        disturbance=Disturbance(kind='sinusoidal', force=3.0, bandwidth=2.0, start=0.1),
    )
    force = np.diff(simulate(axis, FREE, 0.5).velocity) * 1e6 / STEP
    time = np.arange(len(force)) * STEP
    assert force == pytest.approx(
        np.where(time < 0.1, 0.0, 3.0 * np.sin(4 * math.pi * (time - 0.1))), abs=1e-2
    )


def test_payload_and_force_act_on_an_axis_with_stribeck_friction_too():
    plain = Plant(
        F_c=0.3,
        x_0=0.0,
        payload=Payload(mass=0.3, time=0.2),
        disturbance=Disturbance(force=2.0, start=0.1),
    )
    # a curve that is flat: the same friction, by the other kernel
    curved = replace(plain, stribeck=Stribeck(F_s=0.3 * (1 + 1e-9), v_s=1.0))
    expected, run = (simulate(axis, FREE, 0.4) for axis in (plain, curved))
    assert run.velocity == pytest.approx(expected.velocity, rel=1e-6, abs=1e-9)
    assert expected.velocity[-1] > 0.1


def test_a_velocity_by_difference_has_the_noise_of_the_velocity_too():
    sensor = Sensor(velocity='difference', velocity_noise=1e-2)
    run = simulate(Plant(F_c=0.0, sensor=sensor), FREE, 1.0)
    assert np.std(run.measured_velocity[1:] - np.diff(run.position) / STEP) == pytest.approx(
        1e-2, rel=0.05
    )


def test_a_reset_empties_the_actuator_of_what_is_on_its_way():
    axis = Plant(F_c=0.0, x_0=0.0, v_0=0.0, actuator=Actuator(delay=3, time_constant=1e-3))
    plant = SimulatedPlant(axis)
    for _ in range(20):
        plant.step(5.0)
    plant.reset()
    for _ in range(20):
        plant.step(0.0)
        state = PlantState(*plant.state())
        assert state.effort == state.position == 0.0


def test_a_batch_of_real_axes_is_their_simulation_to_the_last_bit():
    draw, runs = np.random.default_rng(1), 40
    varied = {
        'F_c': draw.choice([0.0, 0.3], runs),
        'x_0': draw.uniform(-0.5, 0.5, runs),
        'sensor.resolution': draw.choice([0.0, 1e-4, 1e-3], runs),
        'sensor.velocity': draw.choice(['ideal', 'difference', 'none'], runs),
        'sensor.velocity_noise': draw.choice([0.0, 1e-2], runs),
        'sensor.seed': np.arange(runs),
        'actuator.delay': draw.choice([0, 3, 20], runs),
        'actuator.limit': draw.choice([0.0, 100.0], runs),
        'actuator.time_constant': draw.choice([0.0, 1e-3], runs),
        'payload.mass': draw.choice([0.0, 0.05, -0.05], runs),
        'disturbance.kind': draw.choice(['constant', 'noise', 'sinusoidal'], runs),
        'disturbance.force': draw.choice([0.0, 0.5], runs),
        'stribeck.F_s': draw.choice([0.0, 0.6], runs),
        'guard_lookahead': draw.choice([0.0, 0.5], runs),
        'stiction_wait_samples': draw.choice([1, 30], runs),
    }
    batch = simulate_batch(Plant(), ControlGains(), 0.2, varied, (1e-2, 1e-3))
    for i in range(runs):
        axis, controller = row(Plant(), ControlGains(), varied, i)
        run = simulate(axis, controller, 0.2)
        alone = figures(
            run.time,
            run.position - controller.x_r,
            run.velocity,
            run.effort,
            run.events,
            (1e-2, 1e-3),
        )
        assert batch[i : i + 1].tobytes() == alone.tobytes(), (axis, controller)


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        ({'payload.mass': -0.1}, r'payload.mass = -0.1: must be > -m = -0.1 \[kg\]'),
        ({'F_c': 1.0, 'stribeck.F_s': 0.5}, r'F_s = 0.5: must be 0 or >= F_c = 1 \[N'),
        (
            {'disturbance.start': 1.0, 'disturbance.end': 0.5},
            r'disturbance.end = 0.5: must be 0 or > disturbance.start = 1 \[s\]',
        ),
        ({'sensor.resolution': 1e-320}, r'resolution = 1e-320: must be 0 or >= 1e-12'),
        ({'sensor.seed': 2**64}, r'seed = 18446744073709551616: must be in \[0, 9.22'),
        ({'actuator.delay': 1001}, r'delay = 1001: must be in \[0, 1000\]'),
        ({'sensor.velocity': 'noisy'}, "velocity = 'noisy': must be one of ideal, dif"),
    ],
)
def test_hardware_that_cannot_be_is_refused_alone_and_in_a_batch(values, said):
    with pytest.raises(ParameterError, match=said):
        build(Plant, values)
    with pytest.raises(ParameterError, match='invalid .*: must be'):
        simulate_batch(
            Plant(),
            ControlGains(),
            0.1,
            {name: np.array([Plant().flat()[name], value]) for name, value in values.items()},
        )


def test_the_exact_solution_is_that_of_an_ideal_axis_only():
    with pytest.raises(ParameterError, match='must be an ideal one'):
        solve(EVERYTHING, ControlGains(), 1.0)
