"""
Exact solutions, given as arcs (see core/hybrid.py), at any times and on a sampling grid t = k dt.

Over a whole sample of one arc the flow (12) is one affine map, the same for all arcs of one
damping. With h and H of core/flow.py at t = dt, as a change, so that little is rounded:

    e+ = e - w^2 H e + (h v - f s H),    v+ = v - (w^2 H + 2 g h) v - (w^2 h e + f s h).

Products in place of sin, cos and exp. The flow itself is evaluated where an arc starts and every
ANCHOR samples, so that rounding errors do not add up.
"""

import numpy as np

from impulse_control_ros.core.flow import flow, response
from impulse_control_ros.core.jit import kernel

ANCHOR = 16


@kernel()
def evaluate(arcs, axis, gains, times, errors, velocities):
    """Fill ``errors`` and ``velocities`` at ``times``, all (n,): after the jumps of a time."""
    stiffness, friction = gains.K / axis.m, axis.F_c / axis.m
    at = 0
    for i in range(len(times)):
        if times[i] < arcs[at].time:
            at = np.searchsorted(arcs['time'], times[i], 'right') - 1
        while at + 1 < len(arcs) and arcs[at + 1].time <= times[i]:
            at += 1
        arc = arcs[at]
        errors[i], velocities[i] = arc.error, arc.velocity
        if arc.direction != 0.0:
            rate = (arc.damping + gains.D) / (2.0 * axis.m)
            errors[i], velocities[i] = flow(
                arc.error,
                arc.velocity,
                arc.direction,
                rate,
                stiffness,
                friction,
                times[i] - arc.time,
            )


@kernel()
def sample(arcs, axis, gains, time_step, times, errors, velocities):
    """Fill ``times`` k ``time_step``, ``errors`` and ``velocities``, all (n,): after the jumps."""
    stiffness, friction = gains.K / axis.m, axis.F_c / axis.m
    for k in range(len(times)):
        times[k] = k * time_step
    k, damping = 0, 0.0  # no damping is zero (1)
    for j in range(len(arcs)):
        arc, until = arcs[j], arcs[j + 1].time if j + 1 < len(arcs) else np.inf
        if arc.direction == 0.0:  # the last arc: the axis rests, or the duration is over
            errors[k:], velocities[k:] = arc.error, arc.velocity
            return
        if arc.damping != damping:
            damping = arc.damping
            rate = (damping + gains.D) / (2.0 * axis.m)
            _, h, integral = response(rate, stiffness, time_step)
            spring, pull = stiffness * integral, stiffness * h
            brake = spring + 2.0 * rate * h
        push = friction * arc.direction
        while k < len(times) and times[k] < until:
            e, v = flow(
                arc.error,
                arc.velocity,
                arc.direction,
                rate,
                stiffness,
                friction,
                times[k] - arc.time,
            )
            errors[k], velocities[k] = e, v
            k += 1
            anchor = min(k + ANCHOR - 1, len(times))
            while k < anchor and times[k] < until:
                e, v = (
                    e - (spring * e - (h * v - push * integral)),
                    v - (brake * v + (pull * e + push * h)),
                )
                errors[k], velocities[k] = e, v
                k += 1
