"""
The plant as its controller sees it: the axis behind its sensor and its actuator.

Where all of core/nonidealities.py is off and friction is Coulomb's, `axis_step` after `damping_at`
does the same, to the same bits, at less cost; `Plant.is_ideal` says where that will do.
"""

import numpy as np

from impulse_control_ros.core.damping import damping_at
from impulse_control_ros.core.jit import compiled
from impulse_control_ros.core.nonidealities import actuate, at_rest, disturb, measure
from impulse_control_ros.core.plant import axis_step, Plant
from impulse_control_ros.core.stribeck import stribeck_step


@compiled
def sense(axis, hardware, state, hidden):
    """Measure the state; all are arrays of shape (1,), the form that the plant node has."""
    measure(hardware[0], state[0], hidden[0], 1.0 / axis[0].time_step)


@compiled
def plant_step(axis, profile, hardware, state, hidden, command):
    """
    Advance the state by one sample under ``command`` [N], in place, and measure it.

    All but the command are arrays of shape (1,). The state's effort is the mean over the sample
    of what the actuator gave.
    """
    now, axle, real, inner = state[0], axis[0], hardware[0], hidden[0]
    now.damping, now.noise = damping_at(profile[0], now.noise, now.tick)
    now.effort = actuate(real, inner, now.tick, command)
    force = now.effort + disturb(real, inner, now.tick) if real.force != 0.0 else now.effort
    m = axle.m + real.mass if now.tick >= real.mass_time else axle.m
    if real.F_s > axle.F_c:
        now.position, now.velocity = stribeck_step(
            now.position,
            now.velocity,
            force,
            now.damping,
            m,
            axle.F_c,
            real.F_s,
            real.v_s,
            axle.time_step,
        )
    else:
        now.position, now.velocity = axis_step(
            now.position, now.velocity, force, now.damping, m, axle.F_c, axle.time_step
        )
    now.tick += 1
    sense(axis, hardware, state, hidden)


def put_to_start(axis: Plant, state: np.ndarray) -> np.ndarray:
    """
    Put ``state`` to the start of ``axis``, and return the memory of its hardware there.

    Both have shape (1,), dtypes STATE and HARDWARE_STATE. Tick and noise stay: time goes on.
    """
    start, hidden = axis.start(), at_rest()
    for name in ('position', 'velocity', 'effort'):
        state[name] = start[name]
    sense(axis.packed_axis(), axis.packed_hardware(), state, hidden)
    return hidden
