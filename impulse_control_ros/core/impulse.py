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
guards rest until it has left, or until impulses are switched off. What waits is dropped where it
would push the axis on, away from the set-point, as after a wrong sample, or with a tight limit.
After a position zero no impulse starts for hold_off samples.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.parameter import FAR, parameter, Parameters
from impulse_control_ros.core.tick import nanoseconds

NO_IMPULSE, POSITION_ZERO, VELOCITY_ZERO, STICKING = range(4)
GUARDS = ('', 'position_zero', 'velocity_zero', 'sticking')


class Gains(NamedTuple):
    """
    What the law reads, every value as a float, by the names of `ControlGains`.

    Besides: position_gain = 2 alpha / abs(v) [kg], velocity_gain = 2 beta / abs(e) [N s/m],
    sample_rate = 1 / time_step [Hz], and no effort_limit is an infinite one.
    """

    K: float
    D: float
    position_gain: float
    velocity_gain: float
    x_r: float
    impulses: float
    effort_limit: float
    position_deadband: float
    velocity_deadband: float
    hold_off: float
    time_step: float
    sample_rate: float


class Memory(NamedTuple):
    """What the guards remember of the sample before, and the area that waits to leave."""

    started: float
    position: float
    side: float
    direction: float
    x_r: float
    pending: float
    pulsed: float
    hold: float


GAINS = np.dtype([(name, 'f8') for name in Gains._fields])
MEMORY = np.dtype([(name, 'f8') for name in Memory._fields])
# the velocity is the one that the law took
ANSWER = np.dtype([('effort', 'f8'), ('area', 'f8'), ('guard', 'i8'), ('velocity', 'f8')])


@dataclass(frozen=True, kw_only=True)
class ControlGains(Parameters):
    """Gains and guards of the control law (Table I)."""

    m: float = parameter(
        0.1, 'kg', 'mass the impulses are computed for', lower=0.0, open_lower=True
    )
    K: float = parameter(10.0, 'N/m', 'proportional gain (4)', lower=0.0, open_lower=True)
    D: float = parameter(0.5, 'N s/m', 'derivative gain (4)', lower=0.0)
    d_bar: float = parameter(
        1.5, 'N s/m', 'upper bound of the damping (1)(26)', lower=0.0, open_lower=True
    )
    c: float = parameter(
        2.0, '', 'weight of the velocity-zero impulse (15)(26)', choices=(1.0, 2.0)
    )
    alpha_ratio: float = parameter(
        0.6,
        '',
        'alpha / (m abs(v)), the gain of the position-zero impulse (19)',
        lower=0.5,
        upper=1.0,
        open_upper=True,
        reference='(19): 0.5 m abs(v) <= alpha < m abs(v)',
    )
    x_r: float = parameter(0.0, 'm', 'set-point (4)', lower=-FAR, upper=FAR)
    K_i: float = parameter(
        0.0,
        'N/(m s)',
        'integral gain, which makes the PD loop a PID; it rests while '
        'effort_limit does not let it act',
        lower=0.0,
    )
    impulses: bool = parameter(True, '', 'whether impulses act; false leaves the PD loop (4)')
    effort_limit: float = parameter(
        0.0, 'N', 'largest effort, PD and impulse together; 0 for none', lower=0.0
    )
    position_deadband: float = parameter(
        1e-6, 'm', 'velocity-zero and sticking impulses need a larger error', lower=0.0
    )
    velocity_deadband: float = parameter(
        1e-6, 'm/s', 'counts as standing; position-zero impulses need more', lower=0.0
    )
    hold_off: int = parameter(
        0, 'samples', 'no impulse for so many samples after one at a position zero', lower=0
    )
    guard_lookahead: float = parameter(
        0.0,
        'samples',
        'how far ahead the guards look; 0.5 halves the delay of a position zero',
        lower=0.0,
        upper=1.0,
    )
    position_hysteresis: float = parameter(
        0.0, 'm', 'a position zero counts once until the error has been larger', lower=0.0
    )
    velocity_hysteresis: float = parameter(
        0.0, 'm/s', 'beyond the dead band, before the axis counts as moving again', lower=0.0
    )
    stiction_wait_samples: int = parameter(
        1,
        'samples',
        'standing since the last impulse, before one that releases; longer than '
        'the actuator needs to act',
        lower=1,
    )
    velocity_source: str = parameter(
        'measured',
        '',
        'velocity the law acts on: that of the message, where it has one, or one '
        'that is estimated from the positions',
        choices=('measured', 'estimated'),
    )
    velocity_bandwidth: float = parameter(
        50.0,
        'Hz',
        'corner of the filter that estimates the velocity; '
        'velocity_deadband above 4 pi times it times the step of the encoder',
        lower=0.0,
        open_lower=True,
    )
    time_step: float = parameter(
        1e-4, 's', 'sampling period of plant and controller', lower=1e-9, upper=1.0, read_only=True
    )

    def check(self) -> None:
        """Stamps are integers: the sampling period is a whole number of nanoseconds."""
        nanoseconds(self.time_step, 'time_step')

    def packed(self) -> np.ndarray:
        """Return the kernels' view: shape (1,), dtype GAINS."""
        return packed_gains(self.flat(), 1)


def packed_gains(values: Mapping[str, Any], runs: int) -> np.ndarray:
    """Pack values, or arrays of shape (runs,), by the names of `ControlGains`: dtype GAINS."""
    limit = np.asarray(values['effort_limit'])
    derived = {
        'position_gain': 2.0 * values['alpha_ratio'] * values['m'],
        'velocity_gain': values['d_bar'] / values['c'],
        'effort_limit': np.where(limit > 0.0, limit, np.inf),
        'sample_rate': 1.0 / values['time_step'],
    }
    gains = np.zeros(runs, GAINS)
    for name in Gains._fields:
        gains[name] = derived[name] if name in derived else values[name]
    return gains


def fresh_memory() -> np.ndarray:
    """Return the memory before the first sample: shape (1,), dtype MEMORY."""
    return np.zeros(1, MEMORY)


@compiled
def guard_of(memory, gains, error, ahead, direction):
    """
    Return the guard that the sample meets.

    Position zeros are those of ``ahead`` [m], the error or where it will be, as in the memory;
    ``direction`` is the sign of the velocity.
    """
    side, before = sign(ahead), sign(memory.position - gains.x_r)
    first = memory.started == 0.0
    stands, stood = direction == 0.0, memory.direction == 0.0

    turned = (direction != memory.direction) & (not stood) & (memory.pulsed == 0.0)
    crossed = (memory.side != 0.0) & (side != memory.side) & (side != before)
    crossed = side == 0.0 if first else crossed

    # From the weakest claim to the strongest.
    guard = VELOCITY_ZERO if turned else NO_IMPULSE
    guard = STICKING if stands & stood else guard
    guard = VELOCITY_ZERO if stands & (first | (memory.x_r != gains.x_r)) else guard
    rests = (memory.pending != 0.0) | (abs(error) <= gains.position_deadband)
    guard = NO_IMPULSE if rests else guard
    return POSITION_ZERO if crossed & (not stands) else guard


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
    """Return what waits and comes [N s], without the former where it drives the axis away."""
    way = sign(pending + area)
    return area if (way == sign(error)) & (way == sign(velocity)) else pending + area


@compiled
def sent(gains, wanted_feedback, pending):
    """Return the effort [N], with what fits of the ``pending`` area [N s], and what does not."""
    feedback = within(gains.effort_limit, wanted_feedback)
    effort, waits = feedback, 0.0
    if pending != 0.0:
        wanted = feedback + pending * gains.sample_rate
        effort = within(gains.effort_limit, wanted)
        waits = 0.0 if effort == wanted else pending - (effort - feedback) * gains.time_step
    return effort, waits


@compiled
def answered(memory, gains, position, velocity):
    """
    Do the law of one sample; return (effort [N], area [N s], guard, memory).

    Conditions choose values and do nothing else: a batch computes both sides, for many runs.
    """
    error = position - gains.x_r
    direction = 0.0 if abs(velocity) <= gains.velocity_deadband else sign(velocity)
    met = guard_of(memory, gains, error, error, direction)
    guard = met if (memory.hold == 0.0) & (gains.impulses != 0.0) else NO_IMPULSE
    area = impulse_area(guard, gains, error, velocity)
    owed = due(memory.pending, area, error, velocity)
    pending = owed if gains.impulses != 0.0 else 0.0

    effort, waits = sent(gains, -gains.K * error - gains.D * velocity, pending)
    hold = gains.hold_off if guard == POSITION_ZERO else max(memory.hold - 1.0, 0.0)
    return (
        effort,
        area,
        guard,
        Memory(1.0, position, sign(error), direction, gains.x_r, waits, pending, hold),
    )


@compiled
def unpacked(gains):
    """Return the `Gains` of a record."""
    return Gains(
        gains.K,
        gains.D,
        gains.position_gain,
        gains.velocity_gain,
        gains.x_r,
        gains.impulses,
        gains.effort_limit,
        gains.position_deadband,
        gains.velocity_deadband,
        gains.hold_off,
        gains.time_step,
        gains.sample_rate,
    )


@compiled
def fresh():
    """Return the memory before the first sample."""
    return Memory(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
