"""
Verdicts on estimates: 'identified', or 'not excited: ' and why; warnings; and what to do.

A parameter is refused, in this order, if

* the axis moves too little, or in one direction only, where F_c and offset are one force;
* the scaled regressors have a condition number above 30 and its own is not independent of them;
* its own share of the effort is below the residual: what the model leaves unexplained could be
  taken for it, whatever its standard error;
* its standard error is above 10 % of its value. Then its interval still holds.

A force known to 1 % of the rms effort is identified also where it is zero. Where d(t) varies, that
is most of the residual. It says nothing against d then, which its blocks show, and the intervals
of the forces hold.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from impulse_control_ros.core.axis_model import ATTENUATION, AxisModel
from impulse_control_ros.core.identification import (
    DampingBlocks,
    Estimate,
    IDENTIFIED,
    SYMMETRIC,
    UNITS,
    WindowSweep,
)
from impulse_control_ros.core.weak_form import Fit, student

LARGEST_ERROR = 0.1  # of a value
LARGEST_CONDITION = 30.0
FAR_ABOVE = 10.0  # times the residual: a dependent regressor does not matter
INDEPENDENT = 0.1  # of a scaled regressor
SMALL_FORCE = 0.01  # of the rms effort
LEAST_PARTS = 20  # of the motion
LEAST_BLOCKS = 0.3  # s of motion in blocks of d
REFUSED = 'not excited: '
NO_MOTION = f'{REFUSED}the axis moves too little'
ONE_DIRECTION = {
    'd': f'{REFUSED}one direction of motion only, the damping of the other is not seen',
    **dict.fromkeys(
        ('F_c', 'offset'),
        f'{REFUSED}one direction of motion only, F_c and offset cannot be told apart',
    ),
}
NOT_A_NUMBER = math.nan, math.nan


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What warnings and advice are about, by the names of `Identification`."""

    model: AxisModel
    window: float
    parameters: Mapping[str, Estimate]
    blocks: DampingBlocks
    bound_verdict: str
    sweep: WindowSweep
    asymmetry_z: float
    late: float
    late_error: float


def estimates_of(
    model: AxisModel,
    window: float,
    blocks: DampingBlocks,
    found: Fit | None = None,
    names: Sequence[str] = SYMMETRIC,
) -> dict[str, Estimate]:
    """Return the estimates of a fit by name; by default those of the symmetric model."""
    symmetric = found is None
    found = model.fit(window) if symmetric else found
    if found is None:
        return {name: unfitted(name, NO_MOTION) for name in names}
    place = model.place(window) if symmetric else range(len(names))
    one_way = model.has_offset and model.is_one_way(window)
    windows = model.windows(window)
    effort = float(np.sqrt(np.mean((windows.effort(model.held) / windows.offset) ** 2)))
    estimates = {}
    for name in names:
        column = list(place).index(names.index(name)) if names.index(name) in place else None
        if one_way and name in ONE_DIRECTION:
            estimates[name] = unfitted(name, ONE_DIRECTION[name])
        elif column is None:  # an axis without offset
            estimates[name] = unfitted(name, IDENTIFIED, value=0.0)
        else:
            estimates[name] = _estimate(
                found,
                column,
                name,
                effort,
                shown=name.startswith('d') and shown_time(blocks) >= LEAST_BLOCKS,
                varies=name != 'm' and model.varies(window),
            )
    return estimates


def unfitted(name: str, verdict: str, value: float = math.nan) -> Estimate:
    """Return an estimate of what is not in the fit: refused, or known beforehand."""
    return Estimate(
        name=name,
        value=value,
        unit=UNITS[name],
        standard_error=0.0 * value,
        interval=(value, value),
        share=0.0 * value,
        verdict=verdict,
    )


def _estimate(
    found: Fit, column: int, name: str, effort: float, shown: bool, varies: bool
) -> Estimate:
    value, error = float(found.values[column]), float(found.errors[column])
    half = student(0.975, found.count - 1) * error
    is_known = UNITS[name] == 'N' and half < SMALL_FORCE * effort
    why, holds = _reason(found, column, is_known, shown, varies)
    return Estimate(
        name=name,
        value=math.nan if why else value,
        unit=UNITS[name],
        standard_error=error,
        interval=(value - half, value + half) if holds else NOT_A_NUMBER,
        share=float(found.share[column]),
        verdict=REFUSED + why if why else IDENTIFIED,
    )


def _reason(
    found: Fit, column: int, is_known: bool, shown: bool, varies: bool
) -> tuple[str, bool]:
    """Return why a parameter is refused, or '', and whether its interval holds."""
    value, error = abs(float(found.values[column])), float(found.errors[column])
    share = float(found.share[column])
    if is_known and share < SMALL_FORCE:
        return '', True
    dependent = found.condition > LARGEST_CONDITION and found.independence[column] < INDEPENDENT
    if dependent and share < FAR_ABOVE * found.residual:
        return (
            f'its part of the motion depends on the others (condition number '
            f'{found.condition:.3g}, at most {LARGEST_CONDITION:g})',
            False,
        )
    if share < found.residual and not shown:
        return (
            f'its share of the effort, {share:.1%}, is below what the model leaves over, '
            f'{found.residual:.1%}',
            varies,
        )
    if error > LARGEST_ERROR * value and not is_known:
        return f'its standard error is {error / value:.0%} of its value, at most 10 %', True
    return '', True


def bound_verdict(
    model: AxisModel, window: float, parameters: Mapping[str, Estimate], blocks: DampingBlocks
) -> str:
    """Return 'identified' for d_bar, or why it is refused."""
    if model.fit(window) is None:
        return NO_MOTION
    if model.has_offset and model.is_one_way(window):
        return ONE_DIRECTION['d']
    if not parameters['m'].is_identified:
        return f'{REFUSED}m is not identified'
    if shown_time(blocks) < LEAST_BLOCKS:
        return (
            f'{REFUSED}only {shown_time(blocks):.2g} s of the motion show d to 15 %, at least '
            f'{LEAST_BLOCKS:g} s'
        )
    return IDENTIFIED


def shown_time(blocks: DampingBlocks) -> float:
    """Return the time [s] over which the blocks show d."""
    return len(blocks.d) * blocks.duration


def warnings_on(facts: Facts) -> Iterator[str]:
    """Yield sentences on what the records or the model lack."""
    model, window = facts.model, facts.window
    yield from _on_records(model)
    found = model.fit(window)
    if found is None:
        return
    if model.is_one_way(window):
        yield 'the motion has one direction only: friction and damping of the other are not seen'
    if found.count < LEAST_PARTS:
        yield f'the motion is short: the errors rest on {found.count} parts of it'
    weak = model.attenuation(window)
    if weak > ATTENUATION:
        yield (
            f'the position is coarse: noise and encoder step are {weak:.1%} of what m acts on, '
            f'even over {1e3 * window:.0f} ms'
        )
    for name, drift in facts.sweep.drift.items():
        if drift > 2.0 and facts.parameters[name].is_identified:
            yield (
                f'{name} moves by {drift:.1f} standard errors from windows of '
                f'{1e3 * window:.0f} ms to {4e3 * window:.0f} ms: the model is not the axis, '
                f'and the error of {name} is larger than its interval'
            )
    if abs(facts.asymmetry_z) > 3.0:
        yield (
            f'the damping depends on the direction (z = {facts.asymmetry_z:.0f}): d is a mean of '
            'd_plus and d_minus'
        )
    yield from _on_delay(facts)
    if facts.bound_verdict == IDENTIFIED:
        yield (
            'd_bar bounds the recorded motion alone: take 1.1 to 1.2 times it, or record the axis '
            'cold, warm and over its whole travel'
        )


def _on_records(model: AxisModel) -> Iterator[str]:
    pieces = model.pieces
    for index in sorted({piece.index for piece in pieces}):
        own = [piece for piece in pieces if piece.index == index]
        uneven = max(piece.jitter for piece in own)
        if uneven > 0.0:
            yield (
                f'{own[0].name}: its times are up to {1e3 * uneven:.2g} ms off a step of '
                f'{1e3 * own[0].time_step:.4g} ms, so it was resampled'
            )
        if len(own) > 1:
            yield f'{own[0].name}: gaps in its times divide it into {len(own)} pieces'


def _on_delay(facts: Facts) -> Iterator[str]:
    step = max(piece.time_step for piece in facts.model.pieces)
    if not math.isfinite(facts.late_error):
        yield (
            'the motion does not show whether the effort acts late, as in a pure PD loop: a delay '
            'of tau would be K tau of d'
        )
    elif abs(facts.late) > max(0.75 * step, 3.0 * facts.late_error):
        when = 'later' if facts.late > 0.0 else 'earlier'
        yield (
            f'the effort acts {1e3 * abs(facts.late):.2g} ms {when} than its times say: d and m '
            'are off by that'
        )


def advice_for(facts: Facts) -> Iterator[str]:
    """Yield which excitation would identify what is refused."""
    model, window, parameters = facts.model, facts.window, facts.parameters
    if model.fit(window) is None:
        yield 'move the axis, for 5 to 10 s, in both directions and at three speeds or more'
        return
    if model.has_offset and model.is_one_way(window):
        yield 'move in both directions'
    if not parameters['m'].is_identified:
        yield 'accelerate strongly: steps of the set-point with a high K, impulses off'
    if not all(parameters[name].is_identified for name in ('d', 'F_c')):
        yield 'move at three speeds or more in both directions, for 5 to 10 s'
    if facts.bound_verdict != IDENTIFIED and shown_time(facts.blocks) < LEAST_BLOCKS:
        yield 'move faster and for longer: only motion shows d'
