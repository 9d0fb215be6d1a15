"""
Close plant and controller offline: the same kernels, and so the same bits, as the nodes.

At sample k the controller answers state k with effort k, which acts over [t_k, t_k+1). An axis
that is not ideal, or a law with options, takes a loop of its own.
"""

from dataclasses import dataclass

import numpy as np

from impulse_control_ros.core.careful import (
    control_carefully,
    fresh_watch,
    is_plain,
    packed_law,
)
from impulse_control_ros.core.damping import damping_at
from impulse_control_ros.core.impulse import (
    ANSWER,
    answered,
    ControlGains,
    fresh,
    fresh_memory,
    unpacked,
)
from impulse_control_ros.core.jit import compiled
from impulse_control_ros.core.nonidealities import at_rest
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.plant import axis_step, DIVERGED, Plant
from impulse_control_ros.core.plant_step import plant_step, sense
from impulse_control_ros.core.tick import ticks
from impulse_control_ros.core.trajectory import Trajectory
from impulse_control_ros.errors import DivergedError

EVENT = np.dtype(
    [('tick', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('area', 'f8')]
)


@dataclass(frozen=True, kw_only=True)
class Run(Trajectory):
    """
    A run of n steps.

    ``time`` [s], ``position`` [m], ``velocity`` [m/s] and ``effort`` [N], the command that
    answers each state, have shape (n + 1,); ``damping`` [N s/m] and ``applied`` [N], the mean
    effort of the actuator, which act over the sample that starts at each state, have shape (n,);
    ``events`` has dtype EVENT, one row an impulse. ``measured_position`` [m] and
    ``measured_velocity`` [m/s], nan where there is none, are what the controller saw: of an
    ideal axis the state itself. ``x_r`` [m] is the set-point.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    damping: np.ndarray
    events: np.ndarray
    applied: np.ndarray
    measured_position: np.ndarray
    measured_velocity: np.ndarray
    x_r: float

    @property
    def set_point(self) -> np.ndarray:
        """The set-point [m] at each state."""
        return np.full(len(self.time), self.x_r)

    def impulse_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return tick and guard of each impulse."""
        return self.events['tick'], self.events['guard']


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


@compiled
def real_loop(
    axis,
    profile,
    hardware,
    state,
    hidden,
    gains,
    care,
    memory,
    watch,
    answer,
    states,
    measured,
    commands,
    felt,
):
    """
    Fill the rows of n steps.

    ``states`` and ``measured`` (position, velocity) have shape (n + 1, 2), ``commands`` (effort,
    area, guard, the velocity that the law took) (n + 1, 4), ``felt`` (damping, effort) (n, 2).
    """
    now, seen, told = state[0], hidden[0], answer[0]
    sense(axis, hardware, state, hidden)
    for k in range(len(states)):
        states[k, 0], states[k, 1] = now.position, now.velocity
        measured[k, 0], measured[k, 1] = seen.position, seen.velocity
        control_carefully(memory, watch, gains, care, seen.position, seen.velocity, answer)
        commands[k, 0], commands[k, 1], commands[k, 2] = told.effort, told.area, told.guard
        commands[k, 3] = told.velocity
        if k < len(felt):
            plant_step(axis, profile, hardware, state, hidden, told.effort)
            felt[k, 0], felt[k, 1] = now.damping, now.effort


def steps_of(axis: Plant, controller: ControlGains, duration: float) -> int:
    """
    Return the number of steps in ``duration`` [s].

    Raises `ParameterError` when the two disagree about the time step or there is no step.
    """
    if axis.time_step != controller.time_step:
        raise refusal(
            'time_step', controller.time_step, f'that of the axis, {axis.time_step:g} [s]'
        )
    steps = ticks(duration, axis.time_step)
    if not steps > 0:
        raise refusal('duration', duration, f'> {axis.time_step:g} [s]')
    return steps


def simulate(axis: Plant, controller: ControlGains, duration: float) -> Run:
    """
    Run the closed loop for ``duration`` seconds from the axis' start.

    Raises `ParameterError` when the two disagree about the time step or the duration is not
    positive, and `DivergedError` when the motion leaves all bounds.
    """
    steps = steps_of(axis, controller, duration)
    made = made_ideally if axis.is_ideal and is_plain(controller) else made_really
    signals, (area, guard, velocity) = made(axis, controller, steps)
    _require_bounded(axis, signals['position'], signals['velocity'])
    time = np.arange(steps + 1, dtype=float)
    time *= axis.time_step
    fired = np.flatnonzero(guard)
    events = np.empty(len(fired), EVENT)
    for name, values in (
        ('tick', fired),
        ('guard', guard[fired]),
        ('area', area[fired]),
        ('position', signals['measured_position'][fired]),
        ('velocity', velocity[fired]),
    ):
        events[name] = values
    return Run(time=time, events=events, x_r=controller.x_r, **signals)


def _require_bounded(axis: Plant, position: np.ndarray, velocity: np.ndarray) -> None:
    """Raise `DivergedError` when the motion leaves all bounds."""
    if not np.max([position.max(), -position.min(), velocity.max(), -velocity.min()]) < DIVERGED:
        size = np.maximum(np.abs(position), np.abs(velocity))
        first = int(np.flatnonzero(~(size < DIVERGED))[0])
        raise DivergedError(position[first], velocity[first], f'{first * axis.time_step:g}')


Made = tuple[dict[str, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def made_ideally(axis: Plant, controller: ControlGains, steps: int) -> Made:
    """Return the signals of `Run` by name, and area, guard and velocity at each state."""
    position, velocity, effort, area = (np.empty(steps + 1) for _ in range(4))
    guard, damping = np.empty(steps + 1, np.int8), np.empty(steps)
    closed_loop(
        *axis.packed(),
        axis.start(),
        controller.packed(),
        position,
        velocity,
        effort,
        area,
        guard,
        damping,
    )
    return {
        'position': position,
        'velocity': velocity,
        'effort': effort,
        'damping': damping,
        'applied': effort[:-1],
        'measured_position': position,
        'measured_velocity': velocity,
    }, (area, guard, velocity)


def made_really(axis: Plant, controller: ControlGains, steps: int) -> Made:
    """Do `made_ideally` with all of core/nonidealities.py and core/careful.py."""
    states, measured = np.empty((steps + 1, 2)), np.empty((steps + 1, 2))
    commands, felt = np.empty((steps + 1, 4)), np.empty((steps, 2))
    real_loop(
        *axis.packed(),
        axis.packed_hardware(),
        axis.start(),
        at_rest(),
        *packed_law(controller),
        fresh_memory(),
        fresh_watch(),
        np.zeros(1, ANSWER),
        states,
        measured,
        commands,
        felt,
    )
    (position, velocity), (effort, area, guard, taken) = states.T.copy(), commands.T.copy()
    damping, applied = felt.T.copy()
    return {
        'position': position,
        'velocity': velocity,
        'effort': effort,
        'damping': damping,
        'applied': applied,
        'measured_position': measured[:, 0].copy(),
        'measured_velocity': measured[:, 1].copy(),
    }, (area, guard, taken)
