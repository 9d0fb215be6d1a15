"""The queues of files/sample_joiner.py: for answers and for unstamped messages."""

from bisect import bisect
from collections.abc import Callable
import struct
from typing import Any, NamedTuple

from impulse_control_ros.core.protocol import ENDLESS, FOREIGN, parse_command
from impulse_control_ros.core.tick import to_ns
from impulse_control_ros.files.cdr import read_header, string

KEPT = 100_000
TEXT_AT = 12  # offset of the frame_id, after encapsulation and stamp
NONE = b'\xff' * 4  # no frame_id begins with this
Entry = tuple[int, int, bytes]  # stamp [ns], channel, message
read_stamp = struct.Struct('<II').unpack_from


class Answer(NamedTuple):
    """A command or an event that waits for its state."""

    author: str
    has_event: bool
    raw: bytes


class StampedReader:
    """Reads stamps and frame_ids; ``parse`` runs only if the frame_id changes."""

    def __init__(self, parse: Callable[[str], Any]) -> None:
        self._parse = parse
        self._text, self._header = NONE, parse('')  # of the previous message

    def read(self, raw: bytes) -> tuple[Any, int]:
        """Return header and stamp [ns] of a message; the stamp is 0 if there is none."""
        if not raw.startswith(self._text, TEXT_AT):
            text = read_header(raw)[1].decode(errors='replace')
            self._text, self._header = string(text), self._parse(text)
        sec, nanosec = read_stamp(raw, 4) if len(raw) > TEXT_AT else (0, 0)
        return self._header, to_ns(sec, nanosec)


class AnswerQueue:
    """
    The commands or the events of a run that wait for their states.

    ``waiting`` holds the answers by stamp [ns]; ``begun`` is true once one has arrived. One of our
    free-running plants (``is_free``) accepts answers of foreign peers with any stamp.
    """

    def __init__(self, run: str, is_free: bool) -> None:
        self.begun = False
        self._run, self._is_free = run, is_free
        self.waiting: dict[int, list[Answer]] = {}
        self._latest: dict[str, int] = {}  # stamp by author
        self._read = StampedReader(parse_command).read

    def add(self, raw: bytes, done: int) -> tuple[str, int]:
        """
        Add a message; states up to the stamp ``done`` have been released.

        Returns why the message is not kept ('' if it is) and its stamp, or its author's latest
        stamp if it has none. The reason is 'other_clock' if the stamp does not come from a state.
        """
        sender, stamp = self._read(raw)
        author = sender.author
        if sender.run != self._run and author != FOREIGN:
            return 'foreign', 0
        if author == FOREIGN and self._is_free:
            self.begun = True
            return 'other_clock', stamp
        if not stamp:
            return 'unstamped', self._latest.get(author, done)
        found = self.waiting.get(stamp)
        if stamp <= done or (found and any(one.author == author for one in found)):
            return 'repeated', stamp
        self.begun = True
        self.waiting.setdefault(stamp, []).append(Answer(author, sender.has_event, raw))
        self._latest[author] = max(stamp, self._latest.get(author, 0))
        return '', stamp

    def find(self, stamp: int, author: str) -> tuple[Answer | None, bool]:
        """
        Return the answer of an author ('' for any) to the state of ``stamp``.

        If there is none, also return whether that author has sent a later one.
        """
        for one in self.waiting.get(stamp, ()):
            if one.author == author or not author:
                return one, False
        return None, any(
            latest > stamp for who, latest in self._latest.items() if author in ('', who)
        )

    def give_up(self, stamp: int, author: str) -> None:
        """Stop expecting an answer of an author to the state of ``stamp``."""
        self._latest[author] = stamp + 1

    def is_replaced(self, author: str) -> bool:
        """Return whether the latest answer is by another author."""
        return max(self._latest, key=lambda one: self._latest[one], default=author) != author

    def drop(self, stamp: int) -> int:
        """Drop the answers to the state of a stamp; return how many exceeded one."""
        found = self.waiting.pop(stamp, None)
        return len(found) - 1 if found else 0

    def pop_others(self, stamp: int) -> list[tuple[int, bytes]]:
        """Drop the answers up to a stamp, which match no state; return them with their stamps."""
        if not self.waiting or next(iter(self.waiting)) > stamp:
            return []
        return [
            (early, one.raw)
            for early in [one for one in self.waiting if one <= stamp]
            for one in self.waiting.pop(early)
        ]


class UnstampedQueue:
    """The messages without a stamp, and the publish times of the states."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, bytes]] = []  # time [ns], channel, message
        self._states: list[tuple[int, int]] = []  # time, stamp

    def add_state(self, time: int, stamp: int) -> None:
        """Record the publish time [ns] of a state."""
        self._states.append((time, stamp))
        if len(self._states) > 2 * KEPT:
            del self._states[:-KEPT]

    def add(self, time: int, channel: int, raw: bytes) -> None:
        """Add a message that was published at ``time`` [ns]."""
        self._waiting.append((time, channel, raw))

    def placed(self, everything: bool) -> list[Entry]:
        """Return messages before the newest state, or ``everything``, by the state before each."""
        states, waiting, self._waiting = self._states, self._waiting, []
        found = []
        for time, channel, raw in waiting:
            if states and (everything or time < states[-1][0]):
                before = max(0, bisect(states, (time, ENDLESS)) - 1)
                found.append((states[before][1], channel, raw))
            else:
                self._waiting.append((time, channel, raw))
        return found
