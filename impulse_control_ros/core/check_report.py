"""Input and results of the checks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.parameter import Parameters
from impulse_control_ros.core.plant import Plant

ROUNDING = 1e-12  # tolerance relative to the terms of an equation
NEAR = 1e-3  # tolerance of a time step, relative to it
LEAST = 1e-15  # tolerance relative to the largest value of all samples
Value = float | str
# one parameter set for all samples, or sets by their first sample, beginning with 0
Plants = Plant | Mapping[int, Plant]
Gains = ControlGains | Mapping[int, ControlGains]
PerSample = Callable[[str], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class LoopSamples:
    """
    Samples of a closed loop; all arrays have shape (n,).

    ``time`` [s] counts from the start of the run, in steps of ``time_step``. The controller saw
    ``position`` [m] and ``velocity`` [m/s] (nan if not measured) and answered with ``effort`` [N]
    (nan if unanswered). The mean effort ``applied`` [N] and the ``damping`` [N s/m] (nan if
    unknown) acted from each state to the next. ``guard`` and ``area`` [N s] describe the impulse
    at each sample, 0 if none. ``starts`` is true where a state does not follow from the previous
    one, as after a reset; ``fresh`` is true where the controller had no memory of previous
    samples.
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
        """Where a state does not follow from the previous one, or the previous one is missing."""
        far = np.abs(self.dt - self.time_step) > 0.5 * self.time_step
        return self.starts | np.append(False, far)


class Violation(NamedTuple):
    """The recorded ``value`` at a ``sample``, the ``expected`` one, and the ``tolerance``."""

    sample: int
    value: Value
    expected: Value
    tolerance: float


@dataclass(frozen=True, kw_only=True)
class Check:
    """
    One check of a loop.

    ``checked`` counts the checked samples, ``violations`` the violations among them; ``first`` is
    the first violation, in ``unit``. ``note`` says what was not checked, and why.
    """

    name: str
    unit: str = ''
    checked: int = 0
    violations: int = 0
    first: Violation | None = None
    note: str = ''


@dataclass(frozen=True, kw_only=True)
class Report:
    """The ``checks`` of a trajectory sampled at ``time`` [s], shape (n,)."""

    checks: Sequence[Check]
    time: np.ndarray

    @property
    def violated(self) -> list[str]:
        """The names of the violated checks; empty for a solution of (3) under the law."""
        return [check.name for check in self.checks if check.violations]

    def __str__(self) -> str:
        return '\n'.join(
            line(check, f'{self.time[check.first.sample]:.9g}' if check.first else '')
            for check in self.checks
        )


def line(check: Check, at: str) -> str:
    """Format a check as one line; ``at`` is the time [s] of the first violation."""
    text = f'{check.name:<26}{check.checked:>9} checked{check.violations:>9} violated'
    if check.first:
        first, unit = check.first, f' {check.unit}' if check.unit else ''
        value, expected = map(shown, (first.value, first.expected))
        text += f'  first at {at} s: {value}{unit}, expected {expected}{unit}'
        text += f' +- {first.tolerance:.2g}{unit}' if unit else ''
    return text + (f'  ({check.note})' if check.note else '')


def shown(value: Value) -> str:
    """Format a value."""
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
    Check that values lie within ``bounds``, up to a tolerance; all have shape (k,).

    The values belong to the first k samples, or to ``samples``. Values that are nan or have no
    bounds are not checked.
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
    """Return the check ``made`` at some samples; ``columns`` are the fields of `Violation`."""
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

    ``parameters`` is one set for all samples, or maps the first sample of each set, beginning with
    0, to the set.
    """
    sets = parameters if isinstance(parameters, Mapping) else {0: parameters}
    lengths = np.diff([*sets, count])

    def of(name: str) -> np.ndarray:
        values: list[Any] = [attrgetter(name)(one) for one in sets.values()]
        return np.repeat(np.array(values), lengths)

    return of
