"""
A recorded run computed once more, by the kernels that the nodes run: to the same bits.

Open loop the law answers the recorded states. Closed loop the axis is stepped on as well, from
its start. Both go piece by piece: within one the parameters are constant.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.careful import control_carefully, fresh_watch, packed_law
from impulse_control_ros.core.impulse import ANSWER, ControlGains, fresh_memory
from impulse_control_ros.core.jit import compiled
from impulse_control_ros.core.nonidealities import at_rest
from impulse_control_ros.core.plant import Plant, STATE
from impulse_control_ros.core.plant_step import plant_step, put_to_start


class Piece(NamedTuple):
    """
    What holds from sample ``first`` on.

    The ``controller`` answers this sample, and the ``axis``, None for an unknown one, steps on
    from it. ``afresh`` tells
    that the controller's memory is empty before it; ``start`` is the axis whose start the state
    of this sample is, None where it follows from the sample before.
    """

    first: int
    axis: Plant | None
    controller: ControlGains
    afresh: bool
    start: Plant | None


@compiled
def answer_each(memory, watch, gains, care, position, velocity, answers):
    """Answer n samples: ``position``, ``velocity`` and ``answers`` have shape (n,)."""
    for k in range(len(answers)):
        control_carefully(memory, watch, gains, care, position[k], velocity[k], answers[k : k + 1])


@compiled
def close_loop(
    axis, profile, hardware, state, hidden, memory, watch, gains, care, states, answers
):
    """Make n samples, and answer them, from ``state`` on: the last two have shape (n,)."""
    for k in range(len(answers)):
        if k:
            plant_step(axis, profile, hardware, state, hidden, answers[k - 1].effort)
        seen = hidden[0]
        states[k] = state[0]
        states[k].position, states[k].velocity = seen.position, seen.velocity
        control_carefully(
            memory, watch, gains, care, seen.position, seen.velocity, answers[k : k + 1]
        )


def spans(pieces: Sequence[Piece], count: int) -> Iterator[tuple[Piece, slice]]:
    """Yield each piece with its samples out of ``count``."""
    ends = [piece.first for piece in pieces[1:]] + [count]
    return ((piece, slice(piece.first, end)) for piece, end in zip(pieces, ends, strict=True))


def answered(position: np.ndarray, velocity: np.ndarray, pieces: Sequence[Piece]) -> np.ndarray:
    """
    Return the law's answers to n samples [m, m/s] of shape (n,): dtype ANSWER.

    A velocity that was not measured is nan. The first piece starts at sample 0.
    """
    answers, memory, watch = np.zeros(len(position), ANSWER), fresh_memory(), fresh_watch()
    for piece, span in spans(pieces, len(position)):
        if piece.afresh:
            memory, watch = fresh_memory(), fresh_watch()
        answer_each(
            memory,
            watch,
            *packed_law(piece.controller),
            position[span],
            velocity[span],
            answers[span],
        )
    return answers


def run_again(count: int, pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ``count`` states, as measured, and the answers: shape (count,), dtype STATE and ANSWER.

    The first piece starts at sample 0, with a start; each has an axis.
    """
    states, answers = np.zeros(count, STATE), np.zeros(count, ANSWER)
    state, hidden = np.zeros(1, STATE), at_rest()
    memory, watch = fresh_memory(), fresh_watch()
    axis: Any = None
    for piece, span in spans(pieces, count):
        if span.start and not piece.start:
            plant_step(*axis, state, hidden, answers[span.start - 1]['effort'])
        elif span.start:
            state['tick'] += 1
        assert piece.axis
        axis = (*piece.axis.packed(), piece.axis.packed_hardware())
        if piece.start:
            hidden = put_to_start(piece.start, state)
        if piece.afresh:
            memory, watch = fresh_memory(), fresh_watch()
        close_loop(
            *axis,
            state,
            hidden,
            memory,
            watch,
            *packed_law(piece.controller),
            states[span],
            answers[span],
        )
    return states, answers
