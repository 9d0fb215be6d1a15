"""Laws of variation: each is what it is called, and a draw depends on its number alone."""

import math
from statistics import NormalDist

from hypothesis import given, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.distributions import ALLOWED, AXES, distribution_of, DISTRIBUTIONS
from impulse_control_ros.errors import ParameterError

RUNS = 20_000
CONTINUOUS = {
    'uniform': ([-2.0, 3.0], lambda x: (x + 2.0) / 5.0),
    'log_uniform': ([0.01, 100.0], lambda x: math.log(x / 0.01) / math.log(1e4)),
    'normal': ([1.0, 0.5], NormalDist(1.0, 0.5).cdf),
}
EXAMPLES = {
    'values': [1.0, 2.0],
    'grid': [0.0, 1.0, 3],
    'log_grid': [0.1, 10.0, 3],
    'uniform': [0.0, 1.0],
    'log_uniform': [0.1, 10.0],
    'normal': [0.0, 1.0],
    'choice': [1.0, 2.0],
    'seeds': True,
}
GOLDEN = ['-0x1.0a13c8075c8c0p-1', '0x1.b01743abc460bp-1', '0x1.7fbded5788b60p-1']
DRAWN = [kind for kind in DISTRIBUTIONS if kind not in AXES]


def example(kind):
    return distribution_of('K', {kind: EXAMPLES[kind]})


@pytest.mark.parametrize('kind', CONTINUOUS)
def test_draws_have_the_distribution_of_their_name(kind):
    arguments, cdf = CONTINUOUS[kind]
    draws = np.sort(distribution_of('K', {kind: arguments}).draws(1, 'K', 0, RUNS))
    expected = np.array([cdf(value) for value in draws])
    ranks = np.arange(RUNS) / RUNS
    # Kolmogorov and Smirnov: 1.63 / sqrt(n) is exceeded once in a hundred seeds
    assert max(
        np.max(np.abs(expected - ranks)), np.max(np.abs(expected - ranks - 1 / RUNS))
    ) < 1.63 / math.sqrt(RUNS)


def test_a_choice_draws_each_value_as_often_as_it_is_listed():
    draws = distribution_of('c', {'choice': ['a', 'b', 'b', 'c']}).draws(1, 'c', 0, RUNS)
    shares = [draws.count(value) / RUNS for value in 'abc']
    assert shares == pytest.approx([0.25, 0.5, 0.25], abs=0.01)


def test_seeds_differ_and_are_signed_integers():
    draws = example('seeds').draws(1, 'damping.seed', 0, RUNS)
    assert len(set(draws)) == RUNS
    assert min(draws) >= 0
    assert 2**62 < max(draws) < 2**63


@pytest.mark.parametrize('kind', DRAWN)
@given(first=st.integers(0, 500), count=st.integers(1, 50))
def test_a_draw_depends_on_its_number_alone(kind, first, count):
    law = example(kind)
    assert law.draws(3, 'K', first, count) == law.draws(3, 'K', 0, 600)[first : first + count]


def test_parameters_and_seeds_have_streams_of_their_own():
    law = example('normal')
    streams = np.array(
        [law.draws(seed, name, 0, RUNS) for seed in (1, 2) for name in ('K', 'D', 'controller.D')]
    )
    assert np.abs(np.corrcoef(streams) - np.eye(len(streams))).max() < 0.03


def test_draws_are_the_same_on_every_machine():
    draws = example('normal').draws(1, 'K', 0, 3)
    assert [value.hex() for value in draws] == GOLDEN


@pytest.mark.parametrize('kind', DRAWN)
def test_no_draw_leaves_the_extremes(kind):
    law = example(kind)
    low, high = min(law.extremes(1, 'K', RUNS)), max(law.extremes(1, 'K', RUNS))
    assert all(low <= value <= (high or 2**63) for value in law.draws(1, 'K', 0, RUNS))


def test_grids_end_where_they_say():
    assert distribution_of('K', {'grid': [0.0, 1.0, 5]}).points() == [0.0, 0.25, 0.5, 0.75, 1.0]
    points = distribution_of('K', {'log_grid': [0.1, 10.0, 3]}).points()
    assert points == pytest.approx([0.1, 1.0, 10.0])
    assert (points[0], points[-1]) == (0.1, 10.0)


@pytest.mark.parametrize(
    ('given_law', 'said'),
    [
        ({'gaussian': [0, 1]}, 'K: gaussian: there is no such distribution; must be values, '),
        ({'unifrom': [0, 1]}, 'K: unifrom: there is no such distribution; is uniform meant?'),
        (1.0, 'K = 1.0: must be one distribution: values, grid, '),
        ({'uniform': [0, 1], 'normal': [0, 1]}, ': must be one distribution'),
        ({'uniform': [1.0, 0.0]}, 'K: uniform = [1.0, 0.0]: must be [from, to] with'),
        ({'uniform': [0.0, math.nan]}, 'K: uniform = [0.0, nan]'),
        ({'uniform': [0, 10**400]}, 'K: uniform = [0, 1000'),
        ({'uniform': 3.0}, 'K: uniform = 3.0'),
        ({'uniform': [0, 1, 2]}, 'K: uniform = [0, 1, 2]'),
        ({'uniform': ['a', 'b']}, "K: uniform = ['a', 'b']"),
        ({'log_uniform': [0.0, 1.0]}, 'must be [from, to] with 0 < from < to'),
        ({'normal': [0.0, 0.0]}, 'K: normal = [0.0, 0.0]: must be [mean, standard'),
        ({'grid': [0.0, 1.0, 1]}, 'K: grid = [0.0, 1.0, 1]: must be [from, to, steps]'),
        ({'grid': [0.0, 1.0, 2.5]}, 'K: grid = [0.0, 1.0, 2.5]'),
        ({'log_grid': [-1.0, 1.0, 3]}, 'K: log_grid = [-1.0, 1.0, 3]'),
        ({'values': []}, 'K: values = []: must be a list of different values'),
        ({'values': [1.0, 1.0]}, 'K: values = [1.0, 1.0]'),
        ({'choice': [[1.0]]}, 'K: choice = [[1.0]]'),
        ({'seeds': False}, 'K: seeds = False: must be true'),
    ],
)
def test_a_wrong_law_is_refused_in_one_line(given_law, said):
    with pytest.raises(ParameterError) as refused:
        distribution_of('K', given_law)
    assert said in str(refused.value)
    assert '\n' not in str(refused.value)


def test_every_law_says_what_is_allowed():
    assert set(ALLOWED) == set(DISTRIBUTIONS) == set(EXAMPLES)
