"""
Replay of a recorded run with the kernels of the nodes, to the same bits.

In open loop, the law answers the recorded states. In closed loop, the axis is also stepped from
its start. Both proceed in pieces of constant parameters.
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
from impulse_control_ros.core.learnt import Learnt, learnt_from
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.supervision import SUPERVISION


class Piece(NamedTuple):
    """
    Parameters from sample ``first`` on.

    The controller with ``gains`` answers this sample, and ``plant`` (None if unknown) steps on
    from it. ``afresh`` is true if the controller's memory is empty before this sample. ``start``
    is the plant that starts at this sample, None if its state follows from the previous one.
    """

    first: int
    plant: Plant | None
    gains: ControlGains
    afresh: bool
    start: Plant | None


def spans(pieces: Sequence[Piece], count: int) -> Iterator[tuple[Piece, slice]]:
    """Yield each piece with the slice of its samples; there are ``count`` samples in total."""
    ends = [piece.first for piece in pieces[1:]] + [count]
    return ((piece, slice(piece.first, end)) for piece, end in zip(pieces, ends, strict=True))


def answered(position: np.ndarray, velocity: np.ndarray, pieces: Sequence[Piece]) -> np.ndarray:
    """
    Return the law's answers to n samples [m, m/s] of shape (n,): dtype COMMAND.

    ``velocity`` is nan where it was not measured. The first piece starts at sample 0.
    """
    commands = np.zeros(len(position), COMMAND)
    for _ in answers(position, velocity, pieces, commands):
        pass
    return commands


def answers(
    position: np.ndarray, velocity: np.ndarray, pieces: Sequence[Piece], commands: np.ndarray
) -> Iterator[np.ndarray]:
    """
    Fill ``commands`` piece by piece, see `answered`.

    Yields the memory of the supervision after each piece: shape (1,), dtype SUPERVISION.
    """
    state, memory = FRESH, np.zeros(1, SUPERVISION)
    for piece, span in spans(pieces, len(position)):
        if piece.afresh:
            state, memory = FRESH, np.zeros(1, SUPERVISION)
        state = answer_samples(
            state,
            piece.gains.values,
            piece.gains.options,
            memory,
            position[span],
            velocity[span],
            commands[span],
        )
        yield memory


def learnt_at(
    samples: Sequence[int], position: np.ndarray, velocity: np.ndarray, pieces: Sequence[Piece]
) -> list[Learnt]:
    """Return what the law of `answered` has learnt after each of ``samples``."""
    parts = divided(pieces, [sample + 1 for sample in samples])
    ends = [*(part.first for part in parts[1:]), len(position)]
    memories = answers(position, velocity, parts, np.zeros(len(position), COMMAND))
    found = {
        end: learnt_from(memory, part.gains)
        for part, end, memory in zip(parts, ends, memories, strict=True)
    }
    return [found[sample + 1] for sample in samples]


def divided(pieces: Sequence[Piece], firsts: Sequence[int]) -> list[Piece]:
    """Return the pieces, divided at each of ``firsts``."""
    given, parts = {piece.first: piece for piece in pieces}, [pieces[0]]
    for first in sorted({*firsts, *given} - {pieces[0].first}):
        going_on = parts[-1]._replace(first=first, afresh=False, start=None)
        parts.append(given.get(first, going_on))
    return parts


def run_again(count: int, pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ``count`` measured states and their answers: dtypes STATE and COMMAND.

    The first piece begins at sample 0 and needs a ``start``; each piece needs a ``plant``.
    """
    first = pieces[0]
    assert first.start
    trace, loop = empty_trace(count), ClosedLoop(first.start, first.gains)
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
