"""
The exact solution of (5) as the hybrid system (9)(10) with the jump map (17), event by event.

============  ==================  =======  ====================================================
symbol        name                unit     equation
============  ==================  =======  ====================================================
e, v          error, velocity     m, m/s   state of (8); e = x - x_r
d             dampings            N s/m    damping (1), constant or constant in pieces
f             flow                -        flow map (8)(9), in core/flow.py
X_0, X'_0     guard               -        jump set of (10): `POSITION_ZERO`, `VELOCITY_ZERO`
J             jump                -        jump map (17)
alpha, beta   alpha_ratio, d_bar  N s      gains (19)(26) of the jumps, by `impulse_area`
============  ==================  =======  ====================================================

Between events the axis moves in one direction, and Coulomb friction is constant. At v = 0 the axis
sticks if K abs(e) <= F_c (section IV-C) until an impulse releases it. A start at v = 0 or e = 0
lies on a guard, so the first jump is at t = 0.

After a jump at e = 0 the state is still on the guard, and (10) can be read in two ways
(`Reading`). The ideal system has no samples: effort_limit, the dead bands, hold_off and time_step
do not apply, and c_event (15) is always 2 because no velocity zero lasts.
"""

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
import math

import numpy as np
import numpy.typing as npt

from impulse_control_ros.core.control_gains import ControlGains, Gains
from impulse_control_ros.core.control_law import (
    impulse_area,
    NO_IMPULSE,
    POSITION_ZERO,
    VELOCITY_ZERO,
)
from impulse_control_ros.core.dense_output import evaluate, sample
from impulse_control_ros.core.flow import crossing, first_zero, flow
from impulse_control_ros.core.jit import kernel, record, sign
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.plant_step import Axis
from impulse_control_ros.core.tick import require_duration
from impulse_control_ros.core.trajectory import Trajectory
from impulse_control_ros.errors import ParameterError

# An arc starts after the jump of its guard; ``before`` is the velocity before that jump.
ARC = record(
    [
        ('time', 'f8'),
        ('error', 'f8'),
        ('velocity', 'f8'),
        ('before', 'f8'),
        ('damping', 'f8'),
        ('direction', 'f8'),
        ('guard', 'i8'),
    ]
)
EVENT = record(
    [
        ('time', 'f8'),
        ('guard', 'i8'),
        ('position', 'f8'),
        ('velocity_before', 'f8'),
        ('velocity_after', 'f8'),
    ]
)


class Reading(Enum):
    """Reading of (10) at e = 0, where the state after a jump is still on the guard."""

    STRICT = 'jump again and again, each time by 1 - 2 alpha_ratio: at rest at that instant'
    ONE_JUMP = 'one jump for each crossing, then flow: the axis bounces'


class End(Enum):
    """Why a solution ends; the value is a sentence."""

    DURATION = 'the duration is reached'
    ORIGIN = 'the axis rests in the origin'
    STICKS = 'the axis sticks: it stands, and K abs(e) does not exceed F_c'
    EVENT_LIMIT = 'the limit of events is reached before the duration'
    ENDLESS_JUMPS = 'the jumps at e = 0 do not shrink the velocity: alpha_ratio m is too large'
    DIVERGES = 'the impulses drive the motion beyond all bounds'


ENDS = tuple(End)
DURATION, ORIGIN, STICKS, EVENT_LIMIT, ENDLESS_JUMPS, DIVERGES, FLOWS = range(len(ENDS) + 1)
ROUNDED = 1.0 + 1e-12  # tolerated ratio of samples times time step to the duration
BEYOND = 1e100  # far above any motion, far below overflow


@kernel()
def next_guard(error, velocity, direction, rate, stiffness, friction, span):
    """
    Flow to the first guard, for at most ``span`` seconds.

    Returns (guard, elapsed time, error, velocity). The motion is monotone up to its velocity zero,
    so it crosses e = 0 exactly if it starts before and ends at or beyond e = 0.
    """
    pull = stiffness * error + friction * direction + rate * velocity
    stop = first_zero(abs(velocity), -direction * pull, rate, stiffness)
    elapsed = stop if stop < span else span
    e, v = flow(error, velocity, direction, rate, stiffness, friction, elapsed)
    if direction * error < 0.0 and direction * e >= 0.0:
        elapsed = crossing(error, velocity, direction, rate, stiffness, friction, elapsed)
        _, v = flow(error, velocity, direction, rate, stiffness, friction, elapsed)
        return POSITION_ZERO, elapsed, 0.0, v
    if stop <= span or direction * v <= 0.0:
        return VELOCITY_ZERO, elapsed, e, 0.0
    return NO_IMPULSE, elapsed, e, v


@kernel()
def jump(guard, gains, m, error, velocity):
    """Return the velocity [m/s] after one jump (17), unchanged without a guard."""
    if guard == NO_IMPULSE:
        return velocity
    return velocity + impulse_area(guard, gains, error, velocity) / m


@kernel()
def depart(axis, gains, strict, guard, error, velocity, left):
    """
    Apply the jumps of one instant, ``left`` [s] before the end of the duration.

    Returns (velocity after the jumps, direction of the next motion, index in ENDS).
    """
    after = jump(guard, gains, axis.m, error, velocity)
    if guard == POSITION_ZERO and strict:
        if abs(after) >= abs(velocity):
            return after, 0.0, ENDLESS_JUMPS
        after = 0.0  # the limit of the series
    if after == 0.0 and gains.K * abs(error) <= axis.F_c:
        return after, 0.0, ORIGIN if error == 0.0 else STICKS
    if abs(error) + abs(after) > BEYOND:
        return after, 0.0, DIVERGES
    if left <= 0.0:
        return after, 0.0, DURATION
    return after, sign(after if after != 0.0 else -error), FLOWS


@kernel()
def longer(arcs):
    """Return ``arcs`` with room for four times as many."""
    grown = np.empty(4 * len(arcs), ARC)
    grown[: len(arcs)] = arcs
    return grown


@kernel()
def trace(axis, gains, strict, error, velocity, breaks, dampings, duration, limit):
    """
    Chain jumps and arcs from (error, velocity) at t = 0.

    ``breaks`` [s] has shape (n,), ``dampings`` [N s/m] shape (n + 1,). Returns the arcs, shape
    (count,), dtype ARC, then the index of the end in ENDS and its time [s].
    """
    stiffness, friction = gains.K / axis.m, axis.F_c / axis.m
    arcs, count, events, piece, t = np.empty(128, ARC), 0, 0, 0, 0.0
    guard = VELOCITY_ZERO if velocity == 0.0 else (POSITION_ZERO if error == 0.0 else NO_IMPULSE)
    while True:
        if not gains.impulses or (error == 0.0 and velocity == 0.0):
            guard = NO_IMPULSE
        events += guard != NO_IMPULSE
        if events > limit:
            return arcs[:count], EVENT_LIMIT, t
        while piece < len(breaks) and breaks[piece] <= t:
            piece += 1
        before = velocity
        velocity, direction, end = depart(axis, gains, strict, guard, error, before, duration - t)
        if count == len(arcs):
            arcs = longer(arcs)
        arc = arcs[count]
        arc.time, arc.error, arc.velocity, arc.before = t, error, velocity, before
        arc.damping, arc.direction, arc.guard = dampings[piece], direction, guard
        count += 1
        if end != FLOWS:
            return arcs[:count], end, t
        until = min(breaks[piece], duration) if piece < len(breaks) else duration
        rate = (dampings[piece] + gains.D) / (2.0 * axis.m)
        guard, elapsed, error, velocity = next_guard(
            error, velocity, direction, rate, stiffness, friction, until - t
        )
        t = t + elapsed if elapsed < until - t else until


@kernel()
def events_of(arcs, x_r):
    """Return the jumps that start ``arcs``: dtype EVENT."""
    events, count = np.empty(len(arcs), EVENT), 0
    for arc in arcs:
        if arc.guard != NO_IMPULSE:
            event = events[count]
            event.time, event.guard, event.position = arc.time, arc.guard, x_r + arc.error
            event.velocity_before, event.velocity_after = arc.before, arc.velocity
            count += 1
    return events[:count]


@dataclass(frozen=True, kw_only=True)
class Solution(Trajectory):
    """
    An exact solution.

    ``events`` has dtype EVENT and one row per jump, or per strict series of jumps: time [s], guard
    (index in `GUARDS`), position [m], velocity before and after [m/s]. ``end`` says why the
    solution ends and ``end_time`` [s] when. `at` evaluates ``arcs`` (dtype ARC), ``axis`` and
    ``gains``.

    ``time``, ``position``, ``velocity`` and ``effort`` (the feedback -K e - D v, without jumps)
    are sampled at the plant's time step, as in `Run`. The samples extend to the ``duration`` [s],
    or to an earlier end at which the axis is not at rest.
    """

    events: np.ndarray
    end: End
    end_time: float
    duration: float
    x_r: float
    arcs: np.ndarray
    axis: Axis
    gains: Gains

    @cached_property
    def _samples(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time [s], position [m] and velocity [m/s], shape (n,)."""
        step = float(self.axis.time_step)
        return self.sampled(step, int(min(self.duration, self.last) * ROUNDED / step))

    @property
    def time(self) -> np.ndarray:
        """Time [s] of each sample."""
        return self._samples[0]

    @property
    def position(self) -> np.ndarray:
        """Position [m] at each sample."""
        return self._samples[1]

    @property
    def velocity(self) -> np.ndarray:
        """Velocity [m/s] at each sample, after its jumps."""
        return self._samples[2]

    @cached_property
    def effort(self) -> np.ndarray:
        """Feedback -K e - D v [N] at each sample (4)."""
        error = self.position - self.x_r
        return -self.gains.K * error - self.gains.D * self.velocity

    @property
    def set_point(self) -> np.ndarray:
        """Set-point [m] at each sample."""
        return np.full(len(self.time), self.x_r)

    def impulse_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the sample at or after each jump, and its guard."""
        at = np.searchsorted(self.time, self.events['time'])
        return np.minimum(at, len(self.time) - 1), self.events['guard']

    @property
    def last(self) -> float:
        """The last known time [s]; inf if the axis stays at rest."""
        return math.inf if self.end in (End.ORIGIN, End.STICKS) else self.end_time

    def at(self, time: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return position [m] and velocity [m/s] at ``time`` [s], in its shape.

        At a jump, the result is the state after the jump. Raises `ParameterError` for a time
        before 0 or after the end.
        """
        times = np.asarray(time, float)
        wrong = times[~((times >= 0.0) & (times <= self.last))]
        if wrong.size:
            raise refusal('time', float(wrong[0]), f'in [0, {self.last:g}] [s]')
        errors, velocities = np.empty(times.size), np.empty(times.size)
        evaluate(self.arcs, self.axis, self.gains, times.ravel(), errors, velocities)
        return self.x_r + errors.reshape(times.shape), velocities.reshape(times.shape)

    def sampled(self, time_step: float, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return time [s], position [m] and velocity [m/s], all (steps + 1,), as `at` does.

        This is many times faster than `at`. Raises `ParameterError` if the last time is after the
        end.
        """
        if not time_step > 0.0:
            raise refusal('time_step', time_step, '> 0 [s]')
        if not 0 <= steps * time_step <= self.last * ROUNDED:
            raise refusal('steps', steps, f'in [0, {self.last / time_step:g}] [samples]')
        times, positions, velocities = (np.empty(steps + 1) for _ in range(3))
        sample(self.arcs, self.axis, self.gains, time_step, times, positions, velocities)
        positions += self.x_r
        return times, positions, velocities


def solve(
    plant: Plant,
    gains: ControlGains,
    duration: float,
    *,
    reading: Reading = Reading.STRICT,
    breaks: npt.ArrayLike = (),
    dampings: npt.ArrayLike | None = None,
    event_limit: int = 1_000_000,
) -> Solution:
    """
    Solve the ideal closed loop from the plant's start, for at most ``duration`` seconds.

    The damping is ``dampings[i]`` [N s/m], shape (n + 1,), from ``breaks[i - 1]`` to ``breaks[i]``
    [s], shape (n,), ascending. Without ``dampings``, the plant's constant damping applies. Raises
    `ParameterError` for invalid values and for a plant that is not ideal.
    """
    require_duration(duration)
    if not plant.is_ideal:
        raise ParameterError(
            'the plant must be an ideal one: no sensor, actuator, payload, disturbance and F_s'
        )
    if event_limit < 0:
        raise refusal('event_limit', event_limit, '>= 0 [events]')
    if dampings is None and plant.damping.kind != 'constant':
        raise refusal('damping.kind', plant.damping.kind, 'constant, or pieces given by dampings')
    times = np.array(breaks, float)
    values = np.array([plant.damping.value] if dampings is None else dampings, float)
    if dampings is not None or times.size:
        check_pieces(times, values)
    axis = Axis(plant.m, plant.F_c, plant.time_step)
    law = gains.values._replace(x_r=0.0)  # the solution is in e
    arcs, end, end_time = trace(
        axis,
        law,
        reading is Reading.STRICT,
        plant.x_0 - gains.x_r,
        plant.v_0,
        times,
        values,
        float(duration),
        event_limit,
    )
    return Solution(
        events=events_of(arcs, gains.x_r),
        end=ENDS[end],
        end_time=end_time,
        duration=float(duration),
        x_r=gains.x_r,
        arcs=arcs,
        axis=axis,
        gains=law,
    )


def check_pieces(breaks: np.ndarray, dampings: np.ndarray) -> None:
    """Raise `ParameterError` unless there is one more damping [N s/m] than breaks [s]."""
    if breaks.ndim != 1 or not np.all(np.diff(breaks, prepend=0.0) > 0.0):
        raise refusal('breaks', breaks.tolist(), 'one ascending list of times > 0 [s]')
    if dampings.shape != (breaks.size + 1,):
        raise refusal(
            'dampings',
            dampings.shape,
            f'shape ({breaks.size + 1},), one value more than breaks [N s/m]',
        )
    if not np.all((dampings > 0.0) & np.isfinite(dampings)):
        raise refusal('dampings', float(dampings.min()), '> 0 and finite [N s/m] (1)')
