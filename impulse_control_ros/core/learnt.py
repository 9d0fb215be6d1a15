"""The values that the supervision of a law has learnt, in SI units."""

from dataclasses import dataclass
import math

import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.jump import mass_scale

scale_of = getattr(mass_scale, 'py_func', mass_scale)  # needs no compiling


@dataclass(frozen=True, kw_only=True)
class Learnt:
    """
    The learnt values of an axis at a sample.

    ``mass`` [kg] is the median of the masses from the last jumps, ``mass_spread`` [kg] the
    difference between the largest and the least of them, and ``delay`` [s] the median of the times
    from an impulse to its jump; all are nan before the first jump. ``used_mass`` [kg] is the mass
    that impulses are computed for, ``velocity_noise`` [m/s] a standard deviation, and
    ``suspended`` [s] the time left until impulses act again. ``is_suspended_anew`` is true at the
    sample at which a suspension begins.
    """

    mass: float
    mass_spread: float
    used_mass: float
    delay: float
    velocity_noise: float
    suspended: float
    is_suspended_anew: bool


def learnt_from(memory: np.ndarray, gains: ControlGains) -> Learnt:
    """Read a ``memory`` of shape (1,), dtype SUPERVISION, after a sample with these ``gains``."""
    learnt, suspension = memory['learnt'], memory['suspension']
    left = float(suspension['left'][0])
    masses = learnt['masses'][0, : int(learnt['jumps'][0])].tolist()
    is_known = len(masses) > 0
    return Learnt(
        mass=gains.m * float(learnt['mass'][0]) if is_known else math.nan,
        mass_spread=gains.m * (max(masses) - min(masses)) if is_known else math.nan,
        used_mass=gains.m * (float(scale_of(learnt[0], gains.options)) if is_known else 1.0),
        delay=gains.time_step * float(learnt['delay'][0]) if is_known else math.nan,
        velocity_noise=float(memory['noise']['velocity']['sd'][0]),
        suspended=gains.time_step * left,
        is_suspended_anew=left > 0.0 and left == float(suspension['back_off'][0]),
    )
