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

The guards see only samples and compare signs, not products, which underflow:

* position zero: the sign of e differs from its sign at the previous sample, judged by both the
  previous and the present set-point, so that a set-point jump is no crossing and a ramp fires
  once. A sample at exactly zero fires, the next one does not. The guard needs abs(v) >
  velocity_deadband.
* velocity zero: the sign of v (0 within velocity_deadband) differs from its sign at the previous
  sample, unless an impulse acted in between. The guard needs abs(e) > position_deadband.
* sticking: the velocity is zero at this and the previous sample. Zero velocity at the first
  sample, or at the first one after a set-point change, counts as a velocity zero instead.

A sample that meets a position and a velocity guard fires as a position zero. An impulse of area J
is applied as an effort of J / dt for one sample. Area that exceeds effort_limit stays pending, and
velocity guards are disabled until it has been applied or impulses are switched off. Pending area
is dropped where it would push the axis away from the set-point. After a position zero, no impulse
starts for hold_off samples.

Options for encoder steps, noise and unmeasured velocity (`LawOptions`):

* guard_lookahead: position zeros are detected on e + guard_lookahead dt v. With 0.5 the impulse
  starts 0.25 samples off the crossing on average, instead of 0.5.
* position_hysteresis: a position zero disarms its guard until abs(e) has exceeded the hysteresis,
  so an encoder that flickers between two steps causes one impulse.
* velocity_hysteresis: an axis at rest moves again above velocity_deadband + velocity_hysteresis,
  so noise at the edge of the dead band causes no velocity zero.
* stiction_wait_samples: an axis at rest waits this long after an impulse before the next one, so
  that the first can take effect. Otherwise a delay of n samples would cause n impulses instead of
  one. A set-point change at rest waits too; otherwise a ramp would fire at each sample.
* K_i: the feedback is -K e - D v - I with I+ = I + K_i e dt. I is held while effort_limit clips
  the feedback and e would drive it further.
* Without a measured velocity (nan), or with velocity_source: estimated, v is the filtered
  difference of the positions,

      v_hat = p (v_hat + J / m) + (1 - p) (x - x_before) / dt,

  where J is the area applied over the last sample; the filter alone would lag behind that jump by
  1 / (2 pi velocity_bandwidth). One encoder step q makes v_hat jump by (1 - p) q / dt, about 2 pi
  velocity_bandwidth q; velocity_deadband should be at least twice that.
"""

from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.control_gains import Gains, LawOptions
from impulse_control_ros.core.jit import compiled, record, sign, to_fixed_tuple
from impulse_control_ros.core.jump import mass_scale
from impulse_control_ros.core.supervision import (
    begin_supervision,
    may_fire,
    note_impulse,
    observe,
    TRIAL,
)
from impulse_control_ros.core.suspension import note_turn

NO_IMPULSE, POSITION_ZERO, VELOCITY_ZERO, STICKING = range(4)
GUARDS = ('', 'position_zero', 'velocity_zero', 'sticking')
STILL = 1e-12  # m/s; a smaller estimate is set to 0, before it becomes denormal


class LawState(NamedTuple):
    """
    Memory of the law between samples, all floats; all zero before the first sample.

    ``guard_position`` [m] is the position that the position guard evaluated, ``side`` the sign of
    the error there, and ``direction`` the sign of the velocity. ``sent`` [N s] is the area due at
    the last sample, ``last_impulse`` [N s] the part applied and ``pending`` [N s] the rest.
    ``hold`` counts the remaining samples of hold_off, ``rest_samples`` the samples at rest since
    the last impulse. ``velocity`` [m/s] is measured or estimated, ``integral`` [N] is I.
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
    """
    Effort [N], area [N s] and guard of the impulse, and the velocity [m/s] that was used.

    ``verdict`` is that of the supervision on an earlier impulse, ``ratio`` its jump over the
    expected one.
    """

    effort: float
    area: float
    guard: int
    velocity: float
    verdict: int
    ratio: float


FRESH = LawState(*[0.0] * len(LawState._fields))
COMMAND = record(
    [
        ('effort', 'f8'),
        ('area', 'f8'),
        ('guard', 'i8'),
        ('velocity', 'f8'),
        ('verdict', 'i8'),
        ('ratio', 'f8'),
    ]
)
STATES, GAINS, OPTIONS = len(LawState._fields), len(Gains._fields), len(LawOptions._fields)


@compiled
def control_step(state, gains, options, memory, position, velocity, exact=False):
    """
    Evaluate the law at one sample; return the `Command` and the next `LawState`.

    ``memory`` is that of the supervision, a record of dtype SUPERVISION. If ``options`` and
    ``memory`` are None (all off), numba compiles the law without them. Conditions then only select
    values, so a batch computes many runs at once. An ``exact`` sample is known to have no noise.
    """
    is_measured = not np.isnan(velocity)
    velocity = velocity_of(state, gains, options, memory, position, velocity)
    error, free, verdict, ratio = position - gains.x_r, True, 0, 0.0
    is_supervised = False if options is None else options.supervision != 0.0
    if is_supervised:
        memory.estimated = 0.0 if is_measured and options.estimates == 0.0 else 1.0
        if state.started == 0.0 or memory.learnt.inverse_m == 0.0:
            begin_supervision(memory, options, error, velocity)
        else:
            observe(memory, state, gains, options, position, error, velocity, exact)
        free, verdict, ratio = may_fire(memory), memory.verdict, memory.ratio
        gains = learnt_gains(gains, options, memory)
    elif options is not None:  # it begins anew when it is switched on
        memory.learnt.inverse_m = memory.learnt.jumps = memory.suspension.left = 0.0
        memory.learnt.mass = 1.0
    guarded, braked, ahead = looked_at(gains, options, memory, position, velocity)
    direction = direction_of(state.direction, gains, options, guarded)
    rest_samples = state.rest_samples + 1.0 if direction == 0.0 else 0.0
    guard = guard_met(state, gains, error, ahead - gains.x_r, direction)
    guard = armed(guard, state, options, direction, rest_samples)
    guard = guard if (state.hold == 0.0) & (gains.impulses != 0.0) & free else NO_IMPULSE
    if is_supervised:
        guard = guard if (memory.flight.age == 0.0) | (guard == STICKING) else NO_IMPULSE
    area = impulse_area(guard, gains, error, braked)
    owed = due(state.pending, area, error, guarded)
    owed = owed if gains.impulses != 0.0 else 0.0

    feedback, integral = feedback_of(gains, options, state.integral, error, velocity)
    effort, pending = saturated(gains, feedback, owed)
    command, left = Command(effort, area, guard, velocity, verdict, ratio), owed - pending
    guard_position, side = ahead, sign(ahead - gains.x_r)
    disarmed = is_disarmed(state, options, guard, ahead - gains.x_r)
    if is_supervised:
        if memory.flight.age > 0.0:  # a crossing during the flight counts when it has ended
            guard_position, side = state.guard_position, state.side
        if owed != 0.0:
            note_impulse(memory, options, guard == POSITION_ZERO, direction, owed, left, error)
        if direction != state.direction and state.direction != 0.0:
            note_turn(memory.suspension, error, owed != 0.0)
    if options is None:  # unused then; clearing them makes the loop a sixth faster
        position = velocity = left = rest_samples = 0.0
    after = LawState(
        started=1.0,
        guard_position=guard_position,
        side=side,
        direction=direction,
        x_r=gains.x_r,
        pending=pending,
        sent=owed,
        hold=gains.hold_off if guard == POSITION_ZERO else max(state.hold - 1.0, 0.0),
        position=position,
        velocity=velocity,
        last_impulse=left,
        disarmed=disarmed,
        rest_samples=0.0 if owed != 0.0 else rest_samples,
        integral=integral,
    )
    return command, after


@compiled
def learnt_gains(gains, options, memory):
    """
    Return the gains for the learnt mass, delay and noise, reduced after a suspension.

    Behind a delay the impulse at a position zero has the least alpha that (19) allows, which stops
    the axis: a second one would come too late.
    """
    learnt, noise = memory.learnt, memory.noise
    scale = mass_scale(learnt, options)
    share = TRIAL if memory.suspension.trial != 0.0 else 1.0
    position_gain = gains.position_gain
    if learnt.delay > 1.0 and learnt.jumps > 0.0:
        position_gain = 1.0 / options.inverse_m
    sd = noise.velocity.sd if memory.flight.by_difference == 0.0 else noise.difference.sd
    if memory.estimated != 0.0:
        sd *= 1.0 - options.pole
    return Gains(
        K=gains.K,
        D=gains.D,
        position_gain=share * position_gain * scale,
        velocity_gain=share * gains.velocity_gain * (np.sqrt(scale) if scale > 1.0 else 1.0),
        x_r=gains.x_r,
        impulses=gains.impulses,
        effort_limit=gains.effort_limit,
        position_deadband=max(
            gains.position_deadband, 3.0 * noise.difference.sd * gains.time_step
        ),
        velocity_deadband=max(gains.velocity_deadband, 5.0 * sd),
        hold_off=gains.hold_off,
        time_step=gains.time_step,
        sample_rate=gains.sample_rate,
    )


@compiled
def guard_met(state, gains, error, ahead, direction):
    """
    Return the guard that the sample meets.

    Position zeros are detected on ``ahead`` [m], the error at the lookahead; ``direction`` is the
    sign of the velocity.
    """
    side, before = sign(ahead), sign(state.guard_position - gains.x_r)
    first = state.started == 0.0
    rests, rested = direction == 0.0, state.direction == 0.0

    turned = (direction != state.direction) & (not rested) & (state.sent == 0.0)
    crossed = (state.side != 0.0) & (side != state.side) & (side != before)
    crossed = side == 0.0 if first else crossed

    # In ascending order of precedence.
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
    """Return the area due [N s]: new plus pending; new only if the sum drives the axis away."""
    way = sign(pending + area)
    return area if (way == sign(error)) & (way == sign(velocity)) else pending + area


@compiled
def saturated(gains, wanted_feedback, owed):
    """Return the clipped effort [N] and the part of the ``owed`` area [N s] that stays pending."""
    feedback = within(gains.effort_limit, wanted_feedback)
    effort, pending = feedback, 0.0
    if owed != 0.0:
        wanted = feedback + owed * gains.sample_rate
        effort = within(gains.effort_limit, wanted)
        pending = 0.0 if effort == wanted else owed - (effort - feedback) * gains.time_step
    return effort, pending


@compiled
def velocity_of(state, gains, options, memory, position, velocity):
    """Return the velocity that the law uses; an estimate is 0 at the first sample."""
    if options is None:
        return velocity
    if options.estimates == 0.0 and not np.isnan(velocity):
        return velocity
    if state.started == 0.0:
        return 0.0
    difference = (position - state.position) * gains.sample_rate
    inverse_m = options.inverse_m
    if options.supervision != 0.0 and state.started != 0.0:
        inverse_m /= mass_scale(memory.learnt, options)
    moving = state.velocity + state.last_impulse * inverse_m
    estimate = options.pole * moving + (1.0 - options.pole) * difference
    return estimate if abs(estimate) > STILL else 0.0


@compiled
def looked_at(gains, options, memory, position, velocity):
    """
    Return the velocity for the guards, that of an impulse at a position zero, and its position.

    The last two are predicted for the instant at which an impulse acts.
    """
    if options is None:
        return velocity, velocity, position
    if options.supervision == 0.0:
        return velocity, velocity, position + options.lookahead_time * velocity
    flight, learnt, noise = memory.flight, memory.learnt, memory.noise
    if flight.by_difference != 0.0 and memory.estimated == 0.0:
        velocity = noise.difference.value
    if learnt.delay == 0.0:
        return velocity, velocity, position + options.lookahead_time * velocity
    delay = learnt.delay * gains.time_step
    decay = options.half_d_bar * delay * options.inverse_m / mass_scale(learnt, options)
    ahead = position + velocity * (options.lookahead_time + delay / (1.0 + 0.5 * decay))
    guarded = velocity
    if flight.age == 0.0:
        sd = noise.difference.sd if flight.by_difference != 0.0 else noise.velocity.sd
        blocks = learnt.delay / flight.size
        stops = (velocity + flight.trend * blocks) * velocity < 0.0
        if stops and 3.0 * sd * blocks < abs(velocity):
            guarded = 0.0  # the axis stands when the impulse acts
    return guarded, velocity / (1.0 + decay), ahead


@compiled
def direction_of(before, gains, options, velocity):
    """Return the sign of the velocity, 0 at rest; ``before`` is the sign at the last sample."""
    if options is None:
        return 0.0 if abs(velocity) <= gains.velocity_deadband else sign(velocity)
    way, speed = sign(velocity), abs(velocity)
    release = max(options.release_velocity, gains.velocity_deadband)
    moves = speed > release or (speed > gains.velocity_deadband and way == before)
    return way if moves else 0.0


@compiled
def armed(guard, state, options, direction, rest_samples):
    """Return ``guard``, or NO_IMPULSE if it is disarmed or the axis has rested too briefly."""
    if options is None:
        return guard
    if guard == POSITION_ZERO:
        return NO_IMPULSE if state.disarmed != 0.0 else guard
    rested = direction == 0.0 and state.direction == 0.0 and state.started != 0.0
    return NO_IMPULSE if rested and rest_samples < options.stiction_wait_samples else guard


@compiled
def is_disarmed(state, options, guard, ahead):
    """Return 1 while position zeros are disarmed; a larger error ``ahead`` [m] rearms them."""
    if options is None:
        return 0.0
    if abs(ahead) > options.position_hysteresis:
        return 0.0
    return 1.0 if guard == POSITION_ZERO else state.disarmed


@compiled
def feedback_of(gains, options, integral, error, velocity):
    """Return the unclipped feedback [N] and its integral part [N]."""
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
    """Return the `Gains` of a LAW record, given as a float array."""
    return Gains(*to_fixed_tuple(law, GAINS))


@compiled
def options_of(law):
    """Return the `LawOptions` of a LAW record, given as a float array."""
    return LawOptions(*to_fixed_tuple(law[GAINS:], OPTIONS))


@compiled
def control_in_place(state, memory, law, position, velocity, command):
    """
    Do `control_step` on arrays, which Python passes ten times faster than named tuples.

    ``state`` and ``law`` hold the values of a `LawState` and a LAW record; ``memory`` and
    ``command`` have shape (1,), dtypes SUPERVISION and COMMAND.
    """
    before = LawState(*to_fixed_tuple(state, STATES))
    answer, after = control_step(
        before, gains_of(law), options_of(law), memory[0], position, velocity
    )
    for i in range(STATES):
        state[i] = after[i]
    put(command[0], answer)


@compiled
def answer_samples(state, gains, options, memory, position, velocity, commands):
    """Fill ``commands`` with the answers to n samples, shape (n,); return the last `LawState`."""
    for k in range(len(position)):
        answer, state = control_step(state, gains, options, memory[0], position[k], velocity[k])
        put(commands[k], answer)
    return state


@compiled
def put(record, command):
    """Write a `Command` to a record of dtype COMMAND."""
    record.effort, record.area, record.guard, record.velocity = command[:4]
    record.verdict, record.ratio = command.verdict, command.ratio
