"""
Put the raw messages of several topics into the order of time, and look for gaps in the series.

Topics are numbered: STATES, EVENTS, COMMANDS, then whatever else is recorded. The series are the
states and the commands of one run: one message per sample each. Their messages and the impulse
events carry their stamp at the front of their CDR; whatever else gets its stamp by the writers'
clocks: that of the state that was published last before it or, where it is the controller's own
word of its parameters, that of the first command after it. So a change of parameters stands at
the state with which it first acts: the controller answers this state, and the plant steps on from
it, with the new ones. A message of the series with the same bytes as the one before it is a
repeat and dropped. A message that comes too late for its place, or whose stamp is more than a
second ahead of the states, takes the nearest place that is left. A command without a stamp, which
answers no state, stands behind the last one that does. A command that names a guard tells of an
impulse event, which may arrive after it: it is awaited, until a later one is there.

Another run begins with a state that is marked as a start and does not follow the one before, or
that goes back in time and is borne out: by the state one step after it, or by coming again. A
state of another joint, one that is not borne out, or one of a second plant beside the first, is
foreign: kept, but not of the series.
"""

from bisect import bisect
from collections.abc import Callable, Mapping, Sequence
from enum import auto, Enum
from operator import itemgetter
import struct

from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import LITTLE_ENDIAN_CDR, RESET_MARK, string

FOREIGN, STATES, EVENTS, COMMANDS = range(-1, 3)
Entry = tuple[int, int, bytes]
Taken = tuple[bytes, Mapping[str, int]]  # as rclpy's take_message returns it
KEPT = 100_000
UNNUMBERED = 2**64 - 1  # of rmw: the middleware gives no sequence numbers
UNANSWERED = 10_000  # samples; the queue of a controller is shorter
_STAMP = struct.Struct('<4sII')
_NODE_AT = 12  # of rcl_interfaces/ParameterEvent: its second field, after a stamp
_MARK = string(RESET_MARK)
_FIRED = tuple(string(guard) for guard in GUARDS if guard)
_MARK_AT = slice(_STAMP.size, _STAMP.size + len(_MARK))


class Verdict(Enum):
    """What a state is whose stamp does not follow the one before."""

    SERIES = auto()
    FOREIGN = auto()
    ANOTHER_RUN = auto()
    OPEN = auto()


class Published:
    """The stamps [ns] of a topic, by the time [ns] at which each was published."""

    def __init__(self) -> None:
        self._times: list[int] = []
        self._stamps: list[int] = []

    def add(self, time: int, stamp: int) -> None:
        """Append one that was published after all others."""
        self._times.append(time)
        self._stamps.append(stamp)

    def around(self, time: int) -> tuple[int, int]:
        """Return the last stamp up to ``time`` and the first after it; 0 where there is none."""
        at = bisect(self._times, time)
        return (self._stamps[at - 1] if at else 0,
                self._stamps[at] if at < len(self._stamps) else 0)

    def forget(self) -> None:
        """Keep the last of many."""
        if len(self._times) > 2 * KEPT:
            del self._times[:-KEPT], self._stamps[:-KEPT]


class Timeline:
    """
    The order of one run of ``joint``, '' for any; ``step_ns`` is its sampling period.

    ``alone`` tells whether no second plant publishes states; ``controller`` is the full name of
    the node that answers them.

    ``missing`` counts samples without their state, states without their command behind the first
    answered one, and commands without the event that they tell of; ``repeated`` the dropped
    messages; ``foreign`` the states that are not of the series; ``taken`` the states that have
    been taken. ``newest`` is the stamp [ns] of the newest state, ``commanded`` that of the last
    command, ``reached`` of the last state whose command is there too, 0 before, ``awaited`` of
    the first command that waits for its event, 0 for none. ``begun`` has the stamp of the first
    command of each controller that came in mid-run, where the middleware numbers the messages of
    a writer (``numbered``). ``over`` tells that the next state is the first of another run.
    """

    def __init__(self, step_ns: int, joint: str = '', alone: Callable[[], bool] = lambda: True,
                 controller: str = '') -> None:
        self.missing = self.repeated = self.foreign = self.taken = 0
        self.newest = self.commanded = self.reached = self.awaited = 0
        self.begun: list[int] = []
        self.over = self.numbered = False
        self.step_ns = step_ns
        self._joint = string(joint) if joint else b''
        self._alone = alone
        self._controller = string(controller)
        self._waiting: list[Entry] = []
        self._unstamped: list[tuple[int, int, bytes]] = []
        self._published = {STATES: Published(), COMMANDS: Published()}
        self._before = dict.fromkeys((STATES, EVENTS, COMMANDS), b'')
        self._last_state = self._last_event = 0
        self._told = 0
        self._numbers: list[int] = []
        self._answered = self._met = False

    def add(self, index: int, messages: Sequence[Taken], everything: bool = False) -> int:
        """
        Add messages of a topic; returns how many were taken.

        Fewer than all are taken when the next one is of another run (``over``), or may be, which
        the state after it will show; with ``everything`` no state comes after.
        """
        if index == STATES:
            return self._add_states(messages, everything)
        if index not in self._before:
            self._unstamped += [(info['source_timestamp'], index, raw) for raw, info in messages]
            return len(messages)
        latest = self.newest + SECOND if self.newest else 2**63
        for raw, info in messages:
            told = stamp_of(raw)
            stamp = min(told or self.commanded or self.newest, latest)
            # the first command of a newcomer may be the last one of its predecessor again
            if index == COMMANDS and self._is_first(info['publication_sequence_number']):
                self.begun.append(stamp)
            if raw == self._before[index]:
                self.repeated += 1
                continue
            if index == COMMANDS and told:
                self.commanded = stamp
                self._published[COMMANDS].add(info['source_timestamp'], stamp)
            if index == EVENTS:
                self._told = max(self._told, stamp)
            self._before[index] = raw
            self._waiting.append((stamp, index, raw))
        return len(messages)

    def _is_first(self, number: int) -> bool:
        """
        Tell by the ``number`` of a command whether it is the first one here of a newcomer.

        It need not be 1: who has just been found may have sent some before. So it is the one that
        no known writer has come up to.
        """
        if number == UNNUMBERED:
            return False
        self.numbered = True
        earlier = [last for last in self._numbers if last < number]
        if earlier:
            self._numbers.remove(max(earlier))
        self._numbers.append(number)
        return not earlier and len(self._numbers) > 1

    def give_up(self) -> None:
        """Await no event of the commands that are there."""
        self._told = max(self._told, self.commanded)

    def _add_states(self, messages: Sequence[Taken], everything: bool) -> int:
        for number, (raw, info) in enumerate(messages):
            if raw == self._before[STATES]:
                self.repeated += 1
                continue
            stamp, verdict = stamp_of(raw), Verdict.SERIES
            if stamp != self.newest + self.step_ns or self._joint not in raw:
                verdict = self._verdict(stamp, raw, messages[number + 1:], everything)
                if verdict is Verdict.ANOTHER_RUN and not self._alone():
                    verdict = Verdict.FOREIGN
            if verdict is Verdict.SERIES:
                self._before[STATES], self.newest = raw, stamp
                self._waiting.append((stamp, STATES, raw))
                self._published[STATES].add(info['source_timestamp'], stamp)
            elif verdict is Verdict.FOREIGN:
                self.foreign += 1
                self._waiting.append((self.newest, FOREIGN, raw))
            else:
                self.over = verdict is Verdict.ANOTHER_RUN
                return number
        return len(messages)

    def _verdict(self, stamp: int, raw: bytes, after: Sequence[Taken], everything: bool
                 ) -> Verdict:
        if not stamp or self._joint not in raw:
            return Verdict.FOREIGN
        if not self.newest:
            return Verdict.SERIES
        back = stamp <= self.newest
        if raw[_MARK_AT] == _MARK:
            return Verdict.ANOTHER_RUN
        if not back and stamp <= self.newest + SECOND:
            return Verdict.SERIES
        for other, _ in after:
            if self._joint in other:
                borne_out = other == raw or self.newest != stamp == (
                    stamp_of(other) - self.step_ns)
                return (Verdict.FOREIGN if not borne_out
                        else Verdict.ANOTHER_RUN if back else Verdict.SERIES)
        return Verdict.FOREIGN if everything else Verdict.OPEN

    def take(self, everything: bool = False) -> list[Entry]:
        """
        Return in order what is in its place for good, or ``everything``.

        That is up to `reached`, and what is too old for an answer yet to come.
        """
        self._place_unstamped(everything)
        self._waiting.sort(key=itemgetter(0, 1))
        ready, state, self.awaited = 0, self._last_state, 0
        for number, (stamp, index, raw) in enumerate(self._waiting):
            if index == STATES:
                state = stamp
            elif index == COMMANDS and stamp == state and not self.awaited:
                if stamp > self._told and fired(raw):
                    self.awaited = stamp
                else:
                    ready, self.reached = number + 1, stamp
            if stamp < self.newest - UNANSWERED * self.step_ns:
                ready = number + 1
        if everything:
            ready = len(self._waiting)
        taken, self._waiting = self._waiting[:ready], self._waiting[ready:]
        self._count_missing(taken)
        if self.foreign:
            taken = [(stamp, max(index, STATES), raw) for stamp, index, raw in taken]
        return taken

    def _place_unstamped(self, everything: bool) -> None:
        """Give a stamp to what has a state and a command after it, or to ``everything``."""
        left = []
        for time, index, raw in self._unstamped:
            (before, after), (_, answer) = (
                published.around(time) for published in self._published.values())
            if not everything and not (after and answer):
                left.append((time, index, raw))
                continue
            own = raw[_NODE_AT:].startswith(self._controller)
            self._waiting.append(((own and answer) or before or after, index, raw))
        self._unstamped = left
        for published in self._published.values():
            published.forget()

    def _count_missing(self, entries: Sequence[Entry]) -> None:
        for stamp, index, raw in entries:
            if index == STATES:
                self.taken += 1
                if self._last_state:
                    self.missing += max(0, (stamp - self._last_state) // self.step_ns - 1)
                self.missing += self._met and not self._answered
                self._met = self._met or raw[_MARK_AT] == _MARK
                self._answered, self._last_state = False, stamp
            elif index == EVENTS:
                self._last_event = stamp
            elif index == COMMANDS and stamp == self._last_state:
                self.missing += fired(raw) and not self._answered and self._last_event != stamp
                self._answered = self._met = True


def fired(raw: bytes) -> bool:
    """Tell whether a command names a guard."""
    return raw.startswith(_FIRED, _STAMP.size)


def stamp_of(raw: bytes) -> int:
    """Return the stamp [ns] at the front of a message; 0 for none."""
    if len(raw) < _STAMP.size or raw[:4] != LITTLE_ENDIAN_CDR:
        return 0
    _, sec, nanosec = _STAMP.unpack_from(raw)
    return int(sec * SECOND + nanosec)
