"""
The control law of one sample: PD (4) plus the impulses of the jump map (17).

============  ==================  =======  ==============================================
symbol        name                unit     meaning
============  ==================  =======  ==============================================
e             error               m        x - x_r
K, D          K, D                N/m...   PD gains (4)
alpha         alpha_ratio         1        alpha = alpha_ratio * m * abs(v) (19)
beta          d_bar, c            N s      beta = abs(e) * d_bar / (2 c) (26)
c_event       c_event             1        2 through or onto zero velocity, 1 at a stick (15)
J             area                N s      impulse: -2 alpha sign(v) or -c_event beta sign(e)
============  ==================  =======  ==============================================

The guards see samples only, and compare signs, never products (products underflow):

* position zero: the sign of e differs from that of the sample before, judged by its own and by
  the present set-point, so that a set-point jump is no crossing and a ramp fires once. The
  sample at exactly zero fires, the one after it does not. It needs abs(v) > velocity_deadband.
* velocity zero: the sign of v (0 within velocity_deadband) differs from that of the sample
  before, unless an impulse of our own acted in between. It needs abs(e) > position_deadband.
* sticking: the velocity was zero at this sample and at the one before. The first sample, and
  the first one after a set-point change, count as an arrival at zero velocity.

A sample that meets both guards acts as a position zero. An impulse of area J leaves as an
effort of J / dt for one sample; under an effort limit what does not fit waits, and velocity
guards rest until it has left, or until impulses are switched off. After a position zero no
impulse starts for hold_off samples.
"""

from dataclasses import dataclass

import numba
import numpy as np

from impulse_control_ros.core.parameter import parameter, Parameters
from impulse_control_ros.core.tick import nanoseconds

NO_IMPULSE, POSITION_ZERO, VELOCITY_ZERO, STICKING = range(4)
GUARDS = ('', 'position_zero', 'velocity_zero', 'sticking')

GAINS = np.dtype([('m', 'f8'), ('K', 'f8'), ('D', 'f8'), ('d_bar', 'f8'), ('c', 'f8'),
                  ('alpha_ratio', 'f8'), ('x_r', 'f8'), ('impulses', 'i8'),
                  ('effort_limit', 'f8'), ('position_deadband', 'f8'),
                  ('velocity_deadband', 'f8'), ('hold_off', 'i8'), ('time_step', 'f8')])
MEMORY = np.dtype([('started', 'i8'), ('position', 'f8'), ('side', 'f8'), ('direction', 'f8'),
                   ('x_r', 'f8'), ('pending', 'f8'), ('pulsed', 'i8'), ('hold', 'i8')])
ANSWER = np.dtype([('effort', 'f8'), ('area', 'f8'), ('guard', 'i8')])


@dataclass(frozen=True, kw_only=True)
class Controller(Parameters):
    """Gains and guards of the control law (Table I)."""

    m: float = parameter(0.1, 'kg', 'mass the impulses are computed for', lower=0.0,
                         open_lower=True)
    K: float = parameter(10.0, 'N/m', 'proportional gain (4)', lower=0.0, open_lower=True)
    D: float = parameter(0.5, 'N s/m', 'derivative gain (4)', lower=0.0)
    d_bar: float = parameter(1.5, 'N s/m', 'upper bound of the damping (1)(26)', lower=0.0,
                             open_lower=True)
    c: float = parameter(2.0, '', 'weight of the velocity-zero impulse (15)(26)',
                         choices=(1.0, 2.0))
    alpha_ratio: float = parameter(
        0.6, '', 'alpha / (m abs(v)), the gain of the position-zero impulse (19)', lower=0.5,
        upper=1.0, open_upper=True, reference='(19): 0.5 m abs(v) <= alpha < m abs(v)')
    x_r: float = parameter(0.0, 'm', 'set-point (4)')
    impulses: bool = parameter(True, '', 'whether impulses act; false leaves the PD loop (4)')
    effort_limit: float = parameter(
        0.0, 'N', 'largest effort, PD and impulse together; 0 for none', lower=0.0)
    position_deadband: float = parameter(
        1e-6, 'm', 'velocity-zero and sticking impulses need a larger error', lower=0.0)
    velocity_deadband: float = parameter(
        1e-6, 'm/s', 'counts as standing; position-zero impulses need more', lower=0.0)
    hold_off: int = parameter(
        0, 'samples', 'no impulse for so many samples after one at a position zero', lower=0)
    time_step: float = parameter(
        1e-4, 's', 'sampling period of plant and controller', lower=1e-9, upper=1.0,
        read_only=True)

    def check(self) -> None:
        """Stamps are integers: the sampling period is a whole number of nanoseconds."""
        nanoseconds(self.time_step, 'time_step')

    def packed(self) -> np.ndarray:
        """Return the kernels' view: shape (1,), dtype GAINS."""
        return np.array([tuple(getattr(self, name) for name in GAINS.fields or ())], GAINS)


def fresh_memory() -> np.ndarray:
    """Return the memory before the first sample: shape (1,), dtype MEMORY."""
    return np.zeros(1, MEMORY)


@numba.njit(cache=True)
def sign(value):
    """Return -1, 0 or 1."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


@numba.njit(cache=True)
def guard_of(memory, gains, position, direction):
    """Return the guard that the sample meets; ``direction`` is the sign of the velocity."""
    error = position - gains.x_r
    side = sign(error)
    if memory.started:
        before = sign(memory.position - gains.x_r)
        crossed = memory.side != 0.0 and side != memory.side and side != before
    else:
        crossed = side == 0.0
    if crossed and direction != 0.0:
        return POSITION_ZERO
    if memory.pending != 0.0 or abs(error) <= gains.position_deadband:
        return NO_IMPULSE
    if direction == 0.0 and (not memory.started or memory.x_r != gains.x_r):
        return VELOCITY_ZERO
    if direction == 0.0 and memory.direction == 0.0:
        return STICKING
    if memory.direction != 0.0 and direction != memory.direction and not memory.pulsed:
        return VELOCITY_ZERO
    return NO_IMPULSE


@numba.njit(cache=True)
def impulse_area(guard, gains, position, velocity):
    """Return the area of the guard's impulse in N s: (17) with (19) and (26)."""
    if guard == POSITION_ZERO:
        alpha = gains.alpha_ratio * gains.m * abs(velocity)
        return -2.0 * alpha * sign(velocity)
    error = position - gains.x_r
    beta = abs(error) * gains.d_bar / (2.0 * gains.c)
    c_event = 1.0 if guard == STICKING else 2.0
    return -c_event * beta * sign(error)


@numba.njit(cache=True)
def within(limit, effort):
    """Clip ``effort`` to +-limit; a limit of 0 is none."""
    return min(max(effort, -limit), limit) if limit > 0.0 else effort


@numba.njit(cache=True)
def answer_sample(memory, gains, position, velocity, answer):
    """Do the law of one sample on records: update ``memory``, fill ``answer``, in place."""
    direction = 0.0 if abs(velocity) <= gains.velocity_deadband else sign(velocity)
    guard = NO_IMPULSE
    if memory.hold > 0:
        memory.hold -= 1
    elif gains.impulses:
        guard = guard_of(memory, gains, position, direction)
    if not gains.impulses:
        memory.pending = 0.0
    answer.guard = guard
    answer.area = 0.0
    if guard != NO_IMPULSE:
        answer.area = impulse_area(guard, gains, position, velocity)
        memory.pending += answer.area
        if guard == POSITION_ZERO:
            memory.hold = gains.hold_off

    wanted = gains.K * (gains.x_r - position) - gains.D * velocity
    feedback = within(gains.effort_limit, wanted)
    answer.effort = feedback
    memory.pulsed = memory.pending != 0.0
    if memory.pulsed:
        pulse = memory.pending / gains.time_step
        answer.effort = within(gains.effort_limit, feedback + pulse)
        if answer.effort == feedback + pulse:
            memory.pending = 0.0
        else:
            memory.pending -= (answer.effort - feedback) * gains.time_step
    memory.started = 1
    memory.position, memory.side = position, sign(position - gains.x_r)
    memory.direction, memory.x_r = direction, gains.x_r


@numba.njit(cache=True)
def control(memory, gains, position, velocity, answer):
    """Do `answer_sample` on arrays of shape (1,): the form the controller node calls."""
    answer_sample(memory[0], gains[0], position, velocity, answer[0])
