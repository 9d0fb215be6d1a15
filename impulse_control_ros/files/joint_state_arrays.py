"""
Convert the messages of one topic, from the columns of a bag, to rows.

The frame_id of a message names its run, episode and author (core/protocol.py). Messages with equal
frame_id, joints and fields have the same layout: it is found in the first message and decodes all
of them at once. A message with stamp 0 answers no state.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.protocol import (
    CommandHeader,
    parse_command,
    parse_state,
    StateHeader,
)
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import (
    COMMANDED,
    FIELDS,
    FLOAT64,
    JointStateLayout,
    layout_in,
    why_unreadable,
)
from impulse_control_ros.files.mcap_reader import Column

SAMPLE = np.dtype(
    [('stamp', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('effort', 'f8'), ('is_reset', '?')]
)
COMMAND = np.dtype([('stamp', 'i8'), ('effort', 'f8')])
EVENT = np.dtype(
    [
        *((name, 'i8') for name in ('stamp', 'guard', 'verdict')),
        *((name, 'f8') for name in ('position', 'velocity', 'area')),
    ]
)
DAMPING = np.dtype([('stamp', 'i8'), ('damping', 'f8')])
NEEDED: dict[np.dtype[Any], Sequence[str]] = {
    SAMPLE: ('position',),
    COMMAND: COMMANDED,
    EVENT: FIELDS,
}
NOT_OURS = -1
KEPT = 8  # layouts per message size
# messages tested per message decoded in bulk: decoding one by one costs that much more
WORTH = 256
Known = tuple[JointStateLayout | None, int]  # a layout and the number of its origin, or NOT_OURS


class Source(NamedTuple):
    """The source of states: a ``run``, or a foreign plant (run '')."""

    run: str
    joint: str


class Origin(NamedTuple):
    """The origin of messages of a topic: their joint, and their header."""

    joint: str
    header: StateHeader | CommandHeader

    @property
    def source(self) -> Source:
        """The source of the message, if it is a state."""
        return Source(self.header.run, self.joint)

    @property
    def guard(self) -> str:
        """The guard that a command or an event names; '' for none."""
        return self.header.guard if isinstance(self.header, CommandHeader) else ''

    @property
    def verdict(self) -> str:
        """The verdict that a command or an event names; '' for none."""
        return self.header.verdict if isinstance(self.header, CommandHeader) else ''

    @property
    def is_event(self) -> bool:
        """Whether guard and verdict are known ones."""
        return self.guard in GUARDS and self.verdict in VERDICTS

    @property
    def node_id(self) -> str:
        """The author of a command or an event, or the controller that a state names."""
        header = self.header
        return header.author if isinstance(header, CommandHeader) else header.controller


class Messages(NamedTuple):
    """
    Messages of a topic, shape (n,).

    ``sent`` is the publish time [ns] of each, ``place`` its position in the bag, ``origin`` the
    index of its origin in ``origins``.
    """

    rows: np.ndarray
    sent: np.ndarray
    place: np.ndarray
    origin: np.ndarray
    origins: Sequence[Origin]

    @property
    def stamps(self) -> np.ndarray:
        """The stamps [ns]."""
        return self.rows['stamp']

    def where(self, keep: np.ndarray) -> 'Messages':
        """Return the messages to ``keep``, a mask or a sequence of indices."""
        if keep.dtype == bool and keep.all():
            return self
        return Messages(
            self.rows[keep], self.sent[keep], self.place[keep], self.origin[keep], self.origins
        )

    def counts(self) -> list[tuple[Origin, int]]:
        """Return the number of messages of each origin."""
        counts = np.bincount(self.origin, minlength=len(self.origins)).tolist()
        return list(zip(self.origins, counts, strict=True))

    def per_message(self, of: Callable[[Origin], int]) -> np.ndarray:
        """Return ``of(origin)`` for the origin of each message."""
        return np.array([*map(of, self.origins), 0], np.int32)[self.origin]

    def from_origins(self, test: Callable[[Origin], bool]) -> 'Messages':
        """Return the messages whose origin passes ``test``."""
        return self.where(self.per_message(test).astype(bool))

    def in_order(self, preferred: np.ndarray | None = None) -> 'Messages':
        """Return one message per stamp, in order: a ``preferred`` one, or the first one sent."""
        if (np.diff(self.stamps) > 0).all():
            return self
        last = np.zeros(len(self.rows), bool) if preferred is None else ~preferred
        ordered = self.where(np.lexsort((self.sent, last, self.stamps)))
        return ordered.where(np.append(True, np.diff(ordered.stamps) > 0))


class JointStateTable:
    """
    The messages of one topic as rows of dtype ``kind``, for ``joint`` if there are several.

    ``joints`` are all that its messages name. ``unreadable`` tells why messages are no rows, and
    how many; ``empty`` are the fields that those of the joint lack.
    """

    def __init__(self, kind: np.dtype[Any], joint: str) -> None:
        self._kind, self._joint = kind, joint
        self._rows = [np.zeros(0, kind)]
        self._sent = [np.zeros(0, np.int64)]
        self._place = [np.zeros(0, np.int64)]
        self._origin = [np.zeros(0, np.int32)]
        self._origins: list[Origin] = []
        self._numbers: dict[Origin, int] = {}
        self._layouts: dict[int, list[Known]] = {}
        self.joints: set[str] = set()
        self.unreadable = Counter[str]()
        self.empty: set[str] = set()

    def add(self, column: Column, place: np.ndarray, in_place: bool) -> None:
        """Add messages; if ``in_place``, only messages whose publish time is their stamp."""
        count = len(column.time)
        rows, origin = np.zeros(count, self._kind), np.full(count, NOT_OURS, np.int32)
        for which, content in column.same_size():
            rows[which], origin[which] = self._read(content)
        known = origin != NOT_OURS
        if in_place:
            known &= (rows['stamp'] == column.stamp) | (rows['stamp'] == 0)
        self._rows.append(rows[known])
        self._sent.append(column.stamp[known])
        self._place.append(place[known])
        self._origin.append(origin[known])

    def _read(self, content: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and origins, shape (n,), of messages as bytes, shape (n, size)."""
        rows = np.zeros(len(content), self._kind)
        origin = np.full(len(content), NOT_OURS, np.int32)
        layouts = self._layouts.setdefault(content.shape[1], [])
        found: list[Known] = []
        untried, looked_at = list(layouts), 0
        left = span = np.arange(len(content))
        while len(left):
            if is_new := not untried:
                known = self._known(content[left[0]].tobytes())
                is_worth_it = looked_at <= WORTH * (len(content) - len(left))
                span = left if is_worth_it else left[:1]
                looked_at += len(span)
            else:
                known, span = untried.pop(0), left
            good = self._fill(known, content, span, rows, origin)
            good[0] |= is_new  # an invalid message is not tested again
            if good.any() and len(found) < KEPT:
                found.append(known)
            left = np.append(span[~good], left[len(span) :])
        layouts[:] = [*found, *(known for known in layouts if known not in found)][:KEPT]
        return rows, origin

    def _known(self, raw: bytes) -> Known:
        """Return the layout of a message, None if invalid, and the number of its origin."""
        layout = layout_in(raw, self._joint) or layout_in(raw)
        if layout is None:
            self.unreadable[why_unreadable(raw)] += 1
            return layout, NOT_OURS
        self.joints.update(layout.joints)
        if layout.joint != self._joint and len(layout.joints) > 1:
            return layout, NOT_OURS
        if empty := {*NEEDED[self._kind]} - {*layout.fields}:
            self.empty |= empty
            return layout, NOT_OURS
        parse = parse_state if self._kind is SAMPLE else parse_command
        origin = Origin(layout.joint, parse(layout.frame_id))
        if self._kind is EVENT and not origin.is_event:
            return layout, NOT_OURS
        if origin not in self._numbers:
            self._numbers[origin] = len(self._origins)
            self._origins.append(origin)
        return layout, self._numbers[origin]

    def _fill(
        self,
        known: Known,
        content: np.ndarray,
        span: np.ndarray,
        rows: np.ndarray,
        origin: np.ndarray,
    ) -> np.ndarray:
        """Return which messages of a ``span`` have the layout; fill in their values."""
        layout, number = known
        if layout is None:
            return np.zeros(len(span), bool)
        good, sec, nanosec, *values = layout.decode_rows(
            content if len(span) == len(content) else content[span]
        )
        if number == NOT_OURS or not good.any():
            return good
        at = span[good]
        origin[at] = number
        rows['stamp'][at] = sec[good] * np.int64(SECOND) + nanosec[good]
        if self._kind is SAMPLE:
            rows['velocity'][at] = rows['effort'][at] = np.nan
        elif self._kind is EVENT:
            rows['guard'][at] = GUARDS.index(self._origins[number].guard)
            rows['verdict'][at] = VERDICTS.index(self._origins[number].verdict)
        for field, value in zip(layout.fields, values, strict=True):
            name = 'area' if self._kind is EVENT and field == 'effort' else field
            if name in (self._kind.names or ()):
                rows[name][at] = value[good]
        return good

    def messages(self) -> Messages:
        """Return the messages read so far; may be called only once."""
        parts: tuple[list[np.ndarray], ...] = self._rows, self._sent, self._place, self._origin
        rows, sent, place, origin = (np.concatenate(part) for part in parts)
        for part in parts:  # frees the memory of the parts
            part.clear()
        return Messages(rows, sent, place, origin, self._origins)


def damping_rows(column: Column) -> np.ndarray:
    """Return std_msgs/Float64 messages, which have no stamp: shape (n,), dtype DAMPING."""
    rows = np.zeros(len(column.stamp), DAMPING)
    rows['stamp'], rows['damping'] = column.stamp, np.nan
    for which, content in column.same_size():
        if content.shape[1] >= FLOAT64.itemsize:
            raw = np.ascontiguousarray(content[:, : FLOAT64.itemsize])
            rows['damping'][which] = raw.view(FLOAT64)['data'][:, 0]
    return rows
