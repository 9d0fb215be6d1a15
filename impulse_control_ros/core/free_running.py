"""How a controller monitors a plant that does not wait for it."""

from impulse_control_ros.core.tick import SECOND

LEAST_ANSWERED, RATE_TOLERANCE = 100, 0.2


class StateTimeout:
    """
    Detects that states have stopped arriving, while the plant holds the last effort.

    ``deserted`` is true from then until the next state.
    """

    def __init__(self) -> None:
        self.deserted = False
        self._answered, self._since = 0, 0.0

    def forget(self) -> None:
        """Restart with the next answer."""
        self.deserted, self._answered = False, 0

    def is_due(self, answered: int, now: float, timeout: float) -> bool:
        """Return True once per ``timeout`` [s] without a state; ``answered`` counts the states."""
        if answered != self._answered:
            self._answered, self._since, self.deserted = answered, now, False
            return False
        if not answered or now < self._since + timeout:
            return False
        self._since, self.deserted = now, True
        return True


class StateRate:
    """Counts lost states and checks the rate at which states arrive."""

    def __init__(self, step_ns: int) -> None:
        self.step_ns = step_ns
        self._first = self._answered = self._lost_before = 0

    def begin(self, stamp: int, answered: int, last: int) -> None:
        """Begin with the ``stamp`` [ns] of a first state; the gap since ``last`` is not a loss."""
        self._lost_before = self.lost(last, answered)
        self._first, self._answered = stamp, answered

    def lost(self, stamp: int, answered: int) -> int:
        """Return the number of states lost up to ``stamp`` [ns], if ``answered`` have arrived."""
        steps, count = (stamp - self._first) // self.step_ns, answered - self._answered
        return self._lost_before + (max(0, steps + 1 - count) if count else 0)

    def wrong(self, stamp: int, answered: int) -> str:
        """Return a warning if the state rate is not 1 / time_step: this alters impulse areas."""
        count = answered - self._answered
        if count < LEAST_ANSWERED:
            return ''
        ratio = (stamp - self._first) / self.step_ns / (count - 1)
        if abs(ratio - 1.0) <= RATE_TOLERANCE:
            return ''
        step = self.step_ns / SECOND
        return (
            f'states arrive every {ratio * step:g} s on average, but time_step = {step:g} s: '
            'time_step is wrong, or states are lost'
        )
