"""
Close plant and controller offline: the same kernels, and so the same bits, as the nodes.

At sample k the controller answers state k with effort k, which acts over [t_k, t_k+1).
"""

from dataclasses import dataclass

import numpy as np

from impulse_control_ros.core.axis import Axis, axis_step, DIVERGED, DivergedError
from impulse_control_ros.core.damping import damping_at
from impulse_control_ros.core.impulse import answered, Controller, fresh, unpacked
from impulse_control_ros.core.kernel import compiled
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.tick import ticks

EVENT = np.dtype([('tick', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'),
                  ('area', 'f8')])


@dataclass(frozen=True, kw_only=True)
class Run:
    """
    A run of n steps.

    ``time`` [s], ``position`` [m], ``velocity`` [m/s] and ``effort`` [N], the command that
    answers each state, have shape (n + 1,); ``damping`` [N s/m], which acts over the sample
    that starts at each state, has shape (n,); ``events`` has dtype EVENT, one row an impulse.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    damping: np.ndarray
    events: np.ndarray


@compiled
def closed_loop(axis, profile, start, gains, position, velocity, effort, area, guard, damping):
    """Fill the arrays of n steps: ``damping`` of shape (n,), all others of shape (n + 1,)."""
    m, F_c, time_step = axis[0].m, axis[0].F_c, axis[0].time_step
    law, memory = unpacked(gains[0]), fresh()
    x, v, noise = start[0].position, start[0].velocity, 0.0
    for k in range(len(position)):
        position[k], velocity[k] = x, v
        effort[k], area[k], guard[k], memory = answered(memory, law, x, v)
        if k < len(damping):
            damping[k], noise = damping_at(profile[0], noise, k)
            x, v = axis_step(x, v, effort[k], damping[k], m, F_c, time_step)


def steps_of(axis: Axis, controller: Controller, duration: float) -> int:
    """
    Return the number of steps in ``duration`` [s].

    Raises `ParameterError` when the two disagree about the time step or there is no step.
    """
    if axis.time_step != controller.time_step:
        raise refusal('time_step', controller.time_step,
                      f'that of the axis, {axis.time_step:g} [s]')
    steps = ticks(duration, axis.time_step)
    if not steps > 0:
        raise refusal('duration', duration, f'> {axis.time_step:g} [s]')
    return steps


def simulate(axis: Axis, controller: Controller, duration: float) -> Run:
    """
    Run the closed loop for ``duration`` seconds from the axis' start.

    Raises `ParameterError` when the two disagree about the time step or the duration is not
    positive, and `DivergedError` when the motion leaves all bounds.
    """
    steps = steps_of(axis, controller, duration)
    position, velocity, effort, area = (np.empty(steps + 1) for _ in range(4))
    guard, damping = np.empty(steps + 1, np.int8), np.empty(steps)
    closed_loop(*axis.packed(), axis.start(), controller.packed(), position, velocity, effort,
                area, guard, damping)
    if not np.max([position.max(), -position.min(), velocity.max(), -velocity.min()]) < DIVERGED:
        size = np.maximum(np.abs(position), np.abs(velocity))
        first = int(np.flatnonzero(~(size < DIVERGED))[0])
        raise DivergedError(position[first], velocity[first], f'{first * axis.time_step:g}')
    time = np.arange(steps + 1, dtype=float)
    time *= axis.time_step
    fired = np.flatnonzero(guard)
    events = np.empty(len(fired), EVENT)
    for name, values in (('tick', fired), ('guard', guard[fired]), ('area', area[fired]),
                         ('position', position[fired]), ('velocity', velocity[fired])):
        events[name] = values
    return Run(time=time, position=position, velocity=velocity, effort=effort, damping=damping,
               events=events)
