"""Studies: a row depends on its number alone, and is the run that simulate_batch makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from impulse_control_ros.core import sweep_config as module
from impulse_control_ros.core.batch import simulate_batch
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.distributions import Distribution, distribution_of
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.sweep_config import (
    described,
    Extent,
    run_chunk,
    SweepConfig,
    units,
    varied,
)
from impulse_control_ros.errors import ParameterError

MIXED = {
    'F_c': {'uniform': [0.0, 1.5]},
    'c': {'values': [1, 2]},
    'damping.seed': {'seeds': True},
    'hold_off': {'grid': [0, 10, 3]},
    'plant_simulator.m': {'normal': [0.1, 0.002]},
    'impulses': {'choice': [True, True, False]},
}


def study(vary=MIXED, runs=50, duration=0.02, **values):
    laws = {name: distribution_of(name, law) for name, law in vary.items()}
    return SweepConfig(
        **{
            'axis': Plant(damping=Damping(kind='noise')),
            'controller': ControlGains(),
            'extent': Extent(runs=runs, duration=duration, seed=3),
            'vary': laws,
        }
        | values
    )


def whole(made):
    """Return all chunks in one."""
    chunks = [run_chunk(made, number) for number in range(made.chunks)]
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}


def test_a_row_depends_on_its_number_alone():
    made = study()
    everything = varied(made, range(made.rows))
    for rows in (range(0, 7), range(43, 60), range(49, 51), range(0, 300), range(299, 300)):
        part = varied(made, rows)
        for name, values in part.items():
            assert values.tobytes() == everything[name][rows.start : rows.stop].tobytes()


def test_a_chunk_draws_no_more_than_it_needs(monkeypatch):
    made = study(runs=10_000)
    counts, draws = [], Distribution.draws

    def counted(law, seed, name, first, count):
        counts.append(count)
        return draws(law, seed, name, first, count)

    monkeypatch.setattr(Distribution, 'draws', counted)
    for rows in (range(9_990, 10_020), range(0, 40), range(19_999, 20_003)):
        counts.clear()
        varied(made, rows)
        laws = [law for law in made.vary.values() if not law.is_axis]
        assert sum(counts) == len(laws) * len(rows)


def test_the_size_of_a_chunk_leaves_every_bit(monkeypatch):
    large = whole(study())
    assert study().chunks > 1
    monkeypatch.setattr(module, 'CHUNKS', 1)
    assert study().chunks == 2
    small = whole(study())
    assert {name: values.tobytes() for name, values in large.items()} == {
        name: values.tobytes() for name, values in small.items()
    }


def test_the_figures_are_those_of_a_batch():
    made = study()
    rows = varied(made, range(made.rows))
    batch = simulate_batch(made.axis, made.controller, 0.02, rows, made.tolerances)
    result = whole(made)
    for name in set(batch.dtype.names) - {'settling_time'}:
        assert result[name].tobytes() == batch[name].tobytes()
    assert result['settling_time_0.001'].tobytes() == batch['settling_time'][:, 1].tobytes()
    assert np.array_equal(
        result['impulses'], batch['position_zero'] + batch['velocity_zero'] + batch['sticking']
    )


def test_every_combination_of_the_axes_sees_the_same_draws():
    made = study()
    rows = varied(made, range(made.rows))
    assert made.rows == 2 * 3 * 50
    assert np.array_equal(rows['c'], np.repeat([1.0, 2.0], 150))
    assert np.array_equal(rows['hold_off'], np.tile(np.repeat([0, 5, 10], 50), 2))
    for name in ('F_c', 'damping.seed', 'plant_simulator.m', 'impulses'):
        assert np.array_equal(rows[name], np.tile(rows[name][:50], 6))


def test_columns_have_the_type_of_their_parameter():
    rows = varied(study(), range(10))
    assert {name: values.dtype.kind for name, values in rows.items()} == {
        'F_c': 'f',
        'c': 'f',
        'damping.seed': 'i',
        'hold_off': 'i',
        'plant_simulator.m': 'f',
        'impulses': 'b',
    }


def test_another_varied_parameter_leaves_the_draws_of_the_others():
    alone = varied(study({'F_c': MIXED['F_c']}), range(50))['F_c']
    full = varied(study({'plant_simulator.F_c': MIXED['F_c']}), range(50))
    assert np.array_equal(alone, varied(study(), range(50))['F_c'])
    assert np.array_equal(alone, full['plant_simulator.F_c'])


def test_the_columns_are_those_that_have_units():
    made = study()
    assert list(run_chunk(made, 0)) == list(units(made))
    assert units(made)['peak_effort'] == 'N'


@pytest.mark.parametrize(
    'change',
    [
        {'extent': Extent(runs=51, duration=0.02, seed=3)},
        {'extent': Extent(runs=50, duration=0.03, seed=3)},
        {'extent': Extent(runs=50, duration=0.02, seed=4)},
        {'axis': Plant()},
        {'controller': ControlGains(K=11.0)},
        {'tolerances': (1e-2,)},
        {'vary': {'F_c': distribution_of('F_c', {'uniform': [0.0, 1.6]})}},
    ],
)
def test_a_description_tells_different_studies_apart(change):
    assert described(replace(study(), **change)) != described(study())


@pytest.mark.parametrize(
    ('vary', 'said'),
    [
        ({'K': {'uniform': [-1.0, 1.0]}}, 'K = -1.0: must be > 0 [N/m]'),
        ({'alpha_ratio': {'uniform': [0.5, 1.0]}}, 'alpha_ratio = 1.0: must be in [0.5, 1'),
        ({'F_c': {'normal': [0.1, 1.0]}}, ': must be >= 0 [N]'),
        (
            {'hold_off': {'uniform': [0, 5]}},
            'hold_off: uniform: must be grid, values, choice, seeds',
        ),
        (
            {'hold_off': {'grid': [0, 5, 3]}, 'F_c': {'choice': [1]}},
            'hold_off = 2.5: must be an integer',
        ),
        ({'c': {'choice': [1.0, 3.0]}}, 'c = 3.0: must be one of 1.0, 2.0'),
        ({'x_r': {'seeds': True}}, 'x_r: seeds: must be values, grid, log_grid, unif'),
        ({'impulses': {'uniform': [0.0, 1.0]}}, 'impulses: uniform: must be values, ch'),
        (
            {'m': {'uniform': [0.1, 0.2]}},
            'm: no such parameter can be varied; is plant_simulator.m or controller.m meant?',
        ),
        ({'F_d': {'uniform': [0.1, 0.2]}}, 'F_d: no such parameter can be varied; is F_c'),
        ({'F_c': {'values': [0]}, 'plant_simulator.F_c': {'values': [1]}}, 'is varied twice'),
        (
            {'damping.lower': {'uniform': [0.1, 2.0]}, 'F_c': {'values': [0]}},
            'damping.lower = 2.0: must be <= damping.upper = 1.5 [N s/m]',
        ),
        (
            {'damping.lower': {'grid': [0.1, 2.0, 3]}, 'damping.upper': {'uniform': [1.0, 3.0]}},
            'damping.lower = 2.0: must be <= damping.upper = 1 [N s/m]',
        ),
        ({'F_c': {'values': [0.0, 1.0]}}, 'runs = 50: must be 1 where no parameter is'),
        (
            {
                'K': {'grid': [1, 2, 100_000]},
                'D': {'grid': [1, 2, 100_000]},
                'F_c': {'choice': [1]},
            },
            'runs = 500000000000: must be <= 1000000000 at all points together',
        ),
        ({}, 'vary = {}'),
    ],
)
def test_what_a_run_would_refuse_is_refused_before_any(vary, said):
    with pytest.raises(ParameterError) as refused:
        study(vary)
    assert said in str(refused.value)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        ({'tolerances': (0.0,)}, 'tolerances = [0.0]: must be a list of numbers > 0'),
        ({'tolerances': ()}, 'tolerances = []'),
        ({'duration': 1e-5}, 'duration = 1e-05: must be >= 0.0001 [s]'),
        ({'runs': 0}, 'runs = 0'),
        ({'duration': 1e6}, 'duration = 1000000.0: must be <= 1e+09 steps of 0.0001 s'),
    ],
)
def test_a_study_that_says_nothing_is_refused(values, said):
    with pytest.raises(ParameterError) as refused:
        study(**values)
    assert said in str(refused.value)


def test_a_parameter_and_a_figure_of_one_name_have_a_column_each():
    made = study({'impulses': {'values': [False, True]}}, runs=1)
    columns = whole(made)
    assert columns['controller.impulses'].tolist() == [False, True]
    assert columns['impulses'][0] == 0 < columns['impulses'][1]
    assert list(columns) == list(units(made))
