"""Selection of the states that a controller answers: core/protocol.py with its timer."""

import math

from impulse_control_ros.core.protocol import (
    Answered,
    judge_foreign_state,
    judge_state,
    Reply,
    StateHeader,
)


class StateArbiter:
    """
    Selects the states that the controller ``own_id`` answers; they are ``step_ns`` apart.

    ``run`` is the run it answers, '' for a foreign plant and None before the first. ``stamp``
    [ns] is that of the last answered state, 0 if the next answer starts with an empty memory.
    Times ``now`` are in s, of one clock.
    """

    def __init__(self, own_id: str, step_ns: int) -> None:
        self.run: str | None = None
        self.stamp = 0
        self._own_id, self._step_ns = own_id, step_ns
        self._episode = 0
        self._heard_at = -math.inf
        self._named: StateHeader | None = None  # last header, if it names us in lockstep
        self._due = 0

    def follows(self, header: StateHeader, stamp: int, now: float) -> bool:
        """Accept the usual case fast: the next state in lockstep, which names us."""
        if header is not self._named or stamp != self._due:
            return False
        self.stamp, self._due, self._heard_at = stamp, stamp + self._step_ns, now
        return True

    def judge(self, header: StateHeader, stamp: int, lockstep: bool, now: float) -> Reply:
        """Decide on a state of a plant that waits in ``lockstep``, or of a foreign plant."""
        last, quiet = Answered(self.run, self._episode, self.stamp), now - self._heard_at
        if header.run:
            step = self._step_ns if lockstep else 0
            last, reply = judge_state(self._own_id, last, header, stamp, step, quiet)
        else:
            last, reply = judge_foreign_state(last, stamp, quiet)
        if last.run == header.run:
            self._heard_at = now
        self.run, self._episode, self.stamp = last
        ours = lockstep and header.run == self.run and header.controller == self._own_id
        self._named = header if ours else None
        self._due = self.stamp + self._step_ns
        return reply

    def forget(self) -> None:
        """Answer the next state with an empty memory."""
        self.stamp, self._due = 0, 0
