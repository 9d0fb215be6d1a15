"""Batches: each run is the simulation of its row, whatever runs beside it."""

from dataclasses import replace
import tracemalloc

import numba
import numpy as np
import pytest

from impulse_control_ros.core.batch import damping_seeds, run_blocks, simulate_batch
from impulse_control_ros.core.batch_lanes import LANES, loaded, places
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.metrics import figures
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.supervision import SUPERVISION
from impulse_control_ros.core.varied import columns, packed_rows, row
from impulse_control_ros.errors import DivergedError, ParameterError

AXIS, CONTROLLER = Plant(F_c=1.0), ControlGains()
TOLERANCES = (1e-2, 1e-3, 1e-5)
THREADS = numba.config.NUMBA_NUM_THREADS


def assorted(runs, seed=1):
    """Draw rows that reach every branch of the laws."""
    draw = np.random.default_rng(seed)
    return {
        'plant_simulator.m': draw.uniform(0.08, 0.12, runs),
        'F_c': draw.choice([0.0, 0.3, 1.0], runs),
        'x_0': draw.uniform(-0.5, 0.5, runs),
        'v_0': draw.choice([0.0, 1.0, -3.0], runs),
        'damping.kind': draw.choice(['constant', 'noise', 'sinusoidal'], runs),
        'damping.value': draw.choice([0.15, 1.5, 30.0], runs),  # 30: beyond the series
        'damping.bandwidth': draw.uniform(1.0, 300.0, runs),
        'damping.seed': damping_seeds(seed, runs),
        'controller.m': draw.uniform(0.09, 0.11, runs),
        'K': draw.choice([5.0, 10.0, 40.0], runs),
        'c': draw.choice([1.0, 2.0], runs),
        'x_r': draw.choice([0.0, 0.1], runs),
        'impulses': draw.choice([True, True, True, False], runs),
        'effort_limit': draw.choice([0.0, 5.0, 50.0], runs),
        'hold_off': draw.choice([0, 1, 10], runs),
        'position_deadband': draw.choice([1e-6, 1e-3], runs),
    }


@pytest.mark.parametrize(('runs', 'duration'), [(150, 0.3), (1, 0.5), (LANES, 1e-4), (40, 0.01)])
def test_the_figures_of_a_run_are_those_of_its_simulation_to_the_last_bit(runs, duration):
    varied = assorted(runs, seed=runs)
    batch = simulate_batch(AXIS, CONTROLLER, duration, varied, TOLERANCES)
    for i in range(runs):
        axis, controller = row(AXIS, CONTROLLER, varied, i)
        run = simulate(axis, controller, duration)
        alone = figures(
            run.time,
            run.position - controller.x_r,
            run.velocity,
            run.effort,
            run.events,
            TOLERANCES,
        )
        assert batch[i : i + 1].tobytes() == alone.tobytes(), (axis, controller)


def test_a_supervised_run_is_its_simulation_whatever_mass_it_learns():
    draw = np.random.default_rng(3)
    varied = {
        'plant_simulator.m': 0.1 * np.exp(draw.uniform(-1.6, 1.6, 3 * LANES)),
        'F_c': draw.choice([0.0, 1.0], 3 * LANES),
        'x_0': draw.uniform(-0.5, 0.5, 3 * LANES),
        'v_0': draw.choice([0.0, 0.0, -3.0, 2.0], 3 * LANES),
        'damping.value': draw.uniform(0.15, 1.5, 3 * LANES),
        'effort_limit': draw.choice([0.0, 30.0, 300.0], 3 * LANES),
        'supervision': draw.choice([True, True, True, False], 3 * LANES),
        'position_deadband': draw.choice([1e-6, 2e-3], 3 * LANES),
    }
    batch = simulate_batch(AXIS, CONTROLLER, 1.5, varied, TOLERANCES)
    assert batch['diverged'].any()  # a mass well below the assumed one, unsupervised
    assert not batch['diverged'][varied['supervision']].any()
    for i in np.flatnonzero(~batch['diverged']):
        axis, controller = row(AXIS, CONTROLLER, varied, int(i))
        run = simulate(axis, controller, 1.5)
        alone = figures(run.time, run.position, run.velocity, run.effort, run.events, TOLERANCES)
        assert batch[i : i + 1].tobytes() == alone.tobytes(), (axis, controller)


@pytest.mark.parametrize('supervision', [False, True])
@pytest.mark.parametrize('steps', [1, 2, 3, 10, 333, 1500])
def test_the_state_of_a_lane_is_that_of_its_simulation_at_every_step(steps, supervision):
    controller = replace(CONTROLLER, supervision=supervision)
    varied = assorted(2 * LANES)
    rows = packed_rows(AXIS, controller, *columns(varied), 2 * LANES)
    blocks, laws, memories = loaded(rows), None, None
    if supervision:
        laws = rows.law.view(float).reshape(2 * LANES, -1)[places(2 * LANES)]
        memories = np.zeros(laws.shape[:2], SUPERVISION)
    run_blocks(blocks, laws, memories, steps, np.array(TOLERANCES), np.zeros((2, 3, LANES)))
    states = [blocks[name].ravel() for name in ('position', 'velocity', 'effort')]
    for i in range(2 * LANES):
        run = simulate(*row(AXIS, controller, varied, i), steps * AXIS.time_step)
        last = [values[-1] for values in (run.position, run.velocity, run.effort)]
        assert [values[i].tobytes() for values in states] == [value.tobytes() for value in last]


def test_the_assorted_rows_reach_every_guard():
    batch = simulate_batch(AXIS, CONTROLLER, 0.3, assorted(150))
    assert all((batch[name] > 0).any() for name in ('position_zero', 'velocity_zero', 'sticking'))
    assert not batch['diverged'].any()


def test_the_number_of_threads_leaves_every_bit():
    varied, results = assorted(1000), []
    try:
        for threads in (1, min(2, THREADS)):
            numba.set_num_threads(threads)
            results.append(simulate_batch(AXIS, CONTROLLER, 0.02, varied).tobytes())
    finally:
        numba.set_num_threads(THREADS)
    assert results[0] == results[1]


def test_the_order_of_the_rows_leaves_every_bit():
    varied = assorted(100)
    order = np.random.default_rng(0).permutation(100)
    straight = simulate_batch(AXIS, CONTROLLER, 0.05, varied)
    mixed = simulate_batch(
        AXIS, CONTROLLER, 0.05, {name: values[order] for name, values in varied.items()}
    )
    assert straight[order].tobytes() == mixed.tobytes()


def test_a_part_of_a_batch_is_the_batch_of_that_part():
    varied = assorted(100)
    whole = simulate_batch(AXIS, CONTROLLER, 0.05, varied)
    part = simulate_batch(
        AXIS, CONTROLLER, 0.05, {name: values[37:81] for name, values in varied.items()}
    )
    assert whole[37:81].tobytes() == part.tobytes()


def test_one_seed_gives_every_run_a_seed_of_its_own():
    seeds = damping_seeds(7, 1000)
    assert len(np.unique(seeds)) == 1000
    assert seeds.max() < 2**63
    assert np.array_equal(damping_seeds(7, 10), seeds[:10])
    assert not np.isin(damping_seeds(8, 1000), seeds).any()


def test_a_value_that_is_not_varied_is_that_of_the_base():
    axis = Plant(F_c=0.0, damping=Damping(kind='noise', seed=5))
    batch = simulate_batch(axis, ControlGains(K=12.0), 0.2, {'x_0': [0.5, 0.4]})
    run = simulate(axis, ControlGains(K=12.0), 0.2)
    assert batch['final_error'][0] == run.position[-1]


def test_memory_does_not_grow_with_the_number_of_steps():
    varied = {'x_0': np.linspace(0.1, 0.5, 600)}
    simulate_batch(AXIS, CONTROLLER, 1e-4, varied)
    peaks = []
    for duration in (1e-3, 1e-1):
        tracemalloc.start()
        batch = simulate_batch(AXIS, CONTROLLER, duration, varied)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert batch.nbytes < 200 * 600
    assert peaks[1] < 2.0 * peaks[0]  # as the threads happen to overlap
    assert peaks[1] < 2000 * 600  # one recorded signal of the longer run has 8000 bytes


def test_a_run_that_diverges_says_so_and_leaves_the_others_alone():
    varied = {'K': [10.0, 1e9, 10.0], 'impulses': [True, False, True]}
    batch = simulate_batch(AXIS, CONTROLLER, 1.0, varied)
    assert list(batch['diverged']) == [False, True, False]
    assert np.isnan(batch['settling_time'][1]).all()
    assert np.isnan(batch['ise'][1])
    assert batch[0].tobytes() == batch[2].tobytes()
    assert np.isfinite(batch['ise'][0])
    with pytest.raises(DivergedError):
        simulate(*row(AXIS, CONTROLLER, varied, 1), 1.0)


@pytest.mark.parametrize(
    ('name', 'values', 'message'),
    [
        ('K', [1.0, -1.0, -2.0], r'K\[1\] = -1.0: must be > 0 \[N/m\]'),
        ('F_c', [0.0, 1.0, np.nan], r'F_c\[2\] = nan: must be >= 0 \[N\]'),
        ('x_0', [np.inf, 0.0, 0.0], r'x_0\[0\] = inf: must be in \[-1e\+09, 1e\+09\]'),
        ('alpha_ratio', [0.5, 0.6, 1.0], r'alpha_ratio\[2\] = 1.0: must be in \[0.5, 1\)'),
        ('c', [1.0, 2.0, 1.5], r'c\[2\] = 1.5: must be one of 1.0, 2.0'),
        ('damping.kind', ['noise', 'white', 'noise'], r"damping.kind\[1\] = 'white'"),
        ('damping.seed', [1, 2, -1], r'damping.seed\[2\] = -1: must be in \[0, '),
        (
            'damping.lower',
            [0.1, 0.2, 2.0],
            r'damping.lower\[2\] = 2.0: must be <= damping.upper = 1.5 \[N s/m\]',
        ),
        ('hold_off', [1.0, 2.0, 3.0], r'hold_off\[0\] = 1.0: must be an integer'),
        ('impulses', [1, 0, 1], r'impulses\[0\] = 1: must be true or false'),
        ('K', ['a', 'b', 'c'], r"K\[0\] = 'a': must be a number \[N/m\]"),
        ('K', 3.0, r'K of shape \(\): must be \(3,\), as the others'),
        ('K', [3.0], r'K of shape \(1,\): must be \(3,\), as the others'),
        ('m', [1.0] * 3, 'm: .* is plant_simulator.m or controller.m meant'),
        ('time_step', [1e-4] * 3, 'time_step: no such parameter can be varied'),
        ('dampin.seed', [1] * 3, 'dampin.seed: .* is damping.seed meant'),
    ],
)
def test_what_may_not_be_varied_is_refused_in_one_line(name, values, message):
    with pytest.raises(ParameterError, match=message) as error:
        simulate_batch(AXIS, CONTROLLER, 1.0, {'d_bar': [1.5] * 3, name: values})
    assert '\n' not in str(error.value)


def test_a_batch_without_rows_is_refused():
    with pytest.raises(ParameterError, match='no parameter is varied'):
        simulate_batch(AXIS, CONTROLLER, 1.0, {})


def test_a_controller_with_another_time_step_is_refused():
    with pytest.raises(ParameterError, match='time_step = 0.001'):
        simulate_batch(AXIS, ControlGains(time_step=1e-3), 1.0, {'x_0': [0.5]})
