"""
Friction that is larger at rest than in motion (Stribeck), stepped exactly.

    F(v) = F_c + (F_s - F_c) max(0, 1 - abs(v) / v_s)

======  =======  ====  =============================================
symbol  name     unit  meaning
======  =======  ====  =============================================
F_s     F_s      N     friction at rest, what it takes to break loose
v_s     v_s      m/s   Stribeck velocity, from which on it is F_c
======  =======  ====  =============================================

The curve falls in a straight line, not in an exponential: so below v_s it is a Coulomb friction
F_s with the damping d - (F_s - F_c) / v_s, which may be negative, and above it the axis of
core/plant.py. Each piece has a closed form, its end too: at z = r t, with r the damping by mass
and a the acceleration at the start of the piece, v reaches w at t = -log1p(-(w - v) r / a) / r.
In one sample the velocity is monotone (its equation is of first order and knows no time), so it
runs through at most four pieces: down to v_s, down to the stop, up to v_s, beyond.
"""

from dataclasses import dataclass
import math

from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.parameter import parameter, Parameters

PIECES = 4
SHORT = 1e-2  # bound of abs(z), below which a series is more exact than exp


@dataclass(frozen=True, kw_only=True)
class Stribeck(Parameters):
    """Friction at rest and at low speed, beside F_c."""

    F_s: float = parameter(
        0.0, 'N', 'friction at rest, F_c or more; 0 for F_c at any speed', lower=0.0
    )
    v_s: float = parameter(
        0.01, 'm/s', 'speed from which on the friction is F_c', lower=0.0, open_lower=True
    )


@compiled
def shapes(z):
    """Return phi1 and phi2 of core/plant.py, for a z of either sign."""
    if abs(z) < SHORT:
        phi2 = 1 / 2 - z * (1 / 6 - z * (1 / 24 - z * (1 / 120 - z * (1 / 720 - z / 5040))))
        return 1.0 - z * phi2, phi2
    phi1 = -math.expm1(-z) / z
    return phi1, (1.0 - phi1) / z


@compiled
def time_to(change, acceleration, rate):
    """Return when the velocity has changed by ``change``; inf when it never has."""
    if sign(change) != sign(acceleration) or change == 0.0:
        return math.inf if change != 0.0 else 0.0
    share = change * rate / acceleration
    if abs(share) < 1e-12:
        return change / acceleration
    return -math.log1p(-share) / rate if share < 1.0 else math.inf


@compiled
def stribeck_step(position, velocity, force, damping, m, friction, rest_friction, fast, duration):
    """
    Step the axis exactly over ``duration`` seconds of constant force and damping.

    Scalars in SI units: F_c, F_s and v_s are ``friction``, ``rest_friction`` and ``fast``.
    Returns (position, velocity).
    """
    slope = (rest_friction - friction) / fast
    for _ in range(PIECES):
        if velocity == 0.0 and abs(force) <= rest_friction:
            break
        direction = sign(velocity) if velocity != 0.0 else sign(force)
        speed, push = abs(velocity), force * direction
        # On the border the piece is the one that the motion leads into; the friction is F_c.
        slow = speed < fast or (speed == fast and push - friction - damping * speed < 0.0)
        level, rate = (rest_friction, damping - slope) if slow else (friction, damping)
        rate /= m
        acceleration = (push - level) / m - rate * speed
        end = 0.0 if slow and acceleration < 0.0 else fast
        leaves = speed >= fast and acceleration >= 0.0
        until = math.inf if leaves else time_to(end - speed, acceleration, rate)
        time = min(until, duration)
        phi1, phi2 = shapes(rate * time)
        position += direction * (speed * time + acceleration * time * time * phi2)
        if until > duration:
            return position, direction * (speed + acceleration * time * phi1)
        velocity = direction * end + 0.0  # no -0
        duration -= until
    return position, velocity
