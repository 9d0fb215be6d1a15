"""Supervised impulses: what they learn of an axis, and when they are suspended."""

from collections import deque
from dataclasses import replace
import math

import numpy as np
import pytest

from impulse_control_ros.core.batch import simulate_batch
from impulse_control_ros.core.closed_loop import ClosedLoop, empty_trace
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import NO_IMPULSE
from impulse_control_ros.core.damping import Damping, KINDS
from impulse_control_ros.core.impulse_verdicts import CONFIRMED, NO_VERDICT
from impulse_control_ros.core.nonidealities import Actuator, Payload, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.replay import learnt_at, Piece, run_again
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.simulated_plant import SimulatedPlant
from impulse_control_ros.errors import DivergedError
from impulse_control_ros.files.parameter_file import load_experiment
from test.conftest import CONFIG

STEP, SECOND = 1e-4, 10_000
GAINS = ControlGains()
WARY = ControlGains(velocity_deadband=1e-2, position_deadband=2e-3)
PD = ControlGains(impulses=False)
FLOOR = 1.48e-4  # m, where friction and sampling end the approach of Fig. 5


def learnt_of(axis, gains, run, samples):
    """Return what the law has learnt after each of ``samples``."""
    pieces = [Piece(0, axis, gains, True, axis)]
    return learnt_at(samples, run.measured_position, run.measured_velocity, pieces)


def mass_from_five(axis, gains):
    """Return the mass [kg] after five verdicts, or all if there are fewer."""
    run = simulate(axis, gains, 2.0)
    judged = run.verdicts['tick'][:5]
    return learnt_of(axis, gains, run, [int(judged[-1])])[0].mass


# -- what is learnt ---------------------------------------------------------------------------


@pytest.mark.parametrize('mass', [0.05, 0.3])
@pytest.mark.parametrize(('F_c', 'within'), [(0.0, 0.02), (1.0, 0.05)])
def test_five_impulses_give_the_mass(mass, F_c, within):
    assert mass_from_five(Plant(m=mass, F_c=F_c), GAINS) == pytest.approx(mass, rel=within)


# Later impulses at rest may spoil it: for 0.05 kg and F_c, 0.040 to 0.049 kg after 2 s.
@pytest.mark.parametrize('mass', [0.05, 0.3])
@pytest.mark.parametrize('F_c', [0.0, 1.0])
@pytest.mark.parametrize('seed', [1, 2, 5])
def test_five_impulses_give_the_mass_behind_an_encoder_and_noise(mass, F_c, seed):
    made = load_experiment(CONFIG / 'encoder.yaml')
    sensor = replace(made.plant.sensor, seed=seed)
    axis = replace(made.plant, m=mass, F_c=F_c, sensor=sensor)
    assert mass_from_five(axis, made.gains) == pytest.approx(mass, rel=0.1)


# 0.3 kg is not learnt so well here: 0.25 kg without friction, 0.14 kg with F_c = 1 N.
@pytest.mark.parametrize('mass', [0.05, 0.1])
@pytest.mark.parametrize('F_c', [0.0, 1.0])
def test_the_mass_is_learnt_from_the_positions_of_an_encoder(mass, F_c):
    axis = Plant(m=mass, F_c=F_c, sensor=Sensor(resolution=1.534e-4, velocity='none'))
    gains = ControlGains(
        velocity_source='estimated', position_deadband=2.302e-4, velocity_deadband=0.12
    )
    run = simulate(axis, gains, 3.0)
    learnt = learnt_of(axis, gains, run, [3 * SECOND])[0]
    assert learnt.mass == pytest.approx(mass, rel=0.15)


# Later ones at the friction floor, a few 0.1 mm, may give another: after 3 s 1 for 100 and 300.
@pytest.mark.parametrize('delay', [0, 5, 20, 100, 300])
@pytest.mark.parametrize('F_c', [0.0, 1.0])
@pytest.mark.parametrize('mass', [0.05, 0.1, 0.3])
def test_the_first_jumps_give_the_delay_within_a_sample(delay, F_c, mass):
    axis = Plant(m=mass, F_c=F_c, actuator=Actuator(delay=delay))
    run = simulate(axis, GAINS, 1.0)
    learnt = learnt_of(axis, GAINS, run, run.verdicts['tick'][:3].tolist())
    assert learnt
    for one in learnt:
        assert one.delay / STEP == pytest.approx(delay, abs=1.0)


@pytest.mark.parametrize('F_c', [0.0, 1.0])
def test_a_payload_of_three_times_the_mass_is_learnt_within_two_responses(F_c):
    axis = Plant(F_c=F_c, payload=Payload(mass=0.3, time=1.05))
    length = 4000
    pieces = [Piece(0, axis, GAINS, True, axis)]
    for i in range(1, 6):
        gains = replace(GAINS, x_r=0.2 * (-1) ** i)
        pieces.append(Piece(i * length, axis, gains, False, None))
    states, _ = run_again(6 * length, pieces)
    ends = [(i + 1) * length - 1 for i in range(6)]
    before, *after = learnt_at(
        [ends[1], ends[4], ends[5]], states['position'], states['velocity'], pieces
    )
    assert before.used_mass == 0.1
    for one in after:
        assert one.used_mass == pytest.approx(0.4, rel=0.02)


# After 2 s; after 0.5 s up to 60 % of the noise is missing, where it is 1e-3 or 1e-2 m/s.
@pytest.mark.parametrize('noise', [1e-3, 1e-2, 1e-1])
@pytest.mark.parametrize('F_c', [0.0, 1.0])
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_the_noise_of_the_velocity_is_learnt_within_15_percent(noise, F_c, seed):
    axis = Plant(F_c=F_c, sensor=Sensor(velocity_noise=noise, seed=seed))
    learnt = learnt_of(axis, WARY, simulate(axis, WARY, 2.0), [2 * SECOND])[0]
    assert learnt.velocity_noise == pytest.approx(noise, rel=0.15)


# 0.42 to 0.85 of it; without looking at every sample then, 0.1 to 0.58.
@pytest.mark.parametrize('noise', [1e-3, 1e-2])
@pytest.mark.parametrize('F_c', [0.0, 1.0])
def test_noise_that_the_speed_hid_is_learnt_within_200_samples_once_it_has_halved(noise, F_c):
    for seed in range(1, 6):
        axis = Plant(F_c=F_c, sensor=Sensor(velocity_noise=noise, seed=seed))
        run = simulate(axis, WARY, 0.25)
        speed = np.abs(run.velocity)
        halved = int(np.flatnonzero(speed < 0.5 * np.maximum.accumulate(speed))[0])
        learnt = learnt_of(axis, WARY, run, [halved + 200])[0]
        assert 0.4 * noise < learnt.velocity_noise < 1.5 * noise


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('F_c', [0.0, 1.0])
@pytest.mark.parametrize('seed', [1, 2, 3])
def test_an_exact_axis_has_no_noise_at_all(kind, F_c, seed):
    axis = Plant(F_c=F_c, damping=Damping(kind=kind, seed=seed))
    samples = list(range(500, 2 * SECOND, 1500))
    for one in learnt_of(axis, GAINS, simulate(axis, GAINS, 2.0), samples):
        assert one.velocity_noise == 0.0


# -- suspension -------------------------------------------------------------------------------


def behind_a_fault(axis, gains, duration, *, lag=0, sign=1.0, frozen_at=math.inf):
    """
    Close the loop over a fault; return abs(x) [m] at most and the sample of each impulse.

    Commands wait ``lag`` samples and have the ``sign``. The sensor freezes at a sample. The third
    item is the number of impulses at the first suspension, None without one.
    """
    plant, law = SimulatedPlant(axis), SampledController(gains)
    queue, fired, largest, at_suspension = deque([0.0] * lag), [], 0.0, None
    for k in range(round(duration / STEP)):
        if k <= frozen_at:
            seen = plant.measured()
        effort, _, guard, _, verdict, _ = law.answer(*seen)
        if guard != NO_IMPULSE:
            fired.append(k)
        if verdict != NO_VERDICT and at_suspension is None and law.suspended:
            at_suspension = len(fired)
        queue.append(sign * effort)
        plant.step(queue.popleft())
        if k % 10 == 0:  # often enough for a motion of seconds
            largest = max(largest, abs(plant.state()[1]))
    return largest, fired, at_suspension


# At 6 s, 1.43 times PD without friction and 1.55 times with it: the two impulses of 0.375 N s.
@pytest.mark.parametrize(('F_c', 'most'), [(0.0, 1.5), (1.0, 1.6)])
def test_a_queue_of_24000_samples_suspends_impulses_within_two(F_c, most):
    axis = Plant(F_c=F_c)
    alone, _, _ = behind_a_fault(axis, PD, 6.0, lag=24_000)
    largest, _, at_suspension = behind_a_fault(axis, GAINS, 6.0, lag=24_000)
    assert at_suspension in (1, 2)
    assert largest <= most * alone


@pytest.mark.parametrize('F_c', [0.0, 1.0])
def test_a_sensor_that_freezes_at_the_start_suspends_impulses_within_two(F_c):
    axis = Plant(F_c=F_c)
    alone, _, _ = behind_a_fault(axis, PD, 1.5, frozen_at=0)
    largest, _, at_suspension = behind_a_fault(axis, GAINS, 1.5, frozen_at=0)
    assert at_suspension in (1, 2)
    assert largest <= 1.5 * alone


@pytest.mark.parametrize('F_c', [0.0, 1.0])
def test_a_sensor_that_freezes_in_motion_gets_no_further_impulse(F_c):
    axis = Plant(F_c=F_c)
    alone, _, _ = behind_a_fault(axis, PD, 1.5, frozen_at=600)
    largest, fired, _ = behind_a_fault(axis, GAINS, 1.5, frozen_at=600)
    assert fired == [0]
    assert largest <= 1.5 * alone


# The first impulse is away from zero, before anything is known: 1.89 and 2.11 times PD at 0.5 s,
# 1.57 times with d = 1.5 N s/m.
@pytest.mark.parametrize('F_c', [0.0, 1.0])
def test_an_actuator_of_reversed_sign_suspends_impulses_after_the_first(F_c):
    axis = Plant(F_c=F_c)
    alone, _, _ = behind_a_fault(axis, PD, 0.5, sign=-1.0)
    largest, _, at_suspension = behind_a_fault(axis, GAINS, 0.5, sign=-1.0)
    assert at_suspension == 1
    assert largest <= 2.2 * alone


# With F_c = 1 N and 0.3 kg, impulses at 23 mm and at 2.6 mm count as stalled; with 0.05 kg, jumps
# at 1.3 micrometres as reversed.
@pytest.mark.parametrize(('F_c', 'mass'), [(0.0, 0.05), (0.0, 0.1), (0.0, 0.3), (1.0, 0.1)])
@pytest.mark.parametrize('damping', [0.15, 0.8, 1.5])
def test_impulses_spread_by_the_effort_limit_are_not_suspended(F_c, mass, damping):
    axis = Plant(F_c=F_c, m=mass, damping=Damping(value=damping))
    gains = ControlGains(effort_limit=20.0)
    run = simulate(axis, gains, 3.0)
    judged = run.verdicts['tick']
    above = judged[np.abs(run.position[judged]) > FLOOR].tolist()
    assert above
    assert all(one.suspended == 0.0 for one in learnt_of(axis, gains, run, above))


# -- the paper's law --------------------------------------------------------------------------


@pytest.mark.parametrize('name', ['underdamped', 'time_varying', 'coulomb'])
def test_without_supervision_the_law_is_that_without_options_to_the_bit(name):
    made = load_experiment(CONFIG / f'{name}.yaml')
    gains = replace(made.gains, supervision=False)
    plain, full = (empty_trace(SECOND) for _ in range(2))
    ClosedLoop(made.plant, gains, plain=True).fill(plain)
    ClosedLoop(made.plant, gains).fill(full)
    for field in ('position', 'velocity', 'effort', 'area', 'guard'):
        assert getattr(plain, field).tobytes() == getattr(full, field).tobytes()


@pytest.mark.parametrize('name', ['underdamped', 'time_varying', 'coulomb'])
def test_with_supervision_the_papers_runs_are_the_same_above_the_friction_floor(name):
    made = load_experiment(CONFIG / f'{name}.yaml')
    runs = [simulate(made.plant, replace(made.gains, supervision=on), 3.0) for on in (True, False)]
    end = len(runs[1].time)
    if name == 'coulomb':
        end = int(np.flatnonzero(np.abs(runs[1].position) > FLOOR)[-1]) + 1
    for field in ('position', 'velocity', 'effort'):
        on, off = (getattr(run, field)[:end] for run in runs)
        assert on.tobytes() == off.tobytes()
    verdicts = runs[0].verdicts
    assert (verdicts['verdict'][verdicts['tick'] < end] == CONFIRMED).all()


def test_below_the_friction_floor_the_impulses_end():
    made = load_experiment(CONFIG / 'coulomb.yaml')
    on, off = (
        simulate(made.plant, replace(made.gains, supervision=is_on), 5.0)
        for is_on in (True, False)
    )
    assert len(off.events) == 17_871
    assert len(on.events) < 17_871 / 2
    assert on.events['tick'][-1] < 4 * SECOND
    assert abs(on.position[-1]) < FLOOR


# At 4 s up to 5.7 steps, and up to 601 impulses. Each hidden impulse alone:
# up to 44 steps. Noise that the speed hides is learnt late: up to 31 steps.
def test_impulses_at_rest_that_the_noise_hides_bring_the_axis_within_eight_encoder_steps():
    made = load_experiment(CONFIG / 'encoder.yaml')
    step = made.plant.sensor.resolution
    gains = replace(made.gains, position_deadband=1.5 * step)
    for x_0 in np.linspace(0.1, 0.5, 9):
        for seed in (1, 2):
            axis = replace(made.plant, x_0=x_0, sensor=replace(made.plant.sensor, seed=seed))
            run = simulate(axis, gains, 4.0)
            assert abs(run.position[-1]) < 8.0 * step
            assert len(run.events) < 1000
            assert np.count_nonzero(run.events['tick'] > 3 * SECOND) <= 8


def test_an_axis_of_half_the_mass_diverges_by_the_papers_law_and_settles_supervised():
    axis = Plant(m=0.05, F_c=0.0)
    with pytest.raises(DivergedError):
        simulate(axis, replace(GAINS, supervision=False), 0.5)
    assert abs(simulate(axis, GAINS, 0.5).position[-1]) < 1e-6


# -- random axes ------------------------------------------------------------------------------


def test_random_axes_of_wrong_mass_delay_and_noise_settle():
    rng, count = np.random.default_rng(11), 60
    varied = {
        'plant_simulator.m': 0.1 * np.exp(rng.uniform(np.log(0.2), np.log(5.0), count)),
        'damping.value': rng.uniform(0.15, 1.5, count),
        'F_c': rng.choice([0.0, 1.0], count),
        'x_0': rng.uniform(0.1, 0.5, count),
        'actuator.delay': rng.choice([0, 0, 5, 20, 100, 300], count),
        'sensor.velocity_noise': rng.choice([0.0, 0.0, 1e-3, 1e-2, 1e-1], count),
        'sensor.seed': rng.integers(1, 2**31, count),
    }
    figures = simulate_batch(Plant(), WARY, 6.0, varied)
    settled = figures['settling_time'][:, 0]
    assert not figures['diverged'].any()
    assert np.isnan(settled).mean() <= 0.04
    alone = simulate_batch(Plant(), replace(WARY, impulses=False), 6.0, varied)
    assert np.isnan(alone['settling_time'][:, 0]).mean() > 0.3
    assert np.median(np.nan_to_num(settled, nan=6.0)) <= 0.35
