"""
Identify an axis from records of its motion: m, d, F_c, offset and d_bar, with their errors.

1. Records become pieces of uniform samples (core/axis_record.py).
2. The window of the weak form and how the effort acts follow from the data (core/axis_model.py).
3. A fit over all pieces (core/weak_form.py, core/regression.py) gives the estimates, which get
   their verdicts (core/verdicts.py). Fits over T to 4 T, of the asymmetric model and with a delay
   test the model.
4. The damping by blocks gives d_bar (core/damping_profile.py).

The method and its measured errors are in docs/concepts/identification.md.
"""

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from impulse_control_ros.core.axis_model import AxisModel
from impulse_control_ros.core.axis_record import AFTER, LEAST_SAMPLES, record_of, samples_of
from impulse_control_ros.core.damping_profile import bound_of, damping_blocks
from impulse_control_ros.core.identification import (
    ASYMMETRIC,
    DampingBlocks,
    Estimate,
    FrictionCurve,
    Identification,
    IDENTIFIED,
    SYMMETRIC,
    WindowSweep,
)
from impulse_control_ros.core.identify_warnings import advice_for, Facts, warnings_on
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.verdicts import bound_verdict, estimates_of
from impulse_control_ros.core.weak_form import HOLDS, windows_of

BLOCK = 0.03  # s, of d(t)
LEAST_DRIFT = 0.005  # of a value: a smaller drift does not matter
SWEEP = 5  # windows from T to 4 T
NONE = np.zeros(0)
NO_BLOCKS = DampingBlocks(
    duration=BLOCK, record=NONE.astype(int), time=NONE, d=NONE, standard_error=NONE
)


def identify(
    records: Any | Sequence[Any],
    *,
    effort_scale: float = 1.0,
    effort_held: str | None = None,
    window: float | None = None,
    has_offset: bool = True,
) -> Identification:
    """
    Identify the axis of one record, or of a list of records of the same axis.

    A record is a `Record`, a `Run`, a `Recording`, or a frame or mapping with the columns (or
    index) time [s], position [m], effort [N] and, where it is measured, velocity [m/s].

    ``effort_scale`` multiplies the effort. ``effort_held`` says how an effort acts: over the
    sample ``after`` its time or ``before`` it, or ``sampled`` of a signal that changes between
    samples. By default it is ``after`` for the commands of a `Run` or `Recording`; else what the
    timing of the motion shows, and ``after`` where that shows nothing. ``window`` [s] is T; by
    default the data choose it. ``has_offset`` = False is for an axis that is known to have no
    constant force; then one direction of motion gives F_c.

    Raises `ParameterError` for an argument or a record that cannot be used: fewer than 50 samples,
    times that do not increase, values that are not finite, a missing column.
    """
    if effort_held is not None and effort_held not in HOLDS:
        raise refusal('effort_held', effort_held, f'one of {", ".join(HOLDS)}')
    if not (math.isfinite(effort_scale) and effort_scale != 0.0):
        raise refusal('effort_scale', effort_scale, 'finite and not 0')
    if window is not None and not 0.0 < window < math.inf:
        raise refusal('window', window, '> 0 and finite [s]')
    listed = list(records) if isinstance(records, (list, tuple)) else [records]
    known = [record_of(one, f'record {number}') for number, one in enumerate(listed, 1)]
    pieces = [
        piece
        for index, record in enumerate(known)
        for piece in samples_of(record, index, effort_scale)
    ]
    if not pieces:
        raise refusal('records', len(known), f'of {LEAST_SAMPLES} samples or more without a gap')
    holds = {one.effort_held for one in known}
    effort_held = effort_held or (holds.pop() if len(holds) == 1 else None)
    model = AxisModel(pieces, effort_held or AFTER, has_offset)
    chosen = window or model.best_window()
    timing = model.timing_window(chosen)
    if effort_held is None:
        model.held = model.shown_hold(timing)
        chosen = window or model.best_window()
    return _identified(model, chosen, timing)


def _identified(model: AxisModel, window: float, timing: float) -> Identification:
    """Return the result at the window T [s], with the delay at the window ``timing`` [s]."""
    found = model.fit(window)
    blocks = NO_BLOCKS if found is None else _blocks(model, window)
    parameters = estimates_of(model, window, blocks)
    asymmetric, z = _by_direction(model, window, blocks)
    late, late_error = model.delay(timing)
    sweep = _sweep(model, window)
    verdict = bound_verdict(model, window, parameters, blocks)
    bound = bound_of(blocks) if verdict == IDENTIFIED else math.nan
    facts = Facts(
        model=model,
        window=window,
        parameters=parameters,
        blocks=blocks,
        bound_verdict=verdict,
        sweep=sweep,
        asymmetry_z=z,
        late=late,
        late_error=late_error,
    )
    pieces = model.pieces
    speed_noise = [one.velocity_noise for one in pieces if math.isfinite(one.velocity_noise)]
    return Identification(
        parameters=parameters,
        asymmetric=asymmetric,
        asymmetry_z=z,
        d_blocks=blocks,
        d_range=_range(blocks),
        d_bar=bound,
        d_bar_margin=bound - _range(blocks)[1],
        d_bar_verdict=verdict,
        friction=_forces(model, window),
        window=window,
        attenuation=model.attenuation(window),
        sweep=sweep,
        residual=math.nan if found is None else found.residual,
        condition=math.inf if found is None else found.condition,
        encoder_step=max(one.encoder_step for one in pieces),
        position_noise=max(one.position_noise for one in pieces),
        velocity_noise=max(speed_noise, default=math.nan),
        effort_held=model.held,
        effort_delay=late,
        effort_delay_error=late_error,
        time_step=tuple(one.time_step for one in pieces),
        warnings=tuple(warnings_on(facts)),
        advice=tuple(advice_for(facts)),
    )


def _range(blocks: DampingBlocks) -> tuple[float, float]:
    if not len(blocks.d):
        return math.nan, math.nan
    return float(blocks.d.min()), float(blocks.d.max())


def _blocks(model: AxisModel, window: float) -> DampingBlocks:
    """Return d by blocks of 30 ms, or of T if the position is too coarse for that."""
    least = 4.0 * max(one.time_step for one in model.pieces)
    length = max(BLOCK, least, window if model.attenuation(BLOCK) > 0.1 else 0.0)
    windows = windows_of(model.motions(length), length, spacing=1.0)
    values, covariance = model.values(window)
    force = model.lacking_force(window)
    step = np.array([piece.encoder_step for piece in model.pieces])[windows.piece]
    return damping_blocks(windows, windows.effort(model.held), values, covariance, force, step)


def _forces(model: AxisModel, window: float) -> FrictionCurve:
    """Return the friction force over the velocity, by windows."""
    found, windows = model.fit(window), model.windows(window)
    if found is None:
        return FrictionCurve(velocity=NONE, force=NONE)
    values, _ = model.values(window)
    rest = windows.effort(model.held) - values[0] * windows.inertia
    offset = values[3] if not model.is_one_way(window) else 0.0
    return FrictionCurve(
        velocity=windows.damping / windows.offset, force=rest / windows.offset - offset
    )


def _by_direction(
    model: AxisModel, window: float, blocks: DampingBlocks
) -> tuple[dict[str, Estimate], float]:
    """Return the asymmetric estimates and the Wald statistic of d_plus = d_minus."""
    if model.fit(window) is None or model.is_one_way(window):
        return {}, math.nan
    found = model.solved(model.windows(window).asymmetric, window)
    if found is None:
        return {}, math.nan
    difference = np.array([0.0, 1.0, -1.0, 0.0, 0.0])
    error = math.sqrt(difference @ found.covariance @ difference)
    z = float(difference @ found.values) / error if error > 0.0 else math.nan
    return estimates_of(model, window, blocks, found, ASYMMETRIC), z


def _sweep(model: AxisModel, window: float) -> WindowSweep:
    """Return the estimates over T to 4 T."""
    lengths, fits = [], []
    for k in range(SWEEP):
        length = window * math.sqrt(2.0) ** k
        found = model.fit(length)
        if found is not None:
            lengths.append(length)
            fits.append(model.values(length))
    values = np.array([one for one, _ in fits]).reshape(-1, 4)
    errors = np.array([np.sqrt(np.diag(one)) for _, one in fits]).reshape(-1, 4)
    allowed = np.maximum(np.maximum(errors, errors[:1]), LEAST_DRIFT * np.abs(values[:1]))
    drift = np.abs(values - values[:1]) / np.where(allowed > 0.0, allowed, math.inf)
    return WindowSweep(
        window=np.array(lengths),
        values={name: values[:, i] for i, name in enumerate(SYMMETRIC)},
        standard_errors={name: errors[:, i] for i, name in enumerate(SYMMETRIC)},
        drift={name: float(drift[:, i].max(initial=0.0)) for i, name in enumerate(SYMMETRIC)},
    )
