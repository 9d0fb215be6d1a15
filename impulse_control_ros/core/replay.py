"""
A recorded run computed once more, by the kernels that the nodes run: to the same bits.

Open loop the law answers the recorded states. Closed loop the axis is stepped on as well, from
its start. Both go piece by piece: within one the parameters are constant.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.axis import Axis, plant_step, STATE
from impulse_control_ros.core.impulse import ANSWER, control, Controller, fresh_memory
from impulse_control_ros.core.kernel import compiled


class Piece(NamedTuple):
    """
    What holds from sample ``first`` on.

    The ``controller`` answers this sample, and the ``axis`` steps on from it. ``afresh`` tells
    that the controller's memory is empty before it; ``start`` is the axis whose start the state
    of this sample is, None where it follows from the sample before.
    """

    first: int
    axis: Axis
    controller: Controller
    afresh: bool
    start: Axis | None


@compiled
def answer_each(memory, gains, position, velocity, answers):
    """Answer n samples: all but ``memory`` and ``gains`` have shape (n,)."""
    for k in range(len(answers)):
        control(memory, gains, position[k], velocity[k], answers[k:k + 1])


@compiled
def close_loop(axis, profile, state, memory, gains, states, answers):
    """Make n samples, and answer them, from ``state`` on: the last two have shape (n,)."""
    for k in range(len(answers)):
        if k:
            plant_step(axis, profile, state, answers[k - 1].effort)
        states[k] = state[0]
        control(memory, gains, state[0].position, state[0].velocity, answers[k:k + 1])


def spans(pieces: Sequence[Piece], count: int) -> Iterator[tuple[Piece, slice]]:
    """Yield each piece with its samples out of ``count``."""
    ends = [piece.first for piece in pieces[1:]] + [count]
    return ((piece, slice(piece.first, end)) for piece, end in zip(pieces, ends, strict=True))


def answered(position: np.ndarray, velocity: np.ndarray, pieces: Sequence[Piece]) -> np.ndarray:
    """
    Return the law's answers to n samples [m, m/s] of shape (n,): dtype ANSWER.

    The first piece starts at sample 0.
    """
    answers, memory = np.zeros(len(position), ANSWER), fresh_memory()
    for piece, span in spans(pieces, len(position)):
        if piece.afresh:
            memory = fresh_memory()
        answer_each(memory, piece.controller.packed(), position[span], velocity[span],
                    answers[span])
    return answers


def run_again(count: int, pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
    """
    Return ``count`` states and the answers to them: shape (count,), dtype STATE and ANSWER.

    The first piece starts at sample 0, with a start.
    """
    states, answers = np.zeros(count, STATE), np.zeros(count, ANSWER)
    state, memory = np.zeros(1, STATE), fresh_memory()
    axis: Any = None
    for piece, span in spans(pieces, count):
        if span.start and not piece.start:
            plant_step(*axis, state, answers[span.start - 1]['effort'])
        elif span.start:
            state['tick'] += 1
        if piece.start:
            state['position'], state['velocity'] = piece.start.x_0, piece.start.v_0
            state['effort'] = 0.0
        if piece.afresh:
            memory = fresh_memory()
        axis = piece.axis.packed()
        close_loop(*axis, state, memory, piece.controller.packed(), states[span], answers[span])
    return states, answers
