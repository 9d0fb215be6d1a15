"""Findings on a set of gains: legal values that are unwise, with the right value beside them."""

import math

from impulse_control_ros.core.impulse import Controller


def critical_damping(gains: Controller) -> float:
    """Return the D [N s/m] with (d_bar + D)^2 = 4 m K, section III-C before (20)."""
    return 2.0 * math.sqrt(gains.m * gains.K) - gains.d_bar


def findings(gains: Controller) -> list[str]:
    """Return one sentence for each unwise value of ``gains``; none when all is well."""
    right = critical_damping(gains)
    if math.isclose(gains.D, right, rel_tol=1e-6, abs_tol=1e-9):
        return []
    least = gains.d_bar**2 / (4.0 * gains.m)
    remedy = f'D = {right:g} N s/m is' if right >= 0 else (
        f'no D is, for d_bar alone overdamps; K = {least:g} N/m with D = 0 is')
    return [f'D = {gains.D:g} N s/m is not critically damped with d_bar = {gains.d_bar:g} N s/m '
            f'((d_bar + D)^2 != 4 m K): {remedy}']
