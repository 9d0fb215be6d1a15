"""
Time as an integer tick, the one place that turns it into nanoseconds and ROS stamps.

====================  =====================  ====
symbol                name                   unit
====================  =====================  ====
k                     tick                   1
dt                    time_step              s
dt in nanoseconds     step_ns                ns
====================  =====================  ====

Sums of ``dt`` and ``int(k * dt * 1e9)`` lose nanoseconds; integers do not.
"""

from impulse_control_ros.core.parameter import refusal

SECOND = 1_000_000_000


def nanoseconds(seconds: float, name: str) -> int:
    """Return ``seconds`` as whole nanoseconds; raise `ParameterError` when it is none."""
    whole = round(seconds * SECOND)
    if abs(whole - seconds * SECOND) > 1e-3:
        raise refusal(name, seconds, 'a whole number of nanoseconds [s]')
    return whole


def stamp(tick: int, start_ns: int, step_ns: int) -> tuple[int, int]:
    """Return the ROS stamp (s, ns) of sample ``tick``: start + tick * step, exactly."""
    return divmod(start_ns + tick * step_ns, SECOND)


def ticks(duration: float, time_step: float) -> int:
    """Return the number of steps in ``duration`` seconds, rounded to the nearest."""
    return round(duration / time_step)
