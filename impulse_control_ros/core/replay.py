"""
A recorded run computed once more, by the kernels that the nodes run: to the same bits.

Open loop the law answers the recorded states. Closed loop the axis is stepped on as well, from
its start. Both go piece by piece: within one the parameters are constant.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.closed_loop import (
    ClosedLoop,
    commands_of,
    empty_trace,
    measured_states,
    Trace,
)
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import answer_samples, COMMAND, FRESH
from impulse_control_ros.core.plant import Plant


class Piece(NamedTuple):
    """
    What holds from sample ``first`` on.

    The controller with ``gains`` answers this sample, and the ``plant``, None for an unknown
    one, steps on from it. ``afresh`` tells that the controller's memory is empty before it;
    ``start`` is the plant whose start the state of this sample is, None where it follows from the
    sample before.
    """

    first: int
    plant: Plant | None
    gains: ControlGains
    afresh: bool
    start: Plant | None


def spans(pieces: Sequence[Piece], count: int) -> Iterator[tuple[Piece, slice]]:
    """Yield each piece with its samples out of ``count``."""
    ends = [piece.first for piece in pieces[1:]] + [count]
    return ((piece, slice(piece.first, end)) for piece, end in zip(pieces, ends, strict=True))


def answered(position: np.ndarray, velocity: np.ndarray, pieces: Sequence[Piece]) -> np.ndarray:
    """
    Return the law's answers to n samples [m, m/s] of shape (n,): dtype COMMAND.

    A velocity that was not measured is nan. The first piece starts at sample 0.
    """
    commands, state = np.zeros(len(position), COMMAND), FRESH
    for piece, span in spans(pieces, len(position)):
        state = answer_samples(
            FRESH if piece.afresh else state,
            piece.gains.values,
            piece.gains.options,
            position[span],
            velocity[span],
            commands[span],
        )
    return commands


def run_again(count: int, pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ``count`` states, as measured, and their answers: dtypes STATE and COMMAND.

    The first piece starts at sample 0, with a start; each has a plant.
    """
    first = pieces[0]
    assert first.start
    trace, loop = empty_trace(count, ideal=False), ClosedLoop(first.start, first.gains)
    starts = [piece.start for piece in pieces[1:]] + [None]
    for (piece, span), next_start in zip(spans(pieces, count), starts, strict=True):
        assert piece.plant
        loop.change(piece.plant, piece.gains)
        if piece.start and span.start:
            loop.start(piece.start)
        if piece.afresh:
            loop.forget()
        loop.fill(Trace(*(signal[span] for signal in trace)), step_on=next_start is None)
    return measured_states(trace, 0), commands_of(trace)
