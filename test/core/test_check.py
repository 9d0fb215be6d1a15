"""The checker: it passes every run of ours, and names what is wrong with any other."""

from dataclasses import replace

import numpy as np
import pytest

from impulse_control_ros.core.check import check_run
from impulse_control_ros.core.check_law import check_commands
from impulse_control_ros.core.check_motion import check_motion
from impulse_control_ros.core.check_report import LoopSamples, Report
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.nonidealities import Actuator, Disturbance, Payload, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.plant_step import PlantState
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.simulated_plant import SimulatedPlant
from impulse_control_ros.core.stribeck import Stribeck
from impulse_control_ros.errors import DivergedError
from impulse_control_ros.files.parameter_file import load_experiment
from test.conftest import CONFIG

# meets every guard
PLANT, GAINS, DURATION = Plant(x_0=0.3), ControlGains(supervision=False), 0.5
RUN = simulate(PLANT, GAINS, DURATION)


def seen(plant, gains, steps, answers=lambda answer: answer):
    """Return what a controller sees and does of a closed loop, its ``answers`` changed."""
    axis, controller = SimulatedPlant(plant), SampledController(gains)
    measured, commands, applied, damping = [], [], [], []
    for _ in range(steps):
        measured.append(axis.measured())
        commands.append(answers(controller.answer(*measured[-1])[:3]))
        axis.step(commands[-1][0])
        state = PlantState(*axis.state())
        applied.append(state.effort)
        damping.append(state.damping)
    (position, velocity), (effort, area, guard) = np.transpose(measured), np.transpose(commands)
    first = np.arange(steps) == 0
    return LoopSamples(
        time=np.arange(steps) * plant.time_step,
        time_step=plant.time_step,
        position=position,
        velocity=velocity,
        effort=effort,
        applied=np.array(applied),
        damping=np.array(damping),
        guard=guard.astype(int),
        area=area,
        starts=first,
        fresh=first,
    )


def violated(loop, plant=PLANT, gains=GAINS):
    checks = [*check_motion(loop, plant), *check_commands(loop, gains)]
    return Report(checks=checks, time=loop.time).violated


@pytest.mark.parametrize('config', sorted(CONFIG.glob('*.yaml')), ids=lambda path: path.stem)
def test_a_run_of_every_config_is_a_solution(config):
    made = load_experiment(config)
    report = check_run(
        simulate(made.plant, made.gains, 1.0),
        made.plant,
        made.gains,
    )
    assert not report.violated, report
    checked = {check.name: check.checked for check in report.checks}
    assert all(count > 0 for name, count in checked.items() if 'impulse' not in name)
    assert (checked['impulse area'] > 0) == made.gains.impulses


def drawn(rng):
    """Return a plant with any hardware, and gains with any options."""

    def pick(*values):
        return values[rng.integers(len(values))]

    step, F_c, seed = pick(1e-3, 1e-4, 2e-5), pick(0.0, 0.3, 1.0), int(rng.integers(2**31))
    plant = Plant(
        m=pick(0.1, 0.3, 2.0),
        F_c=F_c,
        x_0=pick(0.5, 0.15, -0.3, 0.0),
        v_0=pick(0.0, 0.0, 1.0, -3.0),
        time_step=step,
        damping=Damping(
            kind=pick('constant', 'noise', 'sinusoidal'), value=pick(0.15, 1.5, 30.0), seed=seed
        ),
        stribeck=Stribeck(F_s=pick(0.0, 1.5 * F_c), v_s=pick(0.01, 0.3)),
        sensor=Sensor(
            resolution=pick(0.0, 1e-4),
            position_noise=pick(0.0, 1e-5),
            velocity=pick('ideal', 'ideal', 'difference', 'none'),
            velocity_noise=pick(0.0, 1e-2, 1e-3),
            seed=seed,
        ),
        actuator=Actuator(
            limit=pick(0.0, 20.0, 100.0), time_constant=pick(0.0, 0.0, 1e-3), delay=pick(0, 0, 7)
        ),
        payload=Payload(mass=pick(0.0, 0.05, -0.05), time=pick(0.0, 100 * step)),
        disturbance=Disturbance(
            kind=pick('constant', 'noise', 'sinusoidal'),
            force=pick(0.0, 0.0, 0.5),
            start=pick(0.0, 50 * step),
            end=pick(0.0, 200 * step),
        ),
    )
    return plant, ControlGains(
        m=pick(0.1, 0.12),
        c=pick(1.0, 2.0),
        x_r=pick(0.0, 0.1),
        K_i=pick(0.0, 0.0, 20.0),
        effort_limit=pick(0.0, 0.0, 2.0, 20.0, 200.0),
        position_deadband=pick(0.0, 1e-6, 2e-4),
        velocity_deadband=pick(0.0, 1e-6, 0.05),
        hold_off=pick(0, 0, 3),
        guard_lookahead=pick(0.0, 0.5),
        position_hysteresis=pick(0.0, 0.0, 1e-4),
        velocity_hysteresis=pick(0.0, 0.0, 0.01),
        stiction_wait_samples=pick(1, 1, 5),
        velocity_source=pick('measured', 'measured', 'estimated'),
        supervision=pick(False, True),
        time_step=step,
    )


@pytest.mark.parametrize('seed', range(100))
def test_no_hardware_noise_or_option_gives_a_false_alarm(seed):
    plant, gains = drawn(np.random.default_rng(seed))
    try:
        run = simulate(plant, gains, 1000 * plant.time_step)
    except DivergedError:
        return
    report = check_run(run, plant, gains)
    assert not report.violated, report
    assert not violated(seen(plant, gains, 600), plant, gains)


@pytest.mark.parametrize(
    ('plant', 'gains', 'names'),
    [
        ({'m': 0.1001}, {}, ['position step', 'momentum']),
        ({'F_c': 1.001}, {}, ['momentum']),
        ({'damping': Damping(value=0.1501)}, {}, ['damping']),
        ({'disturbance': Disturbance(force=1e-6)}, {}, ['momentum']),
        ({'actuator': Actuator(delay=1)}, {}, ['applied effort']),
        ({'actuator': Actuator(limit=100.0)}, {}, ['applied effort']),
        ({}, {'K': 10.0001}, ['effort']),
        ({}, {'D': 0.50001}, ['effort']),
        ({}, {'alpha_ratio': 0.6001}, ['impulse area']),
        ({}, {'m': 0.1001}, ['impulse area']),
        ({}, {'d_bar': 1.5001}, ['impulse area']),
        ({}, {'c': 1.0}, ['impulse area']),
        ({}, {'effort_limit': 100.0}, ['effort']),
        ({}, {'K_i': 1.0}, ['effort']),
        ({}, {'impulses': False}, ['unexplained impulse', 'effort']),
        ({}, {'position_deadband': 0.02}, ['unexplained impulse']),
        ({}, {'velocity_deadband': 0.2}, ['missed sticking', 'unexplained impulse']),
        ({}, {'stiction_wait_samples': 2}, ['unexplained impulse']),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else '',
)
def test_what_differs_from_the_parameters_is_found_and_named(plant, gains, names):
    report = check_run(RUN, replace(PLANT, **plant), replace(GAINS, **gains))
    assert report.violated == names, report


@pytest.mark.parametrize('guard', GUARDS[1:])
def test_a_missed_guard_and_a_wrong_impulse_are_found_and_named(guard):
    def without(answer):
        effort, area, met = answer
        return (effort - area / 1e-4, 0.0, 0) if GUARDS[met] == guard else answer

    def scaled(by):
        def change(answer):
            effort, area, met = answer
            more = (by - 1.0) * area if GUARDS[met] == guard else 0.0
            return effort + more / 1e-4, area + more, met

        return change

    def count(loop):
        return np.count_nonzero(loop.guard == GUARDS.index(guard))

    right = seen(PLANT, GAINS, 3000)
    assert count(right)
    assert violated(right) == []
    assert violated(seen(PLANT, GAINS, 3000, without)) == [f'missed {guard}']
    for by in (-1.0, 1.001, 0.5):
        assert violated(seen(PLANT, GAINS, 3000, scaled(by))) == ['impulse area']


def changed_once(at, change):
    """Return a function of the answers that changes the one ``at`` this place."""
    count = -1

    def answers(answer):
        nonlocal count
        count += 1
        effort, area, guard = answer
        new_area, new_guard = change(area, guard) if count == at else (area, guard)
        return effort + (new_area - area) / PLANT.time_step, new_area, new_guard

    return answers


# the controller has to learn the mass, the delay and the noise
FOREIGN = Plant(
    x_0=0.3, m=0.15, actuator=Actuator(delay=7), sensor=Sensor(velocity_noise=1e-4, seed=3)
)


@pytest.mark.parametrize('plant', [PLANT, FOREIGN], ids=['ideal', 'foreign'])
@pytest.mark.parametrize('options', [{}, {'velocity_source': 'estimated'}])
def test_a_wrong_impulse_under_supervision_is_found_and_named(plant, options):
    gains = replace(GAINS, supervision=True, **options)
    right = seen(plant, gains, 3000)
    fired = np.flatnonzero(right.guard)
    assert len(fired) >= 3
    assert violated(right, plant, gains) == []
    for at in fired[[0, 1, -1]]:
        guard = GUARDS[right.guard[at]]
        for change, sample, names in (
            (lambda area, guard: (0.0, 0), at, {f'missed {guard}'}),
            (lambda area, guard: (1.001 * area, guard), at, {'impulse area'}),
            (lambda area, guard: (-area, guard), at, {'impulse area'}),
            (lambda area, guard: (-1e-3, 3), at + 1, {'unexplained impulse'}),
        ):
            made = seen(plant, gains, 3000, changed_once(sample, change))
            found = [one for one in check_commands(made, gains) if one.violations]
            assert names <= {one.name for one in found} <= names | {'impulse area bounds'}
            assert {(one.violations, one.first.sample) for one in found} == {(1, sample)}
            assert not [one for one in check_motion(made, plant) if one.violations]


def test_direction_bounds_and_effort_under_supervision_are_checked_without_the_past():
    gains = replace(GAINS, supervision=True)
    late = replace(seen(FOREIGN, gains, 3000), fresh=np.zeros(3000, bool))
    assert violated(late, FOREIGN, gains) == []
    for at in np.flatnonzero(late.guard):
        for by in (-1.0, 6.0):
            area, effort = late.area.copy(), late.effort.copy()
            area[at] *= by
            effort[at] += (area[at] - late.area[at]) / PLANT.time_step
            made = replace(late, area=area, effort=effort)
            assert violated(made, FOREIGN, gains) == ['impulse area bounds']
    late.effort[1000] += 1e-9
    assert violated(late, FOREIGN, gains) == ['effort']


@pytest.mark.parametrize(
    ('name', 'by', 'names'),
    [
        ('position', 1e-9, ['position step', 'momentum', 'effort']),
        ('velocity', 1e-9, ['momentum', 'effort']),
        ('effort', 1e-9, ['applied effort', 'effort']),
        ('applied', 1e-6, ['momentum', 'applied effort']),
    ],
)
def test_a_single_wrong_sample_is_found_where_it_is(name, by, names):
    changed = getattr(RUN, name).copy()
    changed[1000] += by
    other = {f'measured_{name}': changed} if name in ('position', 'velocity') else {}
    report = check_run(replace(RUN, **{name: changed}, **other), PLANT, GAINS)
    assert set(report.violated) <= set(names), report
    assert report.violated[0] == names[0], report
    assert all(
        check.first.sample in (999, 1000) and check.violations <= 2
        for check in report.checks
        if check.violations
    )
    assert 'first at 0.' in str(report)


def test_an_impulse_that_no_guard_explains_is_found():
    made = seen(PLANT, GAINS, 1000)
    at = 7
    assert made.guard[at] == 0
    made.guard[at], made.area[at] = 2, -GAINS.d_bar / GAINS.c * made.position[at]
    made.effort[at] += made.area[at] / PLANT.time_step
    assert 'unexplained impulse' in violated(made)


def test_noise_hides_a_wrong_friction_from_one_sample_but_not_from_many():
    noisy = replace(PLANT, sensor=Sensor(velocity_noise=2e-3))
    made = seen(noisy, replace(GAINS, velocity_deadband=0.02), 3000)
    names = violated(made, replace(noisy, F_c=1.2), replace(GAINS, velocity_deadband=0.02))
    assert names
    assert set(names) <= {'momentum of 100 samples', 'momentum of 1000 samples'}


def test_an_axis_that_does_not_move_over_its_samples_as_fast_as_it_says_is_found():
    made = seen(PLANT, GAINS, 300)
    slow = made.position + 1e-5 * np.arange(300) * made.time
    assert 'position step' in violated(replace(made, position=slow))


@pytest.mark.parametrize(
    'options',
    [{}, {'hold_off': 5}, {'K_i': 5.0}, {'velocity_source': 'estimated'}, {'supervision': True}],
)
def test_samples_that_are_missing_are_no_violation(options):
    gains = replace(GAINS, **options)
    made = seen(PLANT, gains, 2000)
    keep = np.random.default_rng(1).random(2000) > 0.05
    part = replace(
        made,
        **{
            name: values[keep]
            for name, values in vars(made).items()
            if name not in ('time_step', 'starts', 'breaks', 'dt')
        },
        starts=np.zeros(keep.sum(), bool),
    )
    assert violated(part, gains=gains) == []
    checks = check_commands(part, gains)
    assert all('follow unknown' in check.note for check in checks if 'missed' in check.name)


@pytest.mark.parametrize('signal', ['position', 'velocity', 'effort', 'applied'])
@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_a_signal_that_is_not_finite_is_a_violation(signal, value):
    plant, gains = Plant(), ControlGains()
    run = simulate(plant, gains, 0.01)
    values = getattr(run, signal).copy()
    values[50] = value
    report = check_run(replace(run, **{signal: values}), plant, gains)
    assert report.violated == [signal]
    assert 'first at 0.005 s' in str(report)
