"""
Put the raw messages of several topics into the order of time, and look for gaps in the series.

Topics are numbered: STATES, EVENTS, COMMANDS, then whatever else is recorded. The series are the
states and the commands of one run: one message per sample each. Their messages and the impulse
events carry their stamp at the front of their CDR; whatever else gets the stamp of the newest
state. A message with the same bytes as the one before it on its topic is a repeat and dropped.
A message that comes too late for its place, or whose stamp is more than a second ahead of the
states, takes the nearest place that is left.
"""

from collections.abc import Sequence
from operator import itemgetter
import struct

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import LITTLE_ENDIAN_CDR

STATES, EVENTS, COMMANDS = range(3)
Entry = tuple[int, int, bytes]
_STAMP = struct.Struct('<4sII')


class Timeline:
    """
    The order of one run; ``step_ns`` is its sampling period.

    ``missing`` counts samples without their state, and states without their command, behind the
    first answered state; ``repeated`` the dropped messages; ``reached`` is the stamp [ns] of the
    last state whose command is there too, 0 before.
    """

    def __init__(self, step_ns: int) -> None:
        self.missing = self.repeated = self.reached = 0
        self._step_ns = step_ns
        self._waiting: list[Entry] = []
        self._newest = 0
        self._before = dict.fromkeys((STATES, EVENTS, COMMANDS), b'')
        self._last_state = 0
        self._answered = self._met = False

    def add(self, index: int, messages: Sequence[bytes]) -> int:
        """
        Add messages of a topic; returns how many were taken.

        Fewer than all are taken when a state goes back in time: the rest is of another run.
        """
        if index not in self._before:
            self._waiting += [(self._newest, index, raw) for raw in messages]
            return len(messages)
        before = self._before[index]
        for number, raw in enumerate(messages):
            if raw == before:
                self.repeated += 1
                continue
            stamp = self._stamp(raw)
            if index == STATES:
                if stamp <= self._newest:
                    return number
                self._newest = stamp
            self._before[index] = before = raw
            self._waiting.append((stamp, index, raw))
        return len(messages)

    def take(self, everything: bool = False) -> list[Entry]:
        """Return in order what is in its place for good: up to `reached`, or ``everything``."""
        self._waiting.sort(key=itemgetter(0, 1))
        ready, state = 0, self._last_state
        for number, (stamp, index, _) in enumerate(self._waiting):
            if index == STATES:
                state = stamp
            elif index == COMMANDS and stamp == state:
                ready, self.reached = number + 1, stamp
        if everything:
            ready = len(self._waiting)
        taken, self._waiting = self._waiting[:ready], self._waiting[ready:]
        self._count_missing(taken)
        return taken

    def _count_missing(self, entries: Sequence[Entry]) -> None:
        for stamp, index, _ in entries:
            if index == STATES:
                if self._last_state:
                    self.missing += (stamp - self._last_state) // self._step_ns - 1
                self.missing += self._met and not self._answered
                self._answered, self._last_state = False, stamp
            elif index == COMMANDS and stamp == self._last_state:
                self._answered = self._met = True

    def _stamp(self, raw: bytes) -> int:
        if len(raw) < _STAMP.size or raw[:4] != LITTLE_ENDIAN_CDR:
            return self._newest
        _, sec, nanosec = _STAMP.unpack_from(raw)
        stamp = sec * SECOND + nanosec
        return min(stamp, self._newest + SECOND) if self._newest else stamp
