"""What the checkers judge, a trajectory, and what they find."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.parameter import Parameters
from impulse_control_ros.core.plant import Plant

ROUNDING = 1e-12  # share of the terms of an equation that is no violation of it
NEAR = 1e-3  # share of a time step within which two states are one step apart
LEAST = 1e-15  # the same as a share of the largest value of all samples
Value = float | str
# for all samples, or each from a first sample on, of which one is 0
Plants = Plant | Mapping[int, Plant]
Gains = ControlGains | Mapping[int, ControlGains]
PerSample = Callable[[str], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class LoopSamples:
    """
    Samples of a closed loop; all arrays have shape (n,).

    ``time`` [s] counts from the start of the run, in steps of ``time_step``. The controller saw
    ``position`` [m] and ``velocity`` [m/s], nan where it was not measured, and answered with
    ``effort`` [N], nan where it did not. From each state to the next acted the mean effort
    ``applied`` [N] and the ``damping`` [N s/m], nan where they are not known. ``guard`` and
    ``area`` [N s] are those of the impulse at each sample, 0 without one. ``starts`` tells which
    states do not follow from those before, as after a reset; ``fresh``, where the controller had
    no memory of samples before.
    """

    time: np.ndarray
    time_step: float
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    applied: np.ndarray
    damping: np.ndarray
    guard: np.ndarray
    area: np.ndarray
    starts: np.ndarray
    fresh: np.ndarray

    @cached_property
    def dt(self) -> np.ndarray:
        """The time [s] from each state to the next, without the rounding of ``time``: (n - 1,)."""
        step = np.diff(self.time)
        return np.where(
            np.abs(step - self.time_step) < NEAR * self.time_step, self.time_step, step
        )

    @cached_property
    def breaks(self) -> np.ndarray:
        """Where a state does not follow from the one before, or that one is missing."""
        far = np.abs(self.dt - self.time_step) > 0.5 * self.time_step
        return self.starts | np.append(False, far)


class Violation(NamedTuple):
    """What was recorded at a ``sample``, what was expected there, and the tolerance."""

    sample: int
    value: Value
    expected: Value
    tolerance: float


@dataclass(frozen=True, kw_only=True)
class Check:
    """
    One check of a loop.

    ``checked`` samples, of them ``violations``; ``first`` is the first of these, in ``unit``.
    ``note`` says what was not checked, and why.
    """

    name: str
    unit: str = ''
    checked: int = 0
    violations: int = 0
    first: Violation | None = None
    note: str = ''


@dataclass(frozen=True, kw_only=True)
class Report:
    """The ``checks`` of a trajectory whose samples are at ``time`` [s], shape (n,)."""

    checks: Sequence[Check]
    time: np.ndarray

    @property
    def violated(self) -> list[str]:
        """The names of the checks that are violated; none for a solution of (3) with the law."""
        return [check.name for check in self.checks if check.violations]

    def __str__(self) -> str:
        return '\n'.join(
            line(check, f'{self.time[check.first.sample]:.9g}' if check.first else '')
            for check in self.checks
        )


def line(check: Check, at: str) -> str:
    """Return a check in one line; ``at`` is the time [s] of the first violation."""
    text = f'{check.name:<26}{check.checked:>9} checked{check.violations:>9} violated'
    if check.first:
        first, unit = check.first, f' {check.unit}' if check.unit else ''
        value, expected = map(shown, (first.value, first.expected))
        text += f'  first at {at} s: {value}{unit}, expected {expected}{unit}'
        text += f' +- {first.tolerance:.2g}{unit}' if unit else ''
    return text + (f'  ({check.note})' if check.note else '')


def shown(value: Value) -> str:
    """Return a value for reading."""
    return value if isinstance(value, str) else f'{value:.9g}'


def bounded(
    name: str,
    unit: str,
    value: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    tolerance: np.ndarray,
    samples: np.ndarray | None = None,
    note: str = '',
) -> Check:
    """
    Check that values are within ``bounds`` and a tolerance, shape (k,).

    They are of the first k samples, or of ``samples``. What is nan is not checked, nor what is
    not bounded.
    """
    made = ~np.logical_or.reduce(np.isnan([value, *bounds, tolerance]))
    made &= ~np.logical_and.reduce(np.isinf(bounds))
    tolerance = np.maximum(tolerance, LEAST * np.abs(value[made]).max(initial=0.0))
    nearest = np.clip(value, *bounds)
    wrong = made & ~(np.abs(value - nearest) <= tolerance)
    samples = np.arange(len(value)) if samples is None else samples
    return found(name, unit, made, wrong, (samples, value, nearest, tolerance), note)


def finite(name: str, values: np.ndarray, samples: np.ndarray | None = None) -> Check:
    """Check that the values of all, or of some, ``samples`` are finite, shape (k,)."""
    count = len(values)
    samples = np.arange(count) if samples is None else samples
    expected, tolerance = np.full(count, 'finite'), np.zeros(count)
    return found(
        name,
        '',
        np.ones(count, bool),
        ~np.isfinite(values),
        (samples, values, expected, tolerance),
        '',
    )


def found(
    name: str,
    unit: str,
    made: np.ndarray,
    wrong: np.ndarray,
    columns: Sequence[np.ndarray],
    note: str,
) -> Check:
    """Return the check that was ``made`` of some samples; ``columns`` are those of `Violation`."""
    first = np.flatnonzero(wrong)[:1]
    return Check(
        name=name,
        unit=unit,
        checked=int(made.sum()),
        violations=int(wrong.sum()),
        first=Violation(*(column[first].item() for column in columns)) if len(first) else None,
        note=note,
    )


def per_sample(parameters: Parameters | Mapping[int, Parameters], count: int) -> PerSample:
    """
    Return a function from a parameter's name to its value at each of ``count`` samples.

    ``parameters`` hold for all samples, or each from a first sample on, of which one is 0.
    """
    sets = parameters if isinstance(parameters, Mapping) else {0: parameters}
    lengths = np.diff([*sets, count])

    def of(name: str) -> np.ndarray:
        values: list[Any] = [attrgetter(name)(one) for one in sets.values()]
        return np.repeat(np.array(values), lengths)

    return of
