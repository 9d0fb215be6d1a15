"""What a controller watches of a plant that does not wait for it."""

from impulse_control_ros.core.tick import SECOND

LEAST_ANSWERED, RATE_TOLERANCE = 100, 0.2


class StateTimeout:
    """
    Tells when states stay away: the plant would go on with the last effort.

    ``deserted`` tells that they do.
    """

    def __init__(self) -> None:
        self.deserted = False
        self._answered, self._since = 0, 0.0

    def forget(self) -> None:
        """Begin with the next answer."""
        self.deserted, self._answered = False, 0

    def is_due(self, answered: int, now: float, timeout: float) -> bool:
        """Tell each ``timeout`` [s] without a state; ``answered`` counts those that came."""
        if answered != self._answered:
            self._answered, self._since, self.deserted = answered, now, False
            return False
        if not answered or now < self._since + timeout:
            return False
        self._since, self.deserted = now, True
        return True


class StateRate:
    """How many states have been lost, and whether they come at the right rate."""

    def __init__(self, step_ns: int) -> None:
        self.step_ns = step_ns
        self._first = self._answered = self._lost_before = 0

    def begin(self, stamp: int, answered: int, last: int) -> None:
        """Note the stamp [ns] of a first state: what was since the ``last`` one is not lost."""
        self._lost_before = self.lost(last, answered)
        self._first, self._answered = stamp, answered

    def lost(self, stamp: int, answered: int) -> int:
        """Return how many states are missing up to that of ``stamp``, of those ``answered``."""
        steps, count = (stamp - self._first) // self.step_ns, answered - self._answered
        return self._lost_before + (max(0, steps + 1 - count) if count else 0)

    def wrong(self, stamp: int, answered: int) -> str:
        """Say that states come at another rate than time_step: impulses have another area."""
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
