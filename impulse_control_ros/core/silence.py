"""How long a peer has been silent."""

LONGEST_LOOK = 0.1  # s


class Silence:
    """
    Measures how long a peer has been silent: ``seconds``, as of the last `look`.

    A look adds at most LONGEST_LOOK, because a stopped process cannot hear its peers.
    """

    def __init__(self, now: float) -> None:
        self.seconds = 0.0
        self._looked_at = now

    def look(self, now: float) -> float:
        """Add the time up to ``now`` [s] of a monotonic clock; return ``seconds``."""
        self.seconds += min(now - self._looked_at, LONGEST_LOOK)
        self._looked_at = now
        return self.seconds

    def hear(self) -> None:
        """Restart at 0, when the peer is heard."""
        self.seconds = 0.0
