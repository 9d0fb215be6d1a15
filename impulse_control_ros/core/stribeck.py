"""
Friction that is larger at rest than in motion (Stribeck), stepped exactly.

    F(v) = F_c + (F_s - F_c) max(0, 1 - abs(v) / v_s)

======  =======  ====  =============================================
symbol  name     unit  meaning
======  =======  ====  =============================================
F_s     F_s      N     friction at rest, what it takes to break loose
v_s     v_s      m/s   Stribeck velocity, from which on it is F_c
======  =======  ====  =============================================

The friction falls linearly with speed, not exponentially. Below v_s it is therefore Coulomb
friction F_s with the damping d - (F_s - F_c) / v_s, which may be negative; above v_s the model of
core/plant.py applies. Each piece and its end have closed forms: with z = r t, r damping over mass,
and a the acceleration at the start of the piece, v reaches w at t = -log1p(-(w - v) r / a) / r.
Within a sample the velocity is monotone (its equation is autonomous and of first order), so there
are at most four pieces: down to v_s, down to the stop, up to v_s, beyond.
"""

from dataclasses import dataclass
import math

from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.parameter import parameter, Parameters

PIECES = 4
LEAST = 1e-290  # m/s; a lower speed counts as rest: its deceleration is too small to divide by
SHORT = 1e-2  # value of abs(z) below which a series is more accurate than exp


@dataclass(frozen=True, kw_only=True)
class Stribeck(Parameters):
    """Friction at rest and at low speed, in addition to F_c."""

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
    """Return the time until the velocity has changed by ``change``, inf if it never does."""
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

    All arguments are scalars in SI units: ``friction`` is F_c, ``rest_friction`` F_s and ``fast``
    v_s. Returns (position, velocity).
    """
    slope = (rest_friction - friction) / fast
    if abs(velocity) < LEAST:
        velocity = 0.0
    for _ in range(PIECES):
        if velocity == 0.0 and abs(force) <= rest_friction:
            break
        direction = sign(velocity) if velocity != 0.0 else sign(force)
        speed, push = abs(velocity), force * direction
        # At v_s, the motion determines which piece follows; the friction there is F_c.
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
