"""The age of a message, as far as its stamp tells it."""

from enum import auto, Enum

from impulse_control_ros.core.tick import SECOND

FARTHEST = 86_400.0  # s


class Age(Enum):
    """The finding on the age of a message."""

    FRESH = auto()
    OLD = auto()
    UNKNOWN = auto()  # the stamp is on another clock


class AgeLimit:
    """
    Judges the age of messages; ``limit`` [s] is the largest that is allowed, 0 for any.

    ``age`` [s] is the age of the last message, ``found`` the finding on it. A stamp that is more
    than ``limit`` ahead of the clock, or more than FARTHEST behind it, is on another clock.
    """

    def __init__(self, limit: float = 0.0) -> None:
        self.limit, self.age = limit, 0.0
        self.found = Age.FRESH

    def judge(self, stamp: int, now: int) -> Age:
        """Judge a message of ``stamp`` when the clock shows ``now``, both in ns."""
        self.age = (now - stamp) / SECOND
        self.found = (
            Age.FRESH
            if not self.limit or -self.limit <= self.age <= self.limit
            else Age.OLD
            if self.limit < self.age <= FARTHEST
            else Age.UNKNOWN
        )
        return self.found

    @property
    def clock_error(self) -> str:
        """A warning if the age of the last message is unknown, else ''."""
        if self.found is not Age.UNKNOWN:
            return ''
        side = 'behind' if self.age > 0.0 else 'ahead of'
        return (
            f'stamps are {abs(self.age):g} s {side} the clock, so ages are unknown: '
            f'max_age = {self.limit:g} s has no effect'
        )
