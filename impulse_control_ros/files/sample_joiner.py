"""
Join the messages of one run on several topics, sample by sample.

A sample is complete when it has its state, the command that answers the state, and the event that
the command announces. It is released once the next state has arrived, which names the author of
the accepted command. Within a sample the order is: parameters, state, event, command, and then
unstamped messages, such as ``damping``, which follow the last state published before them.

The joiner waits for a missing message until its author has sent a later one, or until `give_up`;
the message then counts as missing. Duplicates count as repeated. Messages of another run or of a
foreign peer (core/protocol.py) count as foreign; those of another run are left out, those of
foreign peers kept.
"""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from impulse_control_ros.core.protocol import FOREIGN, parse_node, parse_state, WINDOW
from impulse_control_ros.files.cdr import read_header, string
from impulse_control_ros.files.sample_queues import (
    Answer,
    AnswerQueue,
    Entry,
    StampedReader,
    UnstampedQueue,
)

STATES, EVENTS, COMMANDS, PARAMETERS = range(1, 5)  # channels, as files/topics.py orders them


class RecordedPlant(NamedTuple):
    """The plant of a run; ``run`` is '' if foreign, ``lockstep`` is true if it waits."""

    run: str
    joint: str
    step_ns: int
    lockstep: bool


class SampleJoiner:
    """
    Joins the messages of the run of ``plant``.

    ``newest`` is the stamp [ns] of the newest state, ``reached`` the stamp of the last complete
    sample. ``heard`` counts the received states, including duplicates. ``other`` is another run
    that was heard, None if none. ``counts`` has the released states and the missing, repeated and
    foreign messages.
    """

    def __init__(self, plant: RecordedPlant) -> None:
        self.plant = plant
        self.newest = self.reached = self.heard = 0
        self.other: str | None = None
        self.counts = {'states': 0, 'missing': 0, 'repeated': 0, 'foreign': 0}
        self._read, self._joint = StampedReader(parse_state).read, string(plant.joint)
        self._states: deque[tuple[int, str, bytes]] = deque()  # stamp, the controller it names
        self._named = ''  # in the newest copy of the newest state
        is_free = bool(plant.run) and not plant.lockstep
        self._answers = {
            COMMANDS: AnswerQueue(plant.run, is_free),
            EVENTS: AnswerQueue(plant.run, is_free),
        }
        self._unstamped = UnstampedQueue()
        self._loose: list[Entry] = []  # belongs to a state without answering it
        self._done = 0  # stamp of the last released state
        self._answered = False  # whether a state with its command was released

    # -- input --------------------------------------------------------------------------

    def add(self, channel: int, raw: bytes, time: int) -> None:
        """Add a message that was published at ``time`` [ns]."""
        if channel == STATES:
            self._add_state(raw, time)
        elif channel in self._answers:
            why_not, stamp = self._answers[channel].add(raw, self._done)
            if why_not == 'other_clock':
                self._unstamped.add(time, channel, raw)
            elif why_not == 'unstamped':  # follows the author's last one with a stamp
                self._loose.append((stamp, channel, raw))
            elif why_not:
                self.counts[why_not] += 1
        elif channel != PARAMETERS:
            self._unstamped.add(time, channel, raw)
        else:
            stamp, node = read_header(raw)
            run, entry = parse_node(node.decode(errors='replace')).run, (stamp, channel, raw)
            if run == self.plant.run and entry not in self._loose:
                self._loose.append(entry)

    def _add_state(self, raw: bytes, time: int) -> None:
        (header, stamp), run = self._read(raw), self.plant.run
        ours = header.run == run and (run or self._joint in raw)
        if ours and stamp >= self.newest:
            self._named = header.controller
        if ours and stamp > self.newest:
            self.heard += 1
            self.newest = stamp
            self._states.append((stamp, header.controller, raw))
            self._unstamped.add_state(time, stamp)
        elif ours and (run or stamp == self.newest):
            self.heard += 1
            self.counts['repeated'] += 1
        else:  # another run, or a foreign plant whose time went back
            self.counts['foreign'] += 1
            if header.run or self._joint in raw:
                self.other = header.run
            if not header.run:
                self._loose.append((self.newest, STATES, raw))

    @property
    def begun(self) -> bool:
        """Whether a state and a command have arrived."""
        return bool(self._done or (self._states and self._answers[COMMANDS].begun))

    @property
    def newest_command(self) -> int:
        """The stamp [ns] of the newest command that waits for its state; 0 if none does."""
        return max(self._answers[COMMANDS].waiting, default=0)

    def in_flight(self, command: int) -> bool:
        """Whether samples before the newest state, or a ``command`` [ns], are incomplete."""
        return max(self.newest, command) > self.reached + self.plant.step_ns

    @property
    def is_blocked(self) -> bool:
        """Whether a sample is held although a later state has arrived."""
        return len(self._states) > 1

    @property
    def is_replaced(self) -> bool:
        """Whether the awaited author is no longer the active controller."""
        return self.is_blocked and self._answers[COMMANDS].is_replaced(self._states[1][1])

    def forget_early_states(self) -> None:
        """Keep only the newest states, since a plant may run for long without a controller."""
        while len(self._states) > WINDOW:
            self._states.popleft()

    # -- output -------------------------------------------------------------------------

    def take(self, everything: bool = False) -> list[Entry]:
        """Return the complete samples in order, or ``everything`` received."""
        entries: list[Entry] = []
        states = self._states
        self._loose += self._unstamped.placed(everything)
        while states:
            stamp, _, raw = states[0]
            follows = len(states) > 1
            command, event, waits = self._sample(stamp, states[1][1] if follows else self._named)
            # another copy of the last state will name the controller that was heard
            if (waits or not (follows or self._named or not self.plant.lockstep)) and (
                not everything
            ):
                break
            self.reached = max(self.reached, stamp)
            if not (follows or everything):
                break
            states.popleft()
            if command is None and follows and self.plant.lockstep and not self._answered:
                continue  # answered before we joined
            if self._loose:
                entries += self._loose_until(stamp, PARAMETERS)
            entries.append((stamp, STATES, raw))
            if event:
                entries.append((stamp, EVENTS, event.raw))
            if command:
                entries.append((stamp, COMMANDS, command.raw))
            if self._loose:
                entries += self._loose_until(stamp)
            self._account(stamp, command, event, follows)
        if everything:
            for channel in self._answers:
                self._keep_foreign(channel, 2**63)
            entries += self._loose_until(2**63)
        return entries

    def _keep_foreign(self, channel: int, stamp: int) -> None:
        """Drop the answers up to a stamp; keep them in the recording of a foreign plant."""
        others = self._answers[channel].pop_others(stamp)
        if not self.plant.run:
            self._loose += [(early, channel, raw) for early, raw in others]

    def _sample(self, stamp: int, named: str) -> tuple[Answer | None, Answer | None, bool]:
        """Return the command and event of a state, and whether to wait for either."""
        command, is_lost = self._answers[COMMANDS].find(stamp, named)
        if command is None:
            needed = self.plant.lockstep or (named != FOREIGN and (named != '' or self._answered))
            return None, None, needed and not is_lost
        if not command.has_event:
            return command, None, False
        event, is_lost = self._answers[EVENTS].find(stamp, command.author)
        return command, event, event is None and not is_lost

    def give_up(self) -> None:
        """Stop waiting for what the first sample lacks, if a later state has arrived."""
        if self.is_blocked:
            stamp, named = self._states[0][0], self._states[1][1]
            command, _, _ = self._sample(stamp, named)
            self._answers[EVENTS if command else COMMANDS].give_up(
                stamp, command.author if command else named
            )

    def _account(
        self, stamp: int, command: Answer | None, event: Answer | None, follows: bool
    ) -> None:
        """Count a sample and its missing and repeated messages."""
        counts, step = self.counts, self.plant.step_ns
        counts['states'] += 1
        has_gap = stamp != self._done + step
        if self._done and has_gap:
            counts['missing'] += max(0, (stamp - self._done) // step - 1)
        if command is None:
            # the last state and those before the first answer may be unanswered
            counts['missing'] += follows and self._answered
        else:
            self._answered = True
            counts['missing'] += command.has_event and event is None
        self._done = stamp
        for channel, answers in self._answers.items():
            if answers.waiting:
                counts['repeated'] += answers.drop(stamp)
                if has_gap or not self.plant.run:
                    self._keep_foreign(channel, stamp)

    def _loose_until(self, stamp: int, channel: int = 0) -> Iterator[Entry]:
        """Yield the loose messages up to ``stamp``, of one ``channel`` or, if 0, of all."""
        due = [one for one in self._loose if one[0] <= stamp and channel in (0, one[1])]
        if due:
            self._loose = [one for one in self._loose if one not in due]
        return iter(sorted(due, key=lambda one: one[0]))
