"""
The exact solution of (5) as the hybrid system (9)(10) with the jump map (17), event by event.

Flow (9), in the error e = x - x_r, in the direction s of the motion, while no guard holds:

    m e'' + (d + D) e' + K e = -F_c s

===========  ==================  =======  =====================================================
symbol       name                unit     equation
===========  ==================  =======  =====================================================
e, v         error, velocity     m, m/s   state of (8); e = x - x_r
s            direction           1        sign of the motion; 0 at rest
g            rate                1/s      (d + D) / (2 m), minus the real pole of (20)
w^2          stiffness           1/s^2    K / m, from A of (11)
f            friction            m/s^2    F_c / m (section IV-C)
r^2          curvature           1/s^2    w^2 - g^2: > 0 underdamped, 0 critically damped (20)
X_0, X'_0    guard               -        jump set of (10): `POSITION_ZERO`, `VELOCITY_ZERO`
alpha, beta  alpha_ratio, d_bar  N s      gains (19)(26) of the jumps, by `impulse_area`
===========  ==================  =======  =====================================================

With E = exp(-g t), C = cos(r t), h = E sin(r t) / r and H the integral of h, (12) reads

    e(t) = e (E C + g h) + v h - f s H,    v(t) = v E C - (w^2 e + f s + g v) h.

The next velocity zero has a closed form; so has the next position zero without friction, and
with it Newton's method starts there. Both are found to the last bits, whatever the damping.

A jump at e = 0 leaves the state on the guard, and (10) can be read in two ways (`Reading`).
The ideal system knows no sample: effort_limit, the dead bands and hold_off do not apply, and
c_event (15) is always 2, for the first impulse on a standing axis releases it.
"""

from dataclasses import dataclass
from enum import Enum
import math

import numba
import numpy as np
import numpy.typing as npt

from impulse_control_ros.core.axis import Axis
from impulse_control_ros.core.impulse import (
    Controller,
    impulse_area,
    NO_IMPULSE,
    POSITION_ZERO,
    sign,
    VELOCITY_ZERO,
)
from impulse_control_ros.core.parameter import refusal

# An arc starts after the jump of its guard; ``before`` is the velocity before that jump.
ARC = np.dtype([('time', 'f8'), ('error', 'f8'), ('velocity', 'f8'), ('before', 'f8'),
                ('damping', 'f8'), ('direction', 'f8'), ('guard', 'i8')])
EVENT = np.dtype([('time', 'f8'), ('guard', 'i8'), ('position', 'f8'),
                  ('velocity_before', 'f8'), ('velocity_after', 'f8')])


class Reading(Enum):
    """How (10) is read at e = 0, where the state after a jump lies on the guard again."""

    STRICT = 'jump again and again: v shrinks to 0 at that instant, a series of (1 - 2 alpha)^n'
    ONE_JUMP = 'one jump for each crossing, then flow: the axis bounces'


class End(Enum):
    """Why a solution ends; the value says it in a sentence."""

    DURATION = 'the duration is reached'
    ORIGIN = 'the axis rests in the origin'
    STICKS = 'the axis sticks: it stands, and K abs(e) does not exceed F_c'
    EVENT_LIMIT = 'the limit of events is reached before the duration'
    ENDLESS_JUMPS = 'the jumps at e = 0 do not shrink the velocity: alpha_ratio m is too large'


ENDS = tuple(End)
DURATION, ORIGIN, STICKS, EVENT_LIMIT, ENDLESS_JUMPS, FLOWS = range(len(ENDS) + 1)


@numba.njit(cache=True)
def series(rate, stiffness, t):
    """Return E C, h and H for a short time, where their closed forms cancel."""
    before, term, n = 0.0, 1.0, 1.0
    slope, first, second = 1.0, 1.0, 0.5
    while abs(term) + abs(before) > 1e-18:
        before, term = term, -t * (2.0 * rate * n * term + stiffness * t * before) / (n * (n + 1))
        n += 1.0
        slope += n * term
        first += term
        second += term / (n + 1)
    return slope + rate * t * first, t * first, t * t * second


@numba.njit(cache=True)
def response(rate, stiffness, t):
    """Return E C, h and H at time ``t`` [s]: (12), sound on both sides of critical damping."""
    if max(rate * rate, stiffness) * t * t < 1e-2:
        return series(rate, stiffness, t)
    curvature = stiffness - rate * rate
    if curvature > 0.0:
        root, decay = math.sqrt(curvature), math.exp(-rate * t)
        half, h = math.sin(0.5 * root * t), decay * math.sin(root * t) / root
        fall = -math.expm1(-rate * t) + 2.0 * decay * half * half - rate * h
        return decay * math.cos(root * t), h, fall / stiffness
    root = math.sqrt(-curvature)
    fast = rate + root
    slow = stiffness / fast  # rate - root would cancel
    decay = math.exp(-slow * t)
    h = decay * (-math.expm1(-2.0 * root * t) / (2.0 * root) if root > 0.0 else t)
    return decay - root * h, h, -math.expm1(-slow * t) / stiffness - h / fast


@numba.njit(cache=True)
def flow(error, velocity, direction, rate, stiffness, friction, t):
    """Return error [m] and velocity [m/s] after ``t`` [s] of motion in one direction (9)(12)."""
    cosine, h, integral = response(rate, stiffness, t)
    push = friction * direction
    return (error * (cosine + rate * h) + velocity * h - push * integral,
            velocity * cosine - (stiffness * error + push + rate * velocity) * h)


@numba.njit(cache=True)
def first_zero(value, slope, rate, stiffness):
    """
    Return the first t > 0 with ``value`` C + ``slope`` sin(r t) / r = 0, or inf.

    ``value`` >= 0; ``slope`` is the derivative plus ``rate`` times the value. A value that
    starts at zero returns there after half a period.
    """
    curvature = stiffness - rate * rate
    if curvature > 0.0:
        root = math.sqrt(curvature)
        return math.atan2(value * root, -slope) / root
    root = math.sqrt(-curvature)
    margin = -slope - root * value
    if not margin > 0.0:
        return math.inf
    return math.log1p(2.0 * root * value / margin) / (2.0 * root) if root > 0.0 else value / margin


@numba.njit(cache=True)
def crossing(error, velocity, direction, rate, stiffness, friction, upper):
    """Return the time [s] in (0, ``upper``] of e = 0, which the motion is known to cross."""
    lower = 0.0
    t = min(first_zero(abs(error), -direction * (velocity + rate * error), rate, stiffness),
            upper)
    for _ in range(100):
        e, v = flow(error, velocity, direction, rate, stiffness, friction, t)
        if direction * e < 0.0:
            lower = t
        else:
            upper = t
        closer = t - e / v if v != 0.0 else upper
        if abs(closer - t) <= 2e-16 * t:
            break
        # Friction may bend Newton's step out of the bracket; bisect then.
        t = closer if lower < closer < upper else 0.5 * (lower + upper)
    return t


@numba.njit(cache=True)
def next_guard(error, velocity, direction, rate, stiffness, friction, span, impulses):
    """
    Flow to the first guard, for at most ``span`` seconds.

    Returns (guard, elapsed time, error, velocity). Until its velocity zero the motion is
    monotone, so it crosses e = 0 exactly when it comes from the other side and ends beyond.
    """
    pull = stiffness * error + friction * direction + rate * velocity
    stop = first_zero(abs(velocity), -direction * pull, rate, stiffness)
    elapsed = stop if stop < span else span
    e, v = flow(error, velocity, direction, rate, stiffness, friction, elapsed)
    if impulses and direction * error < 0.0 and direction * e >= 0.0:
        elapsed = crossing(error, velocity, direction, rate, stiffness, friction, elapsed)
        _, v = flow(error, velocity, direction, rate, stiffness, friction, elapsed)
        return POSITION_ZERO, elapsed, 0.0, v
    if stop <= span or direction * v <= 0.0:
        return VELOCITY_ZERO, elapsed, e, 0.0
    return NO_IMPULSE, elapsed, e, v


@numba.njit(cache=True)
def jump(guard, gains, m, error, velocity, strict):
    """Return the velocity [m/s] after the jump (17), and how the solution ends by it."""
    after = velocity + impulse_area(guard, gains, error, velocity) / m
    if guard == POSITION_ZERO and strict:
        return (0.0, ORIGIN) if abs(after) < abs(velocity) else (after, ENDLESS_JUMPS)
    return after, FLOWS


@numba.njit(cache=True)
def ending(axis, gains, error, velocity, left):
    """Return the index in ENDS of a state after its jump, ``left`` [s] before the duration."""
    if velocity == 0.0 and gains.K * abs(error) <= axis.F_c:
        return ORIGIN if error == 0.0 else STICKS
    return FLOWS if left > 0.0 else DURATION


@numba.njit(cache=True)
def with_room(arcs, count):
    """Return ``arcs`` with room for one more than ``count``: longer ones when it is full."""
    if count < len(arcs):
        return arcs
    longer = np.empty(4 * count, ARC)
    longer[:count] = arcs
    return longer


@numba.njit(cache=True)
def trace(axis, gains, strict, error, velocity, breaks, dampings, duration, limit):
    """
    Chain jumps and arcs from (error, velocity) at t = 0.

    ``breaks`` (n,) [s], ``dampings`` (n + 1,) [N s/m]. Returns the arcs, shape (count,), dtype
    ARC, then the index of the end in ENDS and its time [s].
    """
    stiffness, friction = gains.K / axis.m, axis.F_c / axis.m
    arcs, count, events, piece, t, end = np.empty(128, ARC), 0, 0, 0, 0.0, FLOWS
    guard = VELOCITY_ZERO if velocity == 0.0 else (POSITION_ZERO if error == 0.0 else NO_IMPULSE)
    while True:
        before = velocity
        if not gains.impulses or (error == 0.0 and velocity == 0.0):
            guard = NO_IMPULSE
        if guard != NO_IMPULSE:
            if events == limit:
                return arcs[:count], EVENT_LIMIT, t
            velocity, end = jump(guard, gains, axis.m, error, velocity, strict)
            events += 1
        while piece < len(breaks) and breaks[piece] <= t:
            piece += 1
        if end == FLOWS:
            end = ending(axis, gains, error, velocity, duration - t)
        direction = 0.0 if end != FLOWS else sign(velocity if velocity != 0.0 else -error)
        arcs = with_room(arcs, count)
        arc = arcs[count]
        arc.time, arc.error, arc.velocity, arc.before = t, error, velocity, before
        arc.damping, arc.direction, arc.guard = dampings[piece], direction, guard
        count += 1
        if end != FLOWS:
            return arcs[:count], end, t
        until = min(breaks[piece], duration) if piece < len(breaks) else duration
        rate = (dampings[piece] + gains.D) / (2.0 * axis.m)
        guard, elapsed, error, velocity = next_guard(
            error, velocity, direction, rate, stiffness, friction, until - t, gains.impulses)
        t = t + elapsed if elapsed < until - t else until


@numba.njit(cache=True)
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
            errors[i], velocities[i] = flow(arc.error, arc.velocity, arc.direction, rate,
                                            stiffness, friction, times[i] - arc.time)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """
    An exact solution.

    ``events`` has dtype EVENT, one row a jump (the whole series of a strict one): time [s],
    guard (index in `GUARDS`), position [m], velocity before and after [m/s]. ``end`` says why
    the solution ends and ``end_time`` [s] when. ``arcs`` (dtype ARC), ``axis`` and ``gains``
    are what `at` evaluates.
    """

    events: np.ndarray
    end: End
    end_time: float
    x_r: float
    arcs: np.ndarray
    axis: np.ndarray
    gains: np.ndarray

    def at(self, time: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """
        Return position [m] and velocity [m/s] at ``time`` [s], in its shape.

        At the time of a jump it is the state after it. An axis at rest stays there for ever.
        Raises `ParameterError` for a time before 0 or after the end.
        """
        times = np.asarray(time, float)
        last = math.inf if self.end in (End.ORIGIN, End.STICKS) else self.end_time
        wrong = times[~((times >= 0.0) & (times <= last))]
        if wrong.size:
            raise refusal('time', float(wrong[0]), f'[0, {last:g}] [s]')
        errors, velocities = np.empty(times.size), np.empty(times.size)
        evaluate(self.arcs, self.axis[0], self.gains[0], times.ravel(), errors, velocities)
        return self.x_r + errors.reshape(times.shape), velocities.reshape(times.shape)


def solve(
    axis: Axis, controller: Controller, duration: float, *, reading: Reading = Reading.STRICT,
    breaks: npt.ArrayLike = (), dampings: npt.ArrayLike | None = None,
    event_limit: int = 1_000_000,
) -> Solution:
    """
    Solve the ideal closed loop from the axis' start, for at most ``duration`` seconds.

    The damping is ``dampings[i]`` [N s/m], shape (n + 1,), from ``breaks[i - 1]`` to
    ``breaks[i]`` [s], shape (n,), ascending; without ``dampings`` the axis' constant one.
    Raises `ParameterError` for values that make no such motion.
    """
    if not 0.0 < duration < math.inf:
        raise refusal('duration', duration, '> 0 and finite [s]')
    if event_limit < 0:
        raise refusal('event_limit', event_limit, '>= 0 [events]')
    if dampings is None and axis.damping.kind != 'constant':
        raise refusal('damping.kind', axis.damping.kind, 'constant, or pieces given by dampings')
    times = np.array(breaks, float)
    values = np.array([axis.damping.value] if dampings is None else dampings, float)
    check_pieces(times, values)
    plant, gains = axis.packed()[0], controller.packed()
    gains['x_r'] = 0.0  # the solution is in e
    arcs, end, end_time = trace(
        plant[0], gains[0], reading is Reading.STRICT, axis.x_0 - controller.x_r, axis.v_0,
        times, values, float(duration), event_limit)
    jumps = arcs[arcs['guard'] != NO_IMPULSE]
    events = np.empty(len(jumps), EVENT)
    events['time'], events['guard'] = jumps['time'], jumps['guard']
    events['position'] = controller.x_r + jumps['error']
    events['velocity_before'], events['velocity_after'] = jumps['before'], jumps['velocity']
    return Solution(events=events, end=ENDS[end], end_time=end_time, x_r=controller.x_r,
                    arcs=arcs, axis=plant, gains=gains)


def check_pieces(breaks: np.ndarray, dampings: np.ndarray) -> None:
    """Raise `ParameterError` unless (n,) breaks [s] part (n + 1,) dampings [N s/m]."""
    if breaks.ndim != 1 or not np.all(np.diff(breaks, prepend=0.0) > 0.0):
        raise refusal('breaks', breaks.tolist(), 'one ascending list of times > 0 [s]')
    if dampings.shape != (breaks.size + 1,):
        raise refusal('dampings', dampings.shape, f'shape ({breaks.size + 1},), one value more '
                      'than breaks [N s/m]')
    if not np.all((dampings > 0.0) & np.isfinite(dampings)):
        raise refusal('dampings', float(dampings.min()), '> 0 and finite [N s/m] (1)')
