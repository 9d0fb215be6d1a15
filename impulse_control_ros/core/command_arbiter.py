"""Which command acts on the plant: its part of core/protocol.py, with its timers."""

from impulse_control_ros.core.protocol import (
    after_reset,
    after_silence,
    CommandHeader,
    FOREIGN,
    judge_command,
    StateHeader,
    Verdict,
)

SOON = 0.02  # s; the least time after which an unanswered state is published again
ROUND_TRIPS = 20
LONGEST_LOOK = 0.1  # s between two looks; a process that was stopped longer heard nobody
Stamp = tuple[int, int]


class CommandArbiter:
    """
    The commands for the plant of ``run``, which waits for them in ``lockstep``.

    ``header`` is that of its states. ``effort`` [N] is what acts, ``awaiting`` whether the
    present state is yet to be answered, and ``silent`` [s] how long nobody has answered it.
    ``counts`` has the commands by what became of them. Times ``now`` are in s, of one clock.
    """

    def __init__(self, run: str, lockstep: bool, now: float) -> None:
        self.header = StateHeader(run)
        self.effort, self.silent, self.awaiting = 0.0, 0.0, False
        self.counts = {'accepted': 0, 'late': 0} | dict.fromkeys(
            (verdict.name.lower() for verdict in Verdict if verdict is not Verdict.ACTS), 0)
        self._lockstep = lockstep
        self._stamp: Stamp = (-1, 0)
        self._newest: Stamp = (0, 0)  # that has acted, without lockstep
        self._asked_at = self._looked_at = now
        self._round_trip = 0.0  # s; follows the median of the time from state to command

    def expect(self, stamp: Stamp, now: float) -> None:
        """Take the command for the state of ``stamp``, which is published ``now``."""
        self._stamp, self._asked_at, self.awaiting = stamp, now, self._lockstep

    def take(self, sender: CommandHeader, stamp: Stamp, effort: float, now: float) -> Verdict:
        """Take a command; what acts is from then on the ``effort`` [N]."""
        before = self.header
        is_due = (self.awaiting and stamp == self._stamp if self._lockstep
                  else self._is_newest(stamp, sender))
        self.header, verdict = judge_command(before, sender, is_due)
        if verdict is not Verdict.ACTS:
            self.counts[verdict.name.lower()] += 1
            if verdict is Verdict.STALE and sender.author == before.controller:
                self.silent = 0.0
            return verdict
        self.counts['accepted'] += 1
        self.effort, self.silent, self.awaiting = effort, 0.0, False
        if self._lockstep:
            trip, took = self._round_trip, now - self._asked_at
            self._round_trip = max(1e-5, trip * (1.02 if took > trip else 0.98))
        elif stamp != (0, 0):
            self._newest = stamp
            self.counts['late'] += sender.author != FOREIGN and stamp < self._stamp
        return verdict

    def _is_newest(self, stamp: Stamp, sender: CommandHeader) -> bool:
        """Tell whether a command is later than those of its author that have acted."""
        if stamp == (0, 0):  # it answers no state
            return True
        known = sender.author == self.header.controller
        if sender.author == FOREIGN:
            return not known or stamp >= self._newest
        return stamp <= self._stamp and not (known and stamp <= self._newest)

    @property
    def patience(self) -> float:
        """The time [s] after which an unanswered state is published again."""
        return max(SOON, ROUND_TRIPS * self._round_trip)

    def look(self, now: float) -> None:
        """Count the time in which nobody answers; a time in which we were stopped is none."""
        self.silent += min(now - self._looked_at, LONGEST_LOOK)
        self._looked_at = now

    def drop_silent(self, timeout: float) -> bool:
        """Name nobody once the active controller has been silent; returns whether it was."""
        if self._lockstep and not self.awaiting:
            return False  # the next state names the author of the command that acts
        before, self.header = self.header, after_silence(self.header, self.silent, timeout)
        return before is not self.header and before.controller != ''

    def reset(self) -> None:
        """Begin the next episode; nothing acts on the axis until the next command."""
        self.header, self.effort = after_reset(self.header), 0.0
