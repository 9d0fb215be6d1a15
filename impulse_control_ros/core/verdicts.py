"""
Verdicts on estimates: 'identified', or 'not excited: ' and why; warnings; and what to do.

A parameter is refused, in this order, if

* the axis moves too little, or in one direction only, where F_c and offset are one force;
* the scaled regressors have a condition number above 30 and its own is not independent of them;
* its own share of the effort is below the residual: what the model leaves unexplained could be
  taken for it, whatever its standard error;
* its standard error is above 10 % of its value. Then its interval still holds;
* it is m, d or F_c, and negative: the model is not the axis.

A force known to 1 % of the rms effort is identified also where it is zero. Where d(t) varies, that
is most of the residual. It says nothing against d then, which its blocks show, and the intervals
of the forces hold.
"""

from collections.abc import Mapping, Sequence
import math

import numpy as np

from impulse_control_ros.core.axis_model import AxisModel
from impulse_control_ros.core.identification import (
    DampingBlocks,
    Estimate,
    IDENTIFIED,
    SYMMETRIC,
    UNITS,
)
from impulse_control_ros.core.regression import Fit, student

LARGEST_ERROR = 0.1  # of a value
LARGEST_CONDITION = 30.0
FAR_ABOVE = 10.0  # times the residual: a dependent regressor does not matter
INDEPENDENT = 0.1  # of a scaled regressor
SMALL_FORCE = 0.01  # of the rms effort
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
    why, holds = _reason(found, column, name, is_known, shown, varies)
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
    found: Fit, column: int, name: str, is_known: bool, shown: bool, varies: bool
) -> tuple[str, bool]:
    """Return why a parameter is refused, or '', and whether its interval holds."""
    value, error = float(found.values[column]), float(found.errors[column])
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
    if error > LARGEST_ERROR * abs(value) and not is_known:
        return f'its standard error is {error / abs(value):.0%} of its value, at most 10 %', True
    if value < 0.0 and name != 'offset' and not is_known:
        return (
            f'its value is negative, {value:.3g} {UNITS[name]}: the model is not the axis',
            False,
        )
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
            f'{REFUSED}only {shown_time(blocks):.2g} s of the motion determine d to 15 %; '
            f'at least {LEAST_BLOCKS:g} s are needed'
        )
    return IDENTIFIED


def shown_time(blocks: DampingBlocks) -> float:
    """Return the time [s] over which the blocks show d."""
    return len(blocks.d) * blocks.duration
