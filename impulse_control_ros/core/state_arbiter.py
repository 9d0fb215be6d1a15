"""Selection of the states that a controller answers: core/protocol.py with its timer."""

from impulse_control_ros.core.protocol import (
    Answered,
    judge_foreign_state,
    judge_state,
    Reply,
    StateHeader,
)
from impulse_control_ros.core.silence import Silence


class StateArbiter:
    """
    Selects the states that the controller ``own_id`` answers; they are ``step_ns`` apart.

    ``run`` is the answered run, '' for a foreign plant and None before the first. ``stamp`` [ns]
    is the stamp of the last answered state, 0 if none was answered since another controller was
    active. ``silence`` measures the time without a state of the run; ``now`` [s] is monotonic.
    """

    def __init__(self, own_id: str, step_ns: int, now: float) -> None:
        self.run: str | None = None
        self.stamp = 0
        self._own_id, self._step_ns = own_id, step_ns
        self._episode = 0
        self.silence = Silence(now)
        self._afresh = False
        self._named: StateHeader | None = None  # last header, if it names this controller
        self._due = 0

    def follows(self, header: StateHeader, stamp: int) -> bool:
        """Accept the usual case quickly: the next state in lockstep that names this controller."""
        if header is not self._named or stamp != self._due:
            return False
        self.stamp, self._due = stamp, stamp + self._step_ns
        self.silence.hear()
        return True

    def judge(self, header: StateHeader, stamp: int, lockstep: bool) -> Reply:
        """Decide on a state of a plant that waits in ``lockstep``, or of a foreign plant."""
        last, quiet = Answered(self.run, self._episode, self.stamp), self.silence.seconds
        if header.run:
            step = self._step_ns if lockstep else 0
            last, reply = judge_state(self._own_id, last, header, stamp, step, quiet)
        else:
            last, reply = judge_foreign_state(last, stamp, quiet)
        if last.run == header.run:
            self.silence.hear()
        self.run, self._episode, self.stamp = last
        if self._afresh and reply in (Reply.ANSWER, Reply.ANSWER_AFRESH):
            self._afresh, reply = False, Reply.ANSWER_AFRESH
        ours = lockstep and header.run == self.run and header.controller == self._own_id
        self._named = header if ours and not self._afresh else None
        self._due = self.stamp + self._step_ns
        return reply

    def start_afresh(self) -> None:
        """Answer the next new state with an empty memory."""
        self._afresh, self._named = True, None
        self.silence.hear()

    @property
    def is_answering(self) -> bool:
        """Whether the last state was answered, since the last `start_afresh`."""
        return self.stamp != 0 and not self._afresh
