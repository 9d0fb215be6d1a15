"""A closed loop computed in blocks of samples: its memory does not grow with its duration."""

from collections.abc import Iterator
from copy import deepcopy

import numpy as np

from impulse_control_ros.core.careful import fresh_watch, packed_law
from impulse_control_ros.core.impulse import ANSWER, ControlGains, fresh_memory
from impulse_control_ros.core.plant import DIVERGED, Plant, STATE
from impulse_control_ros.core.plant_step import plant_step, put_to_start
from impulse_control_ros.core.replay import close_loop
from impulse_control_ros.core.tick import nanoseconds, seconds
from impulse_control_ros.errors import DivergedError

BLOCK = 10_000  # samples


class ClosedLoop:
    """An axis and its controller after the samples that were made; none are at first."""

    def __init__(self, axis: Plant, controller: ControlGains) -> None:
        self._axis = *axis.packed(), axis.packed_hardware()
        self._law = packed_law(controller)
        self.state = np.zeros(1, STATE)
        self._hidden = put_to_start(axis, self.state)
        self._memory, self._watch = fresh_memory(), fresh_watch()
        self._answer: np.void | None = None

    def make(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the next states, as measured, and their answers: dtypes STATE and ANSWER."""
        states, answers = np.zeros(count, STATE), np.zeros(count, ANSWER)
        if self._answer is not None:
            plant_step(*self._axis, self.state, self._hidden, self._answer['effort'])
        close_loop(
            *self._axis,
            self.state,
            self._hidden,
            self._memory,
            self._watch,
            *self._law,
            states,
            answers,
        )
        self._answer = answers[-1]
        return states, answers

    @property
    def is_bounded(self) -> bool:
        """Tell whether the last state is within bounds; one that has left them stays outside."""
        return bool(abs(self.state['position'][0]) < DIVERGED > abs(self.state['velocity'][0]))


def blocks_of(
    axis: Plant, controller: ControlGains, count: int, start_ns: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """
    Yield ``count`` states, as measured, and their answers, block by block.

    Raises `DivergedError`, with the stamp of a run that starts at ``start_ns``, after the last
    state within bounds.
    """
    loop = ClosedLoop(axis, controller)
    for first in range(0, count, BLOCK):
        before = deepcopy(loop)
        made = loop.make(min(BLOCK, count - first))
        if not loop.is_bounded:
            break
        yield made
    else:
        return
    good, probe = 0, deepcopy(before)
    while probe.make(1) and probe.is_bounded:
        good += 1
    if good:
        yield before.make(good)
    _, position, velocity, *_ = probe.state[0]
    stamp_ns = start_ns + (first + good) * nanoseconds(axis.time_step, 'time_step')
    raise DivergedError(position, velocity, seconds(stamp_ns))
