"""
The messages of one topic of ours as rows, from the columns of a bag.

In a bag of our recorder each message of a series has the publish time that its stamp says; one
that has another is foreign, and left out. Other recorders, as ``ros2 bag record``, know only when
a message was sent and came: there the stamps alone give the order, a message that came again is
left out, and what has no stamp belongs to the state that was sent last before it.
"""

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain
from typing import Any

import numpy as np

from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import (
    COMMANDED,
    FIELDS,
    JointStateLayout,
    layout_in,
    RESET_MARK,
    WITHOUT_VELOCITY,
)
from impulse_control_ros.files.columns import Column

SAMPLE = np.dtype([('stamp', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('effort', 'f8'),
                   ('marked', '?')])
COMMAND = np.dtype([('stamp', 'i8'), ('effort', 'f8')])
IMPULSE = np.dtype([('stamp', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'),
                    ('area', 'f8')])
DAMPING = np.dtype([('stamp', 'i8'), ('damping', 'f8')])
FLOAT64_SIZE = 12


class Series:
    """The messages of one topic of ours, collected as rows of ``kind``."""

    def __init__(self, kind: np.dtype[Any]) -> None:
        self._kind = kind
        self._rows = [np.zeros(0, kind)]
        self._times = [np.zeros(0, np.int64)]
        self._sent = [np.zeros(0, np.int64)]
        self._unstamped = [np.zeros(0, np.int64)]

    def add(self, column: Column, joint: str, ours: bool) -> None:
        """Take the messages of ``joint``: in a bag of ours those at the place of their stamp."""
        rows, known = np.zeros(len(column.time), self._kind), np.zeros(len(column.time), bool)
        layouts = layouts_of(self._kind, joint)
        for which, content in column.same_size():
            others = others_in(content, joint, known, which) if self._kind is SAMPLE else ()
            for number, layout in enumerate(chain(layouts, others)):
                if known[which].all():
                    break
                good, sec, nanosec, *values = layout.decode_rows(content)
                at = which[good]
                known[at] = True
                rows['stamp'][at] = sec[good] * np.int64(SECOND) + nanosec[good]
                if self._kind is IMPULSE:
                    rows['guard'][at] = number
                elif self._kind is SAMPLE:
                    rows['marked'][at] = layout.frame_id == RESET_MARK
                    rows['velocity'][at] = rows['effort'][at] = np.nan
                for name, value in zip(self._names(layout), values, strict=True):
                    rows[name][at] = value[good]
        self._unstamped.append(column.stamp[known & (rows['stamp'] == 0)])
        if ours:
            known &= rows['stamp'] == column.stamp
            self._times.append(column.time[known])
        else:
            known &= rows['stamp'] > 0
            self._times.append(rows['stamp'][known])
            self._sent.append(column.stamp[known])
        self._rows.append(rows[known])

    @property
    def _measured(self) -> list[str]:
        return [name for name in self._kind.names or () if self._kind[name].kind == 'f']

    def _names(self, layout: JointStateLayout) -> Sequence[str]:
        """Return our names of the fields of a layout."""
        return self._measured if self._kind is IMPULSE else layout.fields

    @property
    def unstamped(self) -> np.ndarray:
        """Return the places [ns] of the messages that tell no stamp of their own."""
        return np.concatenate(self._unstamped)

    def in_order(self) -> np.ndarray:
        """Return the rows in the order of their log time, or of their stamp without repeats."""
        rows, times = np.concatenate(self._rows), np.concatenate(self._times)
        self._rows, self._times = [rows], [times]  # the parts are not held twice
        if not (times[1:] >= times[:-1]).all():
            rows = rows[np.argsort(times, kind='stable')]
        if len(self._sent) > 1:
            rows = rows[np.append(True, rows['stamp'][1:] > rows['stamp'][:-1])[:len(rows)]]
        return rows

    def placed(self, sent: Any) -> Any:
        """Return the stamp of the message that was sent last before each time ``sent`` [ns]."""
        times = np.concatenate(self._sent)
        order = np.argsort(times, kind='stable')
        stamps = np.insert(np.concatenate(self._rows)['stamp'][order], 0, 0)
        return stamps[np.searchsorted(times[order], sent, 'right')]


def others_in(content: np.ndarray, joint: str, known: np.ndarray, which: np.ndarray
              ) -> Iterator[JointStateLayout]:
    """
    Yield the layout of each state of ``joint`` that is not yet ``known`` when it is asked for.

    ``content`` of shape (k, size) are the bytes of the messages ``which`` of those ``known``.
    """
    for message, place in zip(content, which, strict=True):
        layout = None if known[place] else layout_in(message.tobytes(), joint)
        if layout and 'position' in layout.fields:
            yield layout


@cache
def layouts_of(kind: np.dtype[Any], joint: str) -> list[JointStateLayout]:
    """Return the layouts of the messages that rows of ``kind`` are made of."""
    if kind is IMPULSE:
        return [JointStateLayout(joint, guard) for guard in GUARDS]
    if kind is COMMAND:
        return [JointStateLayout(joint, guard, COMMANDED) for guard in GUARDS]
    return [JointStateLayout(joint, mark, fields) for fields in (FIELDS, WITHOUT_VELOCITY)
            for mark in ('', RESET_MARK)]


def damping_of(column: Column) -> np.ndarray:
    """Return the messages of std_msgs/Float64 of a chunk: shape (n,), dtype DAMPING."""
    rows = np.zeros(len(column.stamp), DAMPING)
    rows['stamp'], rows['damping'] = column.stamp, np.nan
    for which, content in column.same_size():
        if content.shape[1] >= FLOAT64_SIZE:
            rows['damping'][which] = content[:, 4:FLOAT64_SIZE].copy().view('<f8')[:, 0]
    return rows
