"""
The control law of one sample: PD (4) plus the impulses of the jump map (17).

============  ==================  =======  ===============================================
symbol        name                unit     meaning
============  ==================  =======  ===============================================
e             error               m        x - x_r
K, D          K, D                N/m...   PD gains (4)
alpha         alpha_ratio         1        alpha = alpha_ratio * m * abs(v) (19)
beta          d_bar, c            N s      beta = abs(e) * d_bar / (2 c) (26)
c_event       c_event             1        2 through or onto zero velocity, 1 at a stick (15)
J             area                N s      impulse: -2 alpha sign(v) or -c_event beta sign(e)
I             integral            N        K_i times the integral of e
p             pole                1        exp(-2 pi velocity_bandwidth dt)
============  ==================  =======  ===============================================

The guards see samples only, and compare signs, never products (products underflow):

* position zero: the sign of e differs from that of the sample before, judged by its own and by
  the present set-point, so that a set-point jump is no crossing and a ramp fires once. The
  sample at exactly zero fires, the one after it does not. It needs abs(v) > velocity_deadband.
* velocity zero: the sign of v (0 within velocity_deadband) differs from that of the sample
  before, unless an impulse of our own acted in between. It needs abs(e) > position_deadband.
* sticking: the velocity was zero at this sample and at the one before. The first sample, and
  the first one after a set-point change, count as an arrival at zero velocity.

A sample that meets both guards acts as a position zero. An impulse of area J leaves as an
effort of J / dt for one sample. Under an effort limit the rest of the area is pending, and
velocity guards rest until it has left or impulses are switched off. Pending area is dropped where
it would push the axis away from the set-point. After a position zero no impulse starts for
hold_off samples.

Options for encoder steps, noise and no velocity at all (`LawOptions`):

* guard_lookahead: a position zero is one of e + guard_lookahead dt v. With 0.5 the impulse
  starts 0.25 samples off the crossing in the mean, in place of 0.5.
* position_hysteresis: a position zero disarms its guard until abs(e) has been larger, so an
  encoder that flickers between two steps is one crossing.
* velocity_hysteresis: an axis at rest moves again beyond velocity_deadband +
  velocity_hysteresis, so noise at the edge of the dead band is no arrival at zero.
* stiction_wait_samples: the axis has rested for that long since the last impulse before the
  next one, so the effect of the last one is seen. Behind a delay of n samples there would be n
  impulses for one. A set-point change at rest waits too, or a ramp would fire at each sample.
* K_i: the feedback is -K e - D v - I with I+ = I + K_i e dt. While effort_limit clips it and e
  would drive it further, I is held.
* Without a measured velocity (nan), and with velocity_source: estimated, v is the filtered
  difference of the positions,

      v_hat = p (v_hat + J / m) + (1 - p) (x - x_before) / dt,

  where J is the area that left with the last sample: the filter alone would show that jump
  1 / (2 pi velocity_bandwidth) late. One encoder step q makes v_hat jump by (1 - p) q / dt,
  some 2 pi velocity_bandwidth q. velocity_deadband is to be twice that.
"""

from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.control_gains import Gains, LawOptions
from impulse_control_ros.core.jit import compiled, record, sign, to_fixed_tuple

NO_IMPULSE, POSITION_ZERO, VELOCITY_ZERO, STICKING = range(4)
GUARDS = ('', 'position_zero', 'velocity_zero', 'sticking')
STILL = 1e-12  # m/s; a decaying estimate ends there, before its numbers become denormal


class LawState(NamedTuple):
    """
    What the law remembers of the samples before, all as floats; all zero before the first one.

    ``guard_position`` [m] is where the position guard looked and ``side`` the sign of its error
    there, ``direction`` the sign of the velocity, ``pending`` [N s] the area that waits,
    ``sent`` [N s] the area of which some left with the last sample and ``last_impulse`` [N s]
    how much, ``hold`` the samples of hold_off that remain. ``velocity`` [m/s] is measured or
    estimated, ``rest_samples`` counts from the last impulse, ``integral`` [N] is I.
    """

    started: float
    guard_position: float
    side: float
    direction: float
    x_r: float
    pending: float
    sent: float
    hold: float
    position: float
    velocity: float
    last_impulse: float
    disarmed: float
    rest_samples: float
    integral: float


class Command(NamedTuple):
    """Effort [N], area [N s] and guard of the impulse, and the velocity [m/s] that was used."""

    effort: float
    area: float
    guard: int
    velocity: float


FRESH = LawState(*[0.0] * len(LawState._fields))
COMMAND = record([('effort', 'f8'), ('area', 'f8'), ('guard', 'i8'), ('velocity', 'f8')])
STATES, GAINS, OPTIONS = len(LawState._fields), len(Gains._fields), len(LawOptions._fields)


@compiled
def control_step(state, gains, options, position, velocity):
    """
    Do the law of one sample; return its `Command` and the next `LawState`.

    ``options`` is None where all are off: numba then compiles the law without them. In that form
    conditions choose values and do nothing else, so a batch computes many runs at once.
    """
    velocity = velocity_of(state, gains, options, position, velocity)
    error, ahead = position - gains.x_r, looked_at(options, position, velocity)
    direction = direction_of(state.direction, gains, options, velocity)
    rest_samples = state.rest_samples + 1.0 if direction == 0.0 else 0.0
    guard = guard_met(state, gains, error, ahead - gains.x_r, direction)
    guard = armed(guard, state, options, direction, rest_samples)
    guard = guard if (state.hold == 0.0) & (gains.impulses != 0.0) else NO_IMPULSE
    area = impulse_area(guard, gains, error, velocity)
    owed = due(state.pending, area, error, velocity)
    owed = owed if gains.impulses != 0.0 else 0.0

    feedback, integral = feedback_of(gains, options, state.integral, error, velocity)
    effort, pending = saturated(gains, feedback, owed)
    command, left = Command(effort, area, guard, velocity), owed - pending
    if options is None:  # nothing reads these: the compiled loop is a sixth faster without
        position = velocity = left = rest_samples = 0.0
    after = LawState(
        started=1.0,
        guard_position=ahead,
        side=sign(ahead - gains.x_r),
        direction=direction,
        x_r=gains.x_r,
        pending=pending,
        sent=owed,
        hold=gains.hold_off if guard == POSITION_ZERO else max(state.hold - 1.0, 0.0),
        position=position,
        velocity=velocity,
        last_impulse=left,
        disarmed=is_disarmed(state, options, guard, ahead - gains.x_r),
        rest_samples=0.0 if owed != 0.0 else rest_samples,
        integral=integral,
    )
    return command, after


@compiled
def guard_met(state, gains, error, ahead, direction):
    """
    Return the guard that the sample meets.

    Position zeros are those of ``ahead`` [m], the error where the guard looks; ``direction`` is
    the sign of the velocity.
    """
    side, before = sign(ahead), sign(state.guard_position - gains.x_r)
    first = state.started == 0.0
    rests, rested = direction == 0.0, state.direction == 0.0

    turned = (direction != state.direction) & (not rested) & (state.sent == 0.0)
    crossed = (state.side != 0.0) & (side != state.side) & (side != before)
    crossed = side == 0.0 if first else crossed

    # From the weakest claim to the strongest.
    guard = VELOCITY_ZERO if turned else NO_IMPULSE
    guard = STICKING if rests & rested else guard
    guard = VELOCITY_ZERO if rests & (first | (state.x_r != gains.x_r)) else guard
    waits = (state.pending != 0.0) | (abs(error) <= gains.position_deadband)
    guard = NO_IMPULSE if waits else guard
    return POSITION_ZERO if crossed & (not rests) else guard


@compiled
def impulse_area(guard, gains, error, velocity):
    """Return the area of the guard's impulse in N s: (17) with (19) and (26)."""
    against = -gains.position_gain * velocity
    towards = -gains.velocity_gain * error
    share = 0.5 if guard == STICKING else 1.0  # c_event / 2
    towards = share * towards
    area = against if guard == POSITION_ZERO else towards
    return 0.0 if guard == NO_IMPULSE else area


@compiled
def within(limit, effort):
    """Clip ``effort`` to +-limit."""
    return min(max(effort, -limit), limit)


@compiled
def due(pending, area, error, velocity):
    """Return the pending and the new area [N s]; the former counts unless it drives e away."""
    way = sign(pending + area)
    return area if (way == sign(error)) & (way == sign(velocity)) else pending + area


@compiled
def saturated(gains, wanted_feedback, owed):
    """Return the effort [N], with what fits of the ``owed`` area [N s], and what does not."""
    feedback = within(gains.effort_limit, wanted_feedback)
    effort, pending = feedback, 0.0
    if owed != 0.0:
        wanted = feedback + owed * gains.sample_rate
        effort = within(gains.effort_limit, wanted)
        pending = 0.0 if effort == wanted else owed - (effort - feedback) * gains.time_step
    return effort, pending


@compiled
def velocity_of(state, gains, options, position, velocity):
    """Return the velocity that the law uses; an estimate is 0 at the first sample."""
    if options is None:
        return velocity
    if options.estimates == 0.0 and not np.isnan(velocity):
        return velocity
    if state.started == 0.0:
        return 0.0
    difference = (position - state.position) * gains.sample_rate
    moving = state.velocity + state.last_impulse * options.inverse_m
    estimate = options.pole * moving + (1.0 - options.pole) * difference
    return estimate if abs(estimate) > STILL else 0.0


@compiled
def looked_at(options, position, velocity):
    """Return where the position guard looks [m]."""
    if options is None:
        return position
    return position + options.lookahead_time * velocity


@compiled
def direction_of(before, gains, options, velocity):
    """Return the sign of the velocity, 0 at rest; ``before`` is that of the last sample."""
    if options is None:
        return 0.0 if abs(velocity) <= gains.velocity_deadband else sign(velocity)
    way, speed = sign(velocity), abs(velocity)
    moves = speed > options.release_velocity or (speed > gains.velocity_deadband and way == before)
    return way if moves else 0.0


@compiled
def armed(guard, state, options, direction, rest_samples):
    """Return ``guard``, or none where it is disarmed or the rest has been too short."""
    if options is None:
        return guard
    if guard == POSITION_ZERO:
        return NO_IMPULSE if state.disarmed != 0.0 else guard
    rested = direction == 0.0 and state.direction == 0.0 and state.started != 0.0
    return NO_IMPULSE if rested and rest_samples < options.stiction_wait_samples else guard


@compiled
def is_disarmed(state, options, guard, ahead):
    """Return whether position zeros are disarmed until the error ``ahead`` has been larger."""
    if options is None:
        return 0.0
    if abs(ahead) > options.position_hysteresis:
        return 0.0
    return 1.0 if guard == POSITION_ZERO else state.disarmed


@compiled
def feedback_of(gains, options, integral, error, velocity):
    """Return the feedback [N] that is wanted, and the integral [N] in it."""
    proportional = -gains.K * error - gains.D * velocity
    if options is None:
        return proportional, 0.0
    kept = integral if options.integral_gain != 0.0 else 0.0  # K_i may have been set to 0
    grown = kept + options.integral_gain * error
    wanted = proportional - grown
    clipped = abs(wanted) > gains.effort_limit and sign(wanted) == -sign(error)
    kept = kept if clipped else grown
    return proportional - kept, kept


@compiled
def gains_of(law):
    """Return the `Gains` in the values of a LAW record: a float array of its size."""
    return Gains(*to_fixed_tuple(law, GAINS))


@compiled
def options_of(law):
    """Return the `LawOptions` in the values of a LAW record: a float array of its size."""
    return LawOptions(*to_fixed_tuple(law[GAINS:], OPTIONS))


@compiled
def control_in_place(state, law, position, velocity, command):
    """
    Do `control_step` on arrays, which Python passes at a tenth of the cost of named tuples.

    ``state`` and ``law`` have the values of a `LawState` and of a LAW record; ``command`` is of
    shape (1,), dtype COMMAND.
    """
    before = LawState(*to_fixed_tuple(state, STATES))
    answer, after = control_step(before, gains_of(law), options_of(law), position, velocity)
    for i in range(STATES):
        state[i] = after[i]
    now = command[0]
    now.effort, now.area, now.guard, now.velocity = answer


@compiled
def answer_samples(state, gains, options, position, velocity, commands):
    """Answer n samples, arrays of shape (n,), into ``commands``; return the last `LawState`."""
    for k in range(len(position)):
        answer, state = control_step(state, gains, options, position[k], velocity[k])
        now = commands[k]
        now.effort, now.area, now.guard, now.velocity = answer
    return state
