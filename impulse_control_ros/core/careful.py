"""
The control law of core/impulse.py on real signals: encoder steps, noise, no velocity at all.

====================  ==========================  =======  ========================================
symbol                name                        unit     meaning
====================  ==========================  =======  ========================================
v_hat                 velocity                    m/s      measured, or estimated from positions
p                     pole                        1        exp(-2 pi velocity_bandwidth dt)
e + guard_lookahead dt v         ahead                       m        where the guards look
c                     stood                       samples  standing, counted anew at each impulse
I                     integral                    N        K_i times the integral of e
====================  ==========================  =======  ========================================

With all options off this is `answered`, to the same bits. What they change, guard by guard:

* position zero: looks ``guard_lookahead`` samples ahead, at e + guard_lookahead dt v in place
  of e. With guard_lookahead = 0.5 the
  impulse starts at the sample next to the crossing, 0.25 samples off in the mean, in place of
  the one after it, 0.5 off. A crossing counts once, until abs(e) has exceeded
  position_hysteresis: an encoder that flickers is no crossing.
* velocity zero: a velocity that was zero is one again only beyond velocity_deadband +
  velocity_hysteresis: noise at the edge of the dead band is no arrival at zero.
* sticking: the axis has stood for stiction_wait_samples since the last impulse, so that what
  that one
  did is seen before the next; behind a delay of n samples there would be n impulses for one. A
  set-point that changes at rest waits for this too, or a ramp would give an impulse at each
  sample.

With K_i the feedback is that of a PID, -K e - D v - I with I+ = I + K_i e dt. While effort_limit
clips it and e would drive it further, I rests, so nothing winds up.

Without a measured velocity (nan), and with velocity_source: estimated, it is the filtered
difference of the positions,

    v_hat = p (v_hat + J / m) + (1 - p) (x - x_before) / dt,

where J is the area that left with the last sample: the filter would see that jump 1 / (2 pi
velocity_bandwidth) late, and the guards would act on a velocity that is no more. One step q of
the encoder makes it jump by (1 - p) q / dt, some 2 pi velocity_bandwidth q: velocity_deadband is
to be twice that, or the estimate of an axis at rest is taken for motion.
"""

from collections.abc import Mapping
import math
from operator import attrgetter
from typing import Any

import numpy as np

from impulse_control_ros.core.impulse import (
    ControlGains,
    due,
    guard_of,
    impulse_area,
    Memory,
    NO_IMPULSE,
    POSITION_ZERO,
    sent,
    unpacked,
)
from impulse_control_ros.core.jit import compiled, sign

CARE = np.dtype(
    [
        (name, 'f8')
        for name in (
            'lead_time',
            'position_hysteresis',
            'rearm',
            'stiction_wait_samples',
            'pole',
            'inverse_m',
            'integral_gain',
            'estimates',
        )
    ]
)
WATCH = np.dtype(
    [
        (name, 'f8')
        for name in ('seen', 'position', 'velocity', 'kick', 'unarmed', 'stood', 'integral')
    ]
)
OFF = {
    'guard_lookahead': 0.0,
    'position_hysteresis': 0.0,
    'velocity_hysteresis': 0.0,
    'stiction_wait_samples': 1,
    'K_i': 0.0,
    'velocity_source': 'measured',
}
OPTIONS, ALL_OFF = attrgetter(*OFF), tuple(OFF.values())
STILL = 1e-12  # m/s; a decaying estimate ends there, before its numbers become denormal


def packed_care(values: Mapping[str, Any], runs: int) -> np.ndarray:
    """Pack values, or arrays of shape (runs,), by the names of `ControlGains`: dtype CARE."""
    care = np.zeros(runs, CARE)
    care['lead_time'] = np.asarray(values['guard_lookahead']) * values['time_step']
    care['position_hysteresis'] = values['position_hysteresis']
    care['rearm'] = np.asarray(values['velocity_deadband']) + values['velocity_hysteresis']
    care['stiction_wait_samples'] = values['stiction_wait_samples']
    turn = np.broadcast_to(np.asarray(values['velocity_bandwidth']) * values['time_step'], runs)
    # math's exp, value by value: numpy's differs in the last bit from machine to machine.
    care['pole'] = [math.exp(-2.0 * math.pi * item) for item in turn.tolist()]
    care['inverse_m'] = 1.0 / np.asarray(values['m'])
    care['estimates'] = np.asarray(values['velocity_source']) == 'estimated'
    care['integral_gain'] = np.asarray(values['K_i']) * values['time_step']
    return care


def packed_law(controller: ControlGains) -> tuple[np.ndarray, np.ndarray]:
    """Return the kernels' view of a controller, gains and care: shape (1,), GAINS and CARE."""
    return controller.packed(), packed_care(controller.flat(), 1)


def is_plain(controller: ControlGains) -> bool:
    """Tell whether `answered` is all that the controller needs; else it is this file's law."""
    return bool(OPTIONS(controller) == ALL_OFF)


def fresh_watch() -> np.ndarray:
    """Return what is remembered besides `fresh_memory` before the first sample: dtype WATCH."""
    return np.zeros(1, WATCH)


@compiled
def estimated(watch, gains, care, position):
    """Return the velocity from the positions alone; 0 at the first."""
    if watch.seen == 0.0:
        return 0.0
    difference = (position - watch.position) * gains.sample_rate
    velocity = (
        care.pole * (watch.velocity + watch.kick * care.inverse_m) + (1.0 - care.pole) * difference
    )
    return velocity if abs(velocity) > STILL else 0.0


@compiled
def direction_of(before, gains, care, velocity):
    """Return the sign of the velocity, 0 at rest; ``before`` is that of the last sample."""
    way, speed = sign(velocity), abs(velocity)
    moves = speed > care.rearm or (speed > gains.velocity_deadband and way == before)
    return way if moves else 0.0


@compiled
def allowed(guard, memory, watch, care, direction, stood):
    """Return ``guard``, or none where it is to wait."""
    if guard == POSITION_ZERO:
        return NO_IMPULSE if watch.unarmed != 0.0 else guard
    at_rest = direction == 0.0 and memory.direction == 0.0 and memory.started != 0.0
    return NO_IMPULSE if at_rest and stood < care.stiction_wait_samples else guard


@compiled
def feedback_of(gains, care, integral, error, velocity):
    """Return the feedback [N] that is wanted, with the integral [N] of this sample, and that."""
    proportional = -gains.K * error - gains.D * velocity
    kept = integral if care.integral_gain != 0.0 else 0.0  # K_i may have been taken away
    grown = kept + care.integral_gain * error
    wanted = proportional - grown
    clipped = abs(wanted) > gains.effort_limit and sign(wanted) == -sign(error)
    kept = kept if clipped else grown
    return proportional - kept, kept


@compiled
def control_carefully(memory, watch, gains, care, position, velocity, answer):
    """
    Do the law of one sample in place: update ``memory`` and ``watch``, fill ``answer``.

    Those, ``gains`` and ``care`` are arrays of shape (1,), the form that the controller node has.
    """
    law, wary, old, seen, told = unpacked(gains[0]), care[0], memory[0], watch[0], answer[0]
    before = Memory(
        old.started,
        old.position,
        old.side,
        old.direction,
        old.x_r,
        old.pending,
        old.pulsed,
        old.hold,
    )
    if wary.estimates != 0.0 or np.isnan(velocity):
        velocity = estimated(seen, law, wary, position)
    error, ahead = position - law.x_r, position + wary.lead_time * velocity
    direction = direction_of(before.direction, law, wary, velocity)
    stood = seen.stood + 1.0 if direction == 0.0 else 0.0
    met = guard_of(before, law, error, ahead - law.x_r, direction)
    met = allowed(met, before, seen, wary, direction, stood)
    guard = met if before.hold == 0.0 and law.impulses != 0.0 else NO_IMPULSE
    area = impulse_area(guard, law, error, velocity)
    owed = due(before.pending, area, error, velocity)
    pending = owed if law.impulses != 0.0 else 0.0
    feedback, integral = feedback_of(law, wary, seen.integral, error, velocity)
    effort, waits = sent(law, feedback, pending)

    told.effort, told.area, told.guard, told.velocity = effort, area, guard, velocity
    old.started, old.position, old.side = 1.0, ahead, sign(ahead - law.x_r)
    old.direction, old.x_r, old.pending, old.pulsed = direction, law.x_r, waits, pending
    old.hold = law.hold_off if guard == POSITION_ZERO else max(before.hold - 1.0, 0.0)
    seen.seen, seen.position, seen.velocity, seen.kick = 1.0, position, velocity, pending - waits
    seen.stood, seen.integral = 0.0 if pending != 0.0 else stood, integral
    far = abs(ahead - law.x_r) > wary.position_hysteresis
    seen.unarmed = 0.0 if far else (1.0 if guard == POSITION_ZERO else seen.unarmed)
