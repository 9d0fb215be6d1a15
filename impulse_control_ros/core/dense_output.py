"""
Exact solutions (arcs of core/hybrid.py) at any times and on a sampling grid t = k dt.

Over a whole sample within an arc, the flow (12) is an affine map that is the same for all arcs of
equal damping. With h and H of core/flow.py at t = dt, written as a change to limit rounding:

    e+ = e - w^2 H e + (h v - f s H),    v+ = v - (w^2 H + 2 g h) v - (w^2 h e + f s h).

The map needs no sin, cos or exp. The flow itself is evaluated at the start of each arc and every
ANCHOR samples, so rounding errors do not accumulate.
"""

import numpy as np

from impulse_control_ros.core.flow import flow, response
from impulse_control_ros.core.jit import kernel

ANCHOR = 16


@kernel()
def evaluate(arcs, axis, gains, times, errors, velocities):
    """Fill ``errors`` and ``velocities`` at ``times``, all (n,); at a jump, after the jump."""
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
    """Fill ``times`` (k ``time_step``), ``errors`` and ``velocities``, all (n,), after jumps."""
    stiffness, friction = gains.K / axis.m, axis.F_c / axis.m
    for k in range(len(times)):
        times[k] = k * time_step
    k, damping = 0, 0.0  # not a valid damping (1)
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
