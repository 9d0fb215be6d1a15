"""
Time as an integer tick, and its conversion to nanoseconds and ROS stamps.

====================  =====================  ====
symbol                name                   unit
====================  =====================  ====
k                     tick                   1
dt                    time_step              s
dt in nanoseconds     step_ns                ns
====================  =====================  ====

Sums of ``dt`` and ``int(k * dt * 1e9)`` lose nanoseconds; integers do not.
"""

import math

from impulse_control_ros.core.parameter import refusal

SECOND = 1_000_000_000


def nanoseconds(seconds: float, name: str) -> int:
    """Return ``seconds`` in nanoseconds; raise `ParameterError` if they are not whole."""
    whole = round(seconds * SECOND)
    if abs(whole - seconds * SECOND) > 1e-3:
        raise refusal(name, seconds, 'a whole number of nanoseconds [s]')
    return whole


def to_ns(sec: int, nanosec: int) -> int:
    """Return a ROS stamp in nanoseconds."""
    return sec * SECOND + nanosec


def to_stamp(ns: int) -> tuple[int, int]:
    """Return nanoseconds as a ROS stamp (s, ns)."""
    return divmod(ns, SECOND)


def stamp(tick: int, start_ns: int, step_ns: int) -> tuple[int, int]:
    """Return the ROS stamp (s, ns) of sample ``tick``: start + tick * step, exactly."""
    return to_stamp(start_ns + tick * step_ns)


def ticks(duration: float, time_step: float) -> int:
    """Return the number of steps in ``duration`` seconds, rounded to the nearest."""
    return round(duration / time_step)


def require_duration(duration: float) -> None:
    """Raise `ParameterError` unless ``duration`` [s] is positive and finite."""
    if not 0.0 < duration < math.inf:
        raise refusal('duration', duration, '> 0 and finite [s]')


def samples_between(rate: float, time_step: float) -> int:
    """Return the number of samples between messages at ``rate`` [Hz], 0 for no messages."""
    return max(1, round(1.0 / (rate * time_step))) if rate else 0


def seconds(stamp_ns: int) -> str:
    """Format a stamp [ns] in seconds, with all digits."""
    return f'{stamp_ns // SECOND}.{stamp_ns % SECOND:09d}'


class SampleClock:
    """
    A clock of samples ``step_ns`` apart, from ``start_ns`` on.

    Before the first sample, ``tick`` is -1 and ``stamp`` (s, ns) is the stamp of the first.
    """

    def __init__(self, start_ns: int, step_ns: int) -> None:
        self.step_ns = step_ns
        self.start_at(start_ns)

    def start_at(self, start_ns: int) -> None:
        """Restart before the first sample, which will have the stamp ``start_ns``."""
        self.start_ns = start_ns
        self.tick, self.stamp = -1, stamp(0, start_ns, self.step_ns)

    def go_to(self, tick: int) -> None:
        """Go to the sample ``tick``."""
        self.tick, self.stamp = tick, to_stamp(self.start_ns + tick * self.step_ns)

    def seconds(self, ahead: int = 0) -> str:
        """Return the stamp, in seconds, ``ahead`` samples after the present one."""
        return seconds(self.start_ns + max(0, self.tick + ahead) * self.step_ns)

    def tick_at(self, stamp_ns: int) -> int:
        """Return the tick of a stamp [ns]."""
        return (stamp_ns - self.start_ns) // self.step_ns

    @property
    def elapsed(self) -> float:
        """Simulated seconds since the first sample."""
        return max(0, self.tick) * self.step_ns / SECOND
