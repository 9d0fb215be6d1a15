"""What the records or the model of an identification lack, and which excitation would help."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math

from impulse_control_ros.core.axis_model import ATTENUATION, AxisModel
from impulse_control_ros.core.identification import (
    DampingBlocks,
    Estimate,
    IDENTIFIED,
    WindowSweep,
)
from impulse_control_ros.core.verdicts import LEAST_BLOCKS, shown_time

LEAST_PARTS = 20  # of the motion


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
        yield f'the motion is short: the intervals follow from only {found.count} parts of it'
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
        yield 'move faster and for longer: d is only seen while the axis moves'
