"""Selection of the command that acts on the plant: core/protocol.py with its timers."""

from impulse_control_ros.core.age import Age, AgeLimit
from impulse_control_ros.core.protocol import (
    after_reset,
    after_silence,
    CommandHeader,
    FOREIGN,
    judge_command,
    StateHeader,
    Verdict,
)
from impulse_control_ros.core.silence import Silence
from impulse_control_ros.core.tick import SECOND, to_ns

SOON = 0.02  # s; minimum time before an unanswered state is republished
ROUND_TRIPS = 20
Stamp = tuple[int, int]


class CommandArbiter:
    """
    Selects the commands for the plant of ``run``; in ``lockstep`` the plant waits for them.

    ``header`` is the header of the plant's states and ``effort`` [N] the applied effort, of a
    foreign controller if ``is_foreign``.
    ``awaiting`` is true while the present state is unanswered; ``silence`` measures how long.
    ``counts`` counts the commands by outcome. All times ``now`` [s] come from one clock.
    Without lockstep, a command acts up to the ``age`` limit, by the stamps of plant and command; a
    command without a known age counts as new when it arrives.
    """

    def __init__(self, run: str, lockstep: bool, now: float) -> None:
        self.header = StateHeader(run)
        self.effort, self.awaiting, self.silence = 0.0, False, Silence(now)
        self.counts = {'accepted': 0, 'late': 0} | dict.fromkeys(
            (verdict.name.lower() for verdict in Verdict if verdict is not Verdict.ACTS), 0
        )
        self.age, self.is_foreign = AgeLimit(), False
        self._lockstep, self._any_clock = lockstep, False
        self._stamp: Stamp = (-1, 0)
        self._newest: Stamp = (0, 0)  # stamp of the newest applied command, without lockstep
        self._acts_since = 0  # ns of the plant, without lockstep
        self._asked_at = now
        self._round_trip = 0.0  # s; tracks the median time from state to command

    def expect(self, stamp: Stamp, now: float) -> None:
        """Expect the command for the state of ``stamp``, published ``now``."""
        self._stamp, self._asked_at, self.awaiting = stamp, now, self._lockstep
        acted = (to_ns(*stamp) - self._acts_since) / SECOND
        if self.age.limit and not self._lockstep and acted > self.age.limit:
            self.effort = 0.0

    def take(self, sender: CommandHeader, stamp: Stamp, effort: float, now: float) -> Verdict:
        """Take a command; if accepted, its ``effort`` [N] acts from now on."""
        before = self.header
        judge = self._is_answer if self._lockstep else self._is_newest
        header, verdict = judge_command(before, sender, judge(stamp, sender))
        if verdict is Verdict.ACTS and not self._lockstep and self._is_old(stamp):
            verdict = Verdict.OLD
        if verdict is not Verdict.ACTS:
            self.counts[verdict.name.lower()] += 1
            # a foreign controller with wrong stamps would be stale for ever
            if verdict is Verdict.STALE and sender.author == before.controller != FOREIGN:
                self.silence.hear()
            return verdict
        self.header = header
        self.counts['accepted'] += 1
        self.effort, self.awaiting = effort, False
        self.is_foreign = sender.author == FOREIGN
        self.silence.hear()
        if self._lockstep:
            trip, took = self._round_trip, now - self._asked_at
            self._round_trip = max(1e-5, trip * (1.02 if took > trip else 0.98))
        elif stamp != (0, 0):
            self._newest = stamp
            self.counts['late'] += sender.author != FOREIGN and stamp < self._stamp
        return verdict

    def _is_answer(self, stamp: Stamp, sender: CommandHeader) -> bool:
        """Return whether a command answers the present state."""
        is_later = self._any_clock and sender.author == FOREIGN and stamp > self._stamp
        return self.awaiting and (stamp == self._stamp or is_later)

    def _is_newest(self, stamp: Stamp, sender: CommandHeader) -> bool:
        """Return whether a command is newer than the last one applied from its author."""
        if stamp == (0, 0):  # the command answers no state
            return True
        known = sender.author == self.header.controller
        if sender.author == FOREIGN:
            return not known or stamp >= self._newest
        return stamp <= self._stamp and not (known and stamp <= self._newest)

    def _is_old(self, stamp: Stamp) -> bool:
        """Return whether a command is too old; if not, record since when it acts."""
        present, made = to_ns(*self._stamp), to_ns(*stamp)
        found = self.age.judge(made, present) if made else Age.UNKNOWN
        if found is not Age.OLD:
            self._acts_since = min(made, present) if found is Age.FRESH else present
        return found is Age.OLD

    def let_time_pass(self, for_manager: bool) -> None:
        """
        Leave the present state unanswered, with the effort held, if a manager waits for time.

        Its hardware may stamp by the wall clock; its later stamps then count in lockstep.
        """
        self._any_clock = for_manager
        if for_manager:
            self.awaiting = False
            self.silence.hear()

    @property
    def patience(self) -> float:
        """The time [s] after which an unanswered state is republished."""
        return max(SOON, ROUND_TRIPS * self._round_trip)

    def drop_silent(self, timeout: float) -> bool:
        """Drop the active controller if silent for ``timeout`` [s]; return whether it was."""
        if self._lockstep and not self.awaiting:
            return False  # the next state names the author of the command that acts
        before = self.header
        self.header = after_silence(before, self.silence.seconds, timeout)
        return before is not self.header and before.controller != ''

    def reset(self) -> None:
        """Begin the next episode; the effort is 0 N until the next command."""
        self.header, self.effort = after_reset(self.header), 0.0
