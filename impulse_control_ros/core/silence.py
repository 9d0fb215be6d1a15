"""How long a peer has been silent."""

LONGEST_LOOK = 0.1  # s


class Silence:
    """
    The time without a word of a peer: ``seconds``, as of the last `look`.

    A look counts at most LONGEST_LOOK: a process that was stopped meanwhile could hear nobody.
    """

    def __init__(self, now: float) -> None:
        self.seconds = 0.0
        self._looked_at = now

    def look(self, now: float) -> float:
        """Count the time up to ``now`` [s], of a monotonic clock; returns ``seconds``."""
        self.seconds += min(now - self._looked_at, LONGEST_LOOK)
        self._looked_at = now
        return self.seconds

    def hear(self) -> None:
        """Begin anew: the peer has said something."""
        self.seconds = 0.0
