"""
A study: many runs of one experiment, each with its own parameters.

==========  ==========  ====  ===============================================================
symbol      name        unit  meaning
==========  ==========  ====  ===============================================================
p           point       1     a combination of the axes' values, the last axis fastest
r           repeat      1     number of a run at its point: draw r of each drawn parameter
i           row         1     i = p runs + r
c           chunk       1     rows that are computed, and saved, at once
==========  ==========  ====  ===============================================================

All points use the same draws, so two points differ only in their axes. The parameters and figures
of row i depend only on (study, i), not on chunks, threads or machines.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any

import numpy as np

from impulse_control_ros.core.batch import figures_of, require_tolerances
from impulse_control_ros.core.batch_lanes import LANES
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.distributions import Distribution, SUITED
from impulse_control_ros.core.metric_catalogue import METRICS, settling, sweep_metrics, TOLERANCES
from impulse_control_ros.core.metrics import COUNTS
from impulse_control_ros.core.parameter import (
    build,
    converted,
    parameter,
    Parameters,
    refusal,
    rules,
)
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import steps_of
from impulse_control_ros.core.varied import columns, found, packed_rows
from impulse_control_ros.errors import ParameterError

CHUNK_STEPS = 25_000_000  # steps of all runs of a chunk: a tenth of a second on one core
MOST_ROWS = 16_384  # of a chunk, to limit its memory
CHUNKS = 32  # at least, if there are as many blocks, to occupy many cores
MOST_RUNS = MOST_STEPS = 10**9


@dataclass(frozen=True, kw_only=True)
class Extent(Parameters):
    """How long, how often and from which seed a study runs."""

    duration: float = parameter(1.0, 's', 'simulated time of a run', lower=0.0, open_lower=True)
    seed: int = parameter(1, '', 'seed of all draws', lower=0)
    runs: int = parameter(1, '', 'runs at each point of the axes', lower=1, upper=10**9)


@dataclass(frozen=True, kw_only=True)
class SweepConfig:
    """
    A study of ``axis`` and ``controller``, validated at construction for all of its runs.

    ``vary`` maps the full name of each varied parameter, as in `simulate_batch`, to its
    distribution; settling times are to ``tolerances`` [m].
    """

    axis: Plant
    controller: ControlGains
    extent: Extent
    vary: Mapping[str, Distribution]
    tolerances: tuple[float, ...] = TOLERANCES

    def __post_init__(self) -> None:
        if not self.vary:
            raise refusal('vary', dict(self.vary), 'at least one parameter with its distribution')
        require_tolerances(self.tolerances)
        self._require_laws()
        if self.extent.runs > 1 and all(
            distribution.is_axis for distribution in self.vary.values()
        ):
            raise refusal('runs', self.extent.runs, '1 where no parameter is drawn')
        if self.rows > MOST_RUNS:
            raise refusal('runs', self.rows, f'<= {MOST_RUNS} at all points together')
        _require_bounds({name: self._values(name) for name in self.vary}, self.axis)
        if self.steps > MOST_STEPS:
            raise refusal(
                'duration',
                self.extent.duration,
                f'<= {MOST_STEPS:g} steps of {self.axis.time_step:g} s',
            )

    def _require_laws(self) -> None:
        """Refuse unknown and repeated parameters, and distributions of the wrong type."""
        known = [full_name(name) for name in self.vary]
        for (name, distribution), full in zip(self.vary.items(), known, strict=True):
            suited = SUITED[type(found(name)[2])]
            if distribution.kind not in suited:
                raise ParameterError(f'{name}: {distribution.kind}: must be ' + ', '.join(suited))
            if known.count(full) > 1:
                raise ParameterError(f'{name}: {full} is varied twice')

    def _values(self, name: str) -> list[Any]:
        """Return the extreme values of a parameter, with its type."""
        values = self.vary[name].extremes(self.extent.seed, full_name(name), self.extent.runs)
        return [typed(name, value) for value in values]

    @cached_property
    def axes(self) -> dict[str, list[Any]]:
        """Return the values of each axis."""
        return {
            name: self._values(name)
            for name, distribution in self.vary.items()
            if distribution.is_axis
        }

    @cached_property
    def rows(self) -> int:
        """Return the total number of runs at all points."""
        return self.extent.runs * math.prod(
            len(self.vary[name].points()) for name in self.vary if self.vary[name].is_axis
        )

    @cached_property
    def steps(self) -> int:
        """Return the number of steps of a run."""
        return steps_of(self.axis, self.controller, self.extent.duration)

    @cached_property
    def chunk(self) -> int:
        """Return the number of rows of a chunk, a multiple of LANES."""
        wanted = min(CHUNK_STEPS // self.steps, MOST_ROWS, self.rows // CHUNKS)
        return max(wanted // LANES, 1) * LANES

    @cached_property
    def chunks(self) -> int:
        """Return the number of chunks."""
        return -(-self.rows // self.chunk)

    def rows_of(self, number: int) -> range:
        """Return the rows of a chunk."""
        return range(number * self.chunk, min((number + 1) * self.chunk, self.rows))


def full_name(name: str) -> str:
    """Return e.g. ``plant_simulator.F_c`` for ``F_c``."""
    return '.'.join(found(name)[:2])


def typed(name: str, value: Any) -> Any:
    """Return a value of a varied parameter with its type; refuse an invalid value."""
    _, _, default, spec = found(name)
    if type(default) is int and type(value) is float and value.is_integer():
        value = int(value)  # a grid of whole numbers
    return converted(name, value, default, spec)


def _require_bounds(values: Mapping[str, list[Any]], plant: Plant) -> None:
    """Refuse values of the plant that break a rule in some row."""
    hardest = {
        prefix + name: extreme
        for prefix, rule in rules(type(plant))
        for name, extreme in rule.hardest.items()
    }
    tightest = {
        inner: hardest[inner](given)
        for name, given in values.items()
        for side, inner, *_ in [found(name)]
        if side == 'plant_simulator' and inner in hardest
    }
    build(type(plant), plant.flat() | tightest)


def varied(study: SweepConfig, rows: range) -> dict[str, np.ndarray]:
    """Return the varied parameters of ``rows``: arrays of shape (rows,) by name."""
    index = np.arange(rows.start, rows.stop)
    repeat, point = index % study.extent.runs, index // study.extent.runs
    places = np.unravel_index(point, [len(values) for values in study.axes.values()] or [1])
    result = {}
    for name, distribution in study.vary.items():
        if distribution.is_axis:
            place = places[list(study.axes).index(name)]
            result[name] = np.asarray(study.axes[name])[place]
        else:
            result[name] = drawn(study, name, repeat)
    return result


def drawn(study: SweepConfig, name: str, repeat: np.ndarray) -> np.ndarray:
    """Return the draws of a parameter with the numbers ``repeat``, computing few others."""
    distribution, kind = study.vary[name], type(found(name)[2])
    all_points = study.extent.runs <= len(repeat)
    stretches = [(0, study.extent.runs)] if all_points else pieces(repeat)
    values = np.asarray(
        [
            kind(value)
            for stretch in stretches
            for value in distribution.draws(study.extent.seed, full_name(name), *stretch)
        ]
    )
    return values[repeat] if all_points else values


def pieces(repeat: np.ndarray) -> list[tuple[int, int]]:
    """Return (first, count) of each stretch of consecutive repeats."""
    starts = np.flatnonzero(np.diff(repeat, prepend=-2) != 1)
    return [
        (int(repeat[start]), int(end - start))
        for start, end in zip(starts, [*starts[1:], len(repeat)], strict=True)
    ]


def run_chunk(study: SweepConfig, number: int) -> dict[str, np.ndarray]:
    """Run a chunk of a study; return its varied parameters and metrics by the names of `units`."""
    rows = study.rows_of(number)
    parameters = varied(study, rows)
    figures = figures_of(
        packed_rows(study.axis, study.controller, *columns(parameters), len(rows)),
        study.steps,
        np.asarray(study.tolerances),
    )
    result = {column_of(name): values for name, values in parameters.items()}
    for place, tolerance in enumerate(study.tolerances):
        result[settling(tolerance)] = figures['settling_time'][:, place]
    result['impulses'] = np.sum([figures[guard] for guard in COUNTS], axis=0)
    return {name: result[name] if name in result else figures[name] for name in units(study)}


def column_of(name: str) -> str:
    """Return the column of a varied parameter: its full name if a metric has the same name."""
    return full_name(name) if name in METRICS else name


def units(study: SweepConfig) -> dict[str, str]:
    """Return the unit of each column, in order: varied parameters, then metrics."""
    result = {column_of(name): found(name)[3].unit for name in study.vary}
    return result | {name: item.unit for name, item in sweep_metrics(study.tolerances).items()}


def described(study: SweepConfig) -> dict[str, Any]:
    """Return the plain values, by name, on which the figures of a study depend."""
    result = {'rows': study.rows, 'tolerances': list(study.tolerances), **study.extent.flat()}
    result |= {
        f'vary: {name}': {distribution.kind: list(distribution.arguments)}
        for name, distribution in study.vary.items()
    }
    for side, values in (
        ('plant_simulator', Plant.flat(study.axis)),
        ('controller', ControlGains.flat(study.controller)),
    ):
        result |= {f'{side}.{name}': value for name, value in values.items()}
    return result
