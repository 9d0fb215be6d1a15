"""
Build the messages of a run from its samples, with the order and bytes that our nodes publish.

Messages are built in bulk: as rows of bytes per layout, which are then copied into place.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.protocol import CommandHeader, StateHeader
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import (
    COMMANDED,
    encode_float64,
    encode_rows,
    FIELDS,
    FLOAT64,
    JointStateLayout,
    WITHOUT_VELOCITY,
)
from impulse_control_ros.files.mcap_chunk import Block, ROOM
from impulse_control_ros.files.topics import (
    DAMPING,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATES,
)

ORDER = (JOINT_STATES, IMPULSE_EVENTS, JOINT_COMMANDS, DAMPING)  # of the messages in a sample
STATES, EVENTS, COMMANDS, DAMPINGS = range(4)


class Rows(NamedTuple):
    """Messages of one layout on one topic of ``ORDER``, for ``which`` samples of a block."""

    topic: int
    which: np.ndarray
    content: np.ndarray

    @classmethod
    def of(
        cls, topic: int, which: np.ndarray, layout: JointStateLayout, values: Iterable[np.ndarray]
    ) -> 'Rows':
        """Return the messages of ``which`` samples, given the ``values`` of all samples."""
        chosen = [value[which] for value in values]
        return cls(topic, which, encode_rows(layout.message, layout.dtype, chosen, ROOM))


def placed(rows: Sequence[Rows], count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return the bytes of the messages of ``count`` samples in order, their offsets and sizes.

    Offsets and sizes have shape (count, topics); the size is 0 where there is no message.
    """
    size = np.zeros((count, len(ORDER)), np.int64)
    for topic, which, content in rows:
        size[which, topic] = content.shape[1]
    end = size.cumsum().reshape(size.shape)
    start = end - size
    made = np.empty(end[-1, -1], np.uint8)
    for topic, which, content in rows:
        places = sliding_window_view(made, content.shape[1], writeable=True)
        places[start[which, topic]] = content
    return made, start, size


class RunMessages:
    """
    Builds the messages of a run that one controller answers from the first state on.

    ``header`` is the header of all states after the first. ``channels`` maps topics to channels;
    if damping is among them, it has a message every ``damping_every`` samples, 0 for none.
    """

    def __init__(
        self,
        header: StateHeader,
        joint: str,
        channels: Mapping[str, int],
        start_ns: int,
        step_ns: int,
        damping_every: int,
    ) -> None:
        self._channels = np.array([channels.get(topic, 0) for topic in ORDER])
        self._start_ns, self._step_ns = start_ns, step_ns
        self._damping_every = damping_every if DAMPING in channels else 0
        unanswered = header._replace(controller='')
        self._states = {
            (is_first, is_bare): JointStateLayout(joint, one.frame_id, fields)
            for is_first, one in ((True, unanswered), (False, header))
            for is_bare, fields in ((True, WITHOUT_VELOCITY), (False, FIELDS))
        }
        frame_ids = [
            CommandHeader(*header, guard, verdict).frame_id
            for verdict in VERDICTS
            for guard in GUARDS
        ]
        self._events = [JointStateLayout(joint, frame_id) for frame_id in frame_ids]
        self._commands = [JointStateLayout(joint, frame_id, COMMANDED) for frame_id in frame_ids]

    def block(self, states: np.ndarray, answers: np.ndarray) -> Block:
        """Return the messages of samples: measured ``states``, dtype STATE, and ``answers``."""
        stamp = self._start_ns + states['tick'] * self._step_ns
        time = np.divmod(stamp, SECOND)
        rows = [
            *self._state_rows(states, time),
            *self._answer_rows(states, answers, time),
            *self._damping_rows(states),
        ]
        content, start, size = placed(rows, len(stamp))
        sample, topic = np.nonzero(size)
        return Block(content, start[sample, topic], self._channels[topic], stamp[sample])

    def _state_rows(self, states: np.ndarray, time: tuple[Any, Any]) -> Iterator[Rows]:
        first, bare = states['tick'] == 0, np.isnan(states['velocity'])
        for (is_first, is_bare), layout in self._states.items():
            which = np.flatnonzero((first == is_first) & (bare == is_bare))
            values = *time, *(states[name] for name in layout.fields)
            yield Rows.of(STATES, which, layout, values)

    def _answer_rows(
        self, states: np.ndarray, answers: np.ndarray, time: tuple[Any, Any]
    ) -> Iterator[Rows]:
        values = (
            *time,
            answers['effort'],
            states['position'],
            answers['velocity'],
            answers['area'],
        )
        kind = answers['guard'] + len(GUARDS) * answers['verdict']
        for number in np.unique(kind):
            which = np.flatnonzero(kind == number)
            yield Rows.of(COMMANDS, which, self._commands[number], values[:3])
            if number:
                event = *time, *values[3:]
                yield Rows.of(EVENTS, which, self._events[number], event)

    def _damping_rows(self, states: np.ndarray) -> Iterator[Rows]:
        if self._damping_every:
            due = (states['tick'] % self._damping_every == 0) & (states['tick'] > 0)
            which = np.flatnonzero(due)
            values = [states['damping'][which]]
            yield Rows(DAMPINGS, which, encode_rows(encode_float64(0.0), FLOAT64, values, ROOM))
