"""
Metrics of a recorded or simulated run.

The functions take arrays of one run on the sampling grid: ``time`` [s] and ``error`` e = x - x_r
[m]. `figures` and batches compute the figures of merit together, from running sums.
`metric_catalogue` has the title, unit and meaning of each metric.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.control_law import POSITION_ZERO, STICKING, VELOCITY_ZERO
from impulse_control_ros.core.jit import compiled, sign

ROUNDING = 1e-9  # tolerance relative to an effort or to 1 N


class Sums(NamedTuple):
    """Running sums and maxima of a run."""

    overshoot: float
    iae: float
    ise: float
    position_zero: float
    velocity_zero: float
    sticking: float
    impulse_area: float
    peak_effort: float
    peak_velocity: float


COUNTS = ('position_zero', 'velocity_zero', 'sticking')
NOTHING = Sums(*[0.0] * len(Sums._fields))  # before the first sample
SUMS = np.dtype([(name, 'f8') for name in Sums._fields])


def figures_dtype(tolerances: int) -> np.dtype[np.void]:
    """Return the dtype of a run's figures; ``tolerances`` is the number of settling times."""
    return np.dtype(
        [
            ('settling_time', 'f8', (tolerances,)),
            *((name, 'i8' if name in COUNTS else 'f8') for name in Sums._fields),
            ('final_error', 'f8'),
            ('diverged', '?'),
        ]
    )


def settling_time(time: np.ndarray, error: np.ndarray, tolerance: float) -> float:
    """Return the first time [s] after which abs(e) stays within ``tolerance`` [m], or nan."""
    outside = np.flatnonzero(~(np.abs(error) <= tolerance))  # nan is outside
    if outside.size == 0:
        return float(time[0])
    if outside[-1] + 1 == len(time):
        return float('nan')
    return float(time[outside[-1] + 1])


def overshoot(error: np.ndarray) -> float:
    """Return how far [m] the error goes to the side opposite of where it starts, at most."""
    return float(np.maximum(0.0, np.max(-np.sign(error[0]) * error)))


def peak(values: np.ndarray) -> float:
    """Return the largest absolute value."""
    return float(np.max(np.abs(values)))


def first_position_zero(error: np.ndarray) -> int | None:
    """Return the index of the first sample at or past e = 0, or None."""
    past = np.flatnonzero(np.sign(error) != np.sign(error[0]))
    return int(past[0]) if past.size else None


def integral(time: np.ndarray, values: np.ndarray) -> float:
    """Return the integral over ``time`` [s], by the trapezoidal rule."""
    return float(np.dot(np.diff(time), values[1:] + values[:-1]) / 2.0)


def work(position: np.ndarray, effort: np.ndarray) -> float:
    """Return the work [N m] of an ``effort`` [N] that each sample holds until the next one."""
    return float(np.dot(effort[:-1], np.diff(position)))


def stuck(time: np.ndarray, velocity: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """
    Return number and total time [s] of the intervals in which the axis rests off its set-point.

    An interval is two samples in a row, or more, of velocity 0 with an error. Both are nan where
    a velocity is.
    """
    if np.isnan(velocity).any():
        return float('nan'), float('nan')
    stands = (velocity == 0.0) & (error != 0.0)
    between = stands[:-1] & stands[1:]
    begins = int(np.count_nonzero(between[1:] & ~between[:-1])) + int(between[:1].any())
    return begins, float(np.diff(time)[between].sum())


def differs(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Tell where efforts [N] differ from a reference by more than rounding, as nan does, (n,)."""
    return ~(np.abs(values - reference) <= ROUNDING * np.maximum(1.0, np.abs(values)))


def impulsive(effort: np.ndarray, feedback: np.ndarray, fired: np.ndarray) -> np.ndarray:
    """
    Return the impulsive part [N] of the ``effort`` [N]; all arrays have shape (n,).

    An impulse acts from the sample that ``fired`` it (bool) until the effort equals the
    ``feedback`` [N] again. Other differences from the feedback are not impulses.
    """
    place, apart = np.arange(len(effort)), differs(effort, feedback)
    last_fired = np.maximum.accumulate(np.where(fired, place, -1))
    last_alike = np.maximum.accumulate(np.where(apart, -1, place))
    return np.where(apart & (last_fired > last_alike), effort - feedback, 0.0)


@compiled
def added(sums, side, error, velocity, effort, area, guard):
    """Return the sums with one more sample; ``side`` is the sign of the first error."""
    return Sums(
        max(sums.overshoot, -side * error),
        sums.iae + abs(error),
        sums.ise + error * error,
        sums.position_zero + (1.0 if guard == POSITION_ZERO else 0.0),
        sums.velocity_zero + (1.0 if guard == VELOCITY_ZERO else 0.0),
        sums.sticking + (1.0 if guard == STICKING else 0.0),
        sums.impulse_area + abs(area),
        max(sums.peak_effort, abs(effort)),
        max(sums.peak_velocity, abs(velocity)),
    )


@compiled
def outside_since(last, tick, error, tolerance):
    """Return the last tick at which abs(e) was not within ``tolerance``; nan is outside."""
    return last if abs(error) <= tolerance else tick


@compiled
def add_up(error, velocity, effort, areas, guards, tolerances):
    """Return the sums over a run, and for each tolerance the last tick outside, or -1."""
    sums = NOTHING
    outside = np.full(len(tolerances), -1.0)
    for k in range(len(error)):
        sums = added(sums, sign(error[0]), error[k], velocity[k], effort[k], areas[k], guards[k])
        for i in range(len(tolerances)):
            outside[i] = outside_since(outside[i], float(k), error[k], tolerances[i])
    return sums, outside


def conclude(
    sums: Mapping[str, np.ndarray],
    outside: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    steps: int,
    time_step: float,
) -> np.ndarray:
    """
    Return the figures of n runs of ``steps`` steps from their sums: shape (n,).

    ``first`` and ``last`` [m] are the errors at both ends, shape (n,) like each of the sums;
    ``outside``, shape (n, tolerances), is the last tick outside each tolerance, or -1.
    """
    result = np.zeros(outside.shape[0], figures_dtype(outside.shape[1]))
    settled = outside + 1.0
    result['settling_time'] = np.where(settled <= steps, settled * time_step, np.nan)
    for name in Sums._fields:
        result[name] = sums[name]
    ends = 0.5 * (np.abs(first) + np.abs(last)), 0.5 * (first * first + last * last)
    result['iae'] = (sums['iae'] - ends[0]) * time_step
    result['ise'] = (sums['ise'] - ends[1]) * time_step
    result['final_error'] = last
    return result


def figures(
    time: np.ndarray,
    error: np.ndarray,
    velocity: np.ndarray,
    effort: np.ndarray,
    events: np.ndarray,
    tolerances: Sequence[float],
) -> np.ndarray:
    """
    Return all figures of merit of a run: shape (1,), dtype `figures_dtype`.

    ``time`` [s] from 0, ``error`` [m], ``velocity`` [m/s] and ``effort`` [N] have shape (n,).
    ``events`` has the fields tick, guard and area. The settling times are to ``tolerances`` [m].
    """
    areas, guards = np.zeros(len(time)), np.zeros(len(time), np.int64)
    areas[events['tick']], guards[events['tick']] = events['area'], events['guard']
    sums, outside = add_up(error, velocity, effort, areas, guards, np.array(tolerances, float))
    return conclude(
        {name: np.array([value]) for name, value in sums._asdict().items()},
        outside[np.newaxis],
        error[:1],
        error[-1:],
        len(time) - 1,
        float(time[1]),
    )
