"""
Distributions from which a sweep takes parameter values.

An axis lists its values; a sweep runs every combination of its axes. A draw is computed by
inversion from u, uniform in (0, 1), or from the 64 bits z of u. Both are a hash of (seed, name, i)
only, so draw i depends neither on other draws nor on the machine.

============  ===========  =======================  ======================
distribution  arguments    value                    kind
============  ===========  =======================  ======================
values        [v_0, ...]   v_k                      axis
grid          [a, b, n]    a + (b - a) k / (n - 1)  axis
log_grid      [a, b, n]    a (b / a)^(k / (n - 1))  axis
uniform       [a, b]       a + (b - a) u            draw
log_uniform   [a, b]       a (b / a)^u              draw
normal        [mean, std]  mean + std Phi^-1(u)     draw
choice        [v_0, ...]   v_k, k = floor(n u)      draw
seeds         true         z without its sign bit   draw, for damping.seed
============  ===========  =======================  ======================
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
import math
from statistics import NormalDist
from typing import Any

import numpy as np

from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.errors import ParameterError

MOST_POINTS = 100_000
LARGEST = 1e300  # far below overflow
BLOCK = 65_536  # draws processed at once


@dataclass(frozen=True, kw_only=True)
class Distribution:
    """A distribution: its ``kind``, one of `DISTRIBUTIONS`, and its ``arguments``."""

    kind: str
    arguments: tuple[Any, ...]

    @property
    def is_axis(self) -> bool:
        """Whether the distribution is an axis, not a draw."""
        return self.kind in AXES

    def points(self) -> list[Any]:
        """Return the values of an axis."""
        return AXES[self.kind](*self.arguments)

    def draws(self, seed: int, name: str, first: int, count: int) -> list[Any]:
        """Return ``count`` draws of the parameter ``name``, from number ``first`` on."""
        return self._of(words(seed, name, first, count))

    def _of(self, bits: np.ndarray) -> list[Any]:
        if self.kind == 'seeds':
            return (bits >> np.uint64(1)).tolist()
        # the middle of each of 2^53 intervals: never 0, never 1
        share = ((bits >> np.uint64(11)).astype(float) + 0.5) * 2.0**-53
        return DRAWS[self.kind](*self.arguments)(np.minimum(share, ALMOST_ONE).tolist())

    def extremes(self, seed: int, name: str, count: int) -> list[Any]:
        """Return the extreme values; for `choice` and axes, all values."""
        if self.is_axis:
            return self.points()
        if self.kind == 'normal':
            ends = np.array(
                [
                    (part.min(), part.max())
                    for part in (
                        words(seed, name, first, min(BLOCK, count - first))
                        for first in range(0, count, BLOCK)
                    )
                ]
            )
            return self._of(np.array([ends[:, 0].min(), ends[:, 1].max()]))
        return [0] if self.kind == 'seeds' else list(self.arguments)


ALMOST_ONE = math.nextafter(1.0, 0.0)


def words(seed: int, name: str, first: int, count: int) -> np.ndarray:
    """
    Return 64-bit words of the stream of (seed, name), from ``first`` on: shape (count,).

    Philox hashes a counter, four words at a time, so the stream can be entered anywhere.
    """
    entropy = np.random.SeedSequence([seed, int.from_bytes(name.encode(), 'little')])
    stream = np.random.Philox(entropy)
    stream.advance(first // 4)
    return np.asarray(stream.random_raw(first % 4 + count)[first % 4 :])


# math's functions, value by value: numpy's differ in the last bit between machines.
def _grid(a: float, b: float, n: int) -> list[Any]:
    return [a + (b - a) * k / (n - 1) for k in range(n)]


def _log_grid(a: float, b: float, n: int) -> list[Any]:
    rate = (math.log(b) - math.log(a)) / (n - 1)
    return [a, *(a * math.exp(rate * k) for k in range(1, n - 1)), b]


def _uniform(a: float, b: float) -> Callable[[list[float]], list[Any]]:
    return lambda shares: [a + (b - a) * u for u in shares]


def _log_uniform(a: float, b: float) -> Callable[[list[float]], list[Any]]:
    rate = math.log(b) - math.log(a)
    return lambda shares: [min(a * math.exp(rate * u), b) for u in shares]


def _normal(mean: float, std: float) -> Callable[[list[float]], list[Any]]:
    standard = NormalDist()
    return lambda shares: [mean + std * standard.inv_cdf(u) for u in shares]


def _choice(*values: Any) -> Callable[[list[float]], list[Any]]:
    return lambda shares: [values[int(len(values) * u)] for u in shares]


AXES: Mapping[str, Callable[..., list[Any]]] = {
    'values': lambda *values: list(values),
    'grid': _grid,
    'log_grid': _log_grid,
}
DRAWS: Mapping[str, Callable[..., Callable[[list[float]], list[Any]]]] = {
    'uniform': _uniform,
    'log_uniform': _log_uniform,
    'normal': _normal,
    'choice': _choice,
}
DISTRIBUTIONS = (*AXES, *DRAWS, 'seeds')
LISTS = ('values', 'choice')
# distributions that suit the type of a parameter
SUITED = {float: DISTRIBUTIONS[:-1], int: ('grid', *LISTS, 'seeds'), bool: LISTS, str: LISTS}
ALLOWED = {
    'values': 'a list of different values',
    'grid': f'[from, to, steps] with from < to and 2 <= steps <= {MOST_POINTS}',
    'log_grid': f'[from, to, steps] with 0 < from < to and 2 <= steps <= {MOST_POINTS}',
    'uniform': '[from, to] with from < to',
    'log_uniform': '[from, to] with 0 < from < to',
    'normal': '[mean, standard deviation] with a standard deviation > 0',
    'choice': 'a list of values',
    'seeds': 'true',
}


def distribution_of(name: str, given: Any) -> Distribution:
    """
    Return the distribution of the parameter ``name`` from e.g. ``{'uniform': [0.5, 1.5]}``.

    Raises `ParameterError` unless ``given`` is one distribution with valid arguments.
    """
    if not isinstance(given, Mapping) or len(given) != 1:
        raise refusal(name, given, f'one distribution: {", ".join(DISTRIBUTIONS)}')
    kind, arguments = next(iter(given.items()))
    if kind not in DISTRIBUTIONS:
        near = get_close_matches(str(kind), DISTRIBUTIONS, 1)
        raise ParameterError(
            f'{name}: {kind}: there is no such distribution'
            + (f'; is {near[0]} meant?' if near else f'; must be {", ".join(DISTRIBUTIONS)}')
        )
    if kind == 'seeds':
        right = arguments is True
    elif kind in LISTS:
        right = isinstance(arguments, list) and _are_values(kind, arguments)
    else:
        right = isinstance(arguments, list) and _fit(kind, arguments)
    if not right:
        raise refusal(f'{name}: {kind}', arguments, ALLOWED[kind])
    if kind not in (*LISTS, 'seeds'):
        arguments = [*map(float, arguments[:2]), *arguments[2:]]
    return Distribution(kind=kind, arguments=() if kind == 'seeds' else tuple(arguments))


def _are_values(kind: str, values: list[Any]) -> bool:
    plain = all(type(value) in (float, int, bool, str) for value in values)
    return (
        plain
        and 0 < len(values) <= MOST_POINTS
        and (kind == 'choice' or len(set(values)) == len(values))
    )


def _fit(kind: str, numbers: list[Any]) -> bool:
    if len(numbers) != (3 if kind in AXES else 2) or not all(
        type(number) in (float, int) and abs(number) <= LARGEST for number in numbers
    ):
        return False
    if kind == 'normal':
        return bool(numbers[1] > 0)
    steps = numbers[2] if kind in AXES else 2
    return bool(
        numbers[0] < numbers[1]
        and (numbers[0] > 0 or not kind.startswith('log'))
        and type(steps) is int
        and 2 <= steps <= MOST_POINTS
    )
