"""
Differences between an ideal axis and a real one, each off by default.

======================  ==========================  ========  ===================================
symbol                  name                        unit      meaning
======================  ==========================  ========  ===================================
q                       sensor.resolution           m         step of the encoder
s_x, s_v                sensor.position_noise, ...  m, m/s    standard deviations of the noise
u_max                   actuator.limit              N         largest effort
T                       actuator.time_constant      s         first-order lag
n                       actuator.delay              samples   from a command to the actuator
dm                      payload.mass                kg        added to m from payload.time on
w                       disturbance.force           N         force beside the effort
======================  ==========================  ========  ===================================

A command is delayed, then limited, then lagged. The output of the lag between two samples is an
exponential; its mean over the sample drives the axis,

    u = c + (a - c) (1 - p) T / dt,    a+ = c + (a - c) p,    p = exp(-dt / T),

so the area of every command is preserved exactly, and the position error is less than abs(c - a)
dt^2 / (8 m). All else is exact, because the disturbance is constant over the sample. The velocity
is continuous when the payload changes.

Noise is a hash of (seed, tick), as in core/damping.py, so a run depends only on its parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from impulse_control_ros.core.damping import (
    bandwidth_parameter,
    KINDS,
    low_pass_pole,
    MOST_SEED,
    NOISE,
    sine,
    SINUSOIDAL,
    white,
    word,
)
from impulse_control_ros.core.jit import compiled, record
from impulse_control_ros.core.parameter import FAR, parameter, Parameters, Rule

VELOCITIES = ('ideal', 'difference', 'none')
_, DIFFERENCE, NONE = range(3)
MOST_DELAY = 1000
LEAST_STEP = 1e-12  # m
# Each noise has its own offset in the stream of a seed; the damping noise starts at 0.
POSITION_NOISE, VELOCITY_NOISE, FORCE_NOISE = (np.uint64(part << 61) for part in (1, 2, 3))
HARDWARE = record(
    [
        ('resolution', 'f8'),
        ('position_noise', 'f8'),
        ('velocity_noise', 'f8'),
        ('velocity', 'i8'),
        ('sensor_seed', 'u8'),
        ('limit', 'f8'),
        ('pole', 'f8'),
        ('share', 'f8'),
        ('delay', 'i8'),
        ('mass', 'f8'),
        ('mass_time', 'f8'),
        ('kind', 'i8'),
        ('force', 'f8'),
        ('start', 'f8'),
        ('end', 'f8'),
        ('turn', 'f8'),
        ('force_pole', 'f8'),
        ('force_gain', 'f8'),
        ('force_seed', 'u8'),
        ('F_s', 'f8'),
        ('v_s', 'f8'),
    ]
)
# What the hardware remembers: the measured state, the actuator's output, commands on their way.
HARDWARE_STATE = record(
    [
        ('position', 'f8'),
        ('velocity', 'f8'),
        ('measured', 'f8'),
        ('actuator', 'f8'),
        ('noise', 'f8'),
        ('queue', 'f8', (MOST_DELAY + 1,)),
    ]
)


@dataclass(frozen=True, kw_only=True)
class Sensor(Parameters):
    """The encoder and the source of the measured velocity."""

    resolution: float = parameter(
        0.0, 'm', 'step of the encoder, to which the position is rounded; 0 for none', lower=0.0
    )
    position_noise: float = parameter(
        0.0, 'm', 'standard deviation of the position before it is rounded', lower=0.0
    )
    velocity: str = parameter(
        'ideal',
        '',
        'measured velocity: that of the axis, the difference of the measured '
        'positions over a sample, or none, an empty field',
        choices=VELOCITIES,
    )
    velocity_noise: float = parameter(
        0.0, 'm/s', 'standard deviation of the measured velocity', lower=0.0
    )
    seed: int = parameter(1, '', 'seed of both noises', lower=0, upper=MOST_SEED)

    prefix = 'sensor.'
    RULES = (
        Rule(
            'resolution',
            f'0 or >= {LEAST_STEP:g} [m]',  # the number of steps must not overflow
            {'resolution': min},
            lambda resolution: (resolution == 0.0) | (resolution >= LEAST_STEP),
        ),
    )


@dataclass(frozen=True, kw_only=True)
class Actuator(Parameters):
    """Limit, lag and delay between a command and the effort on the axis."""

    limit: float = parameter(
        0.0, 'N', 'largest effort of the actuator, which clips the rest; 0 for none', lower=0.0
    )
    time_constant: float = parameter(
        0.0, 's', 'time constant of its first-order lag; 0 for none', lower=0.0, upper=1e3
    )
    delay: int = parameter(
        0, 'samples', 'from a command to the actuator', lower=0, upper=MOST_DELAY
    )


@dataclass(frozen=True, kw_only=True)
class Payload(Parameters):
    """A step change of the moving mass."""

    mass: float = parameter(
        0.0,
        'kg',
        'added to m; negative for a load that is put down, m + payload.mass > 0',
        lower=-FAR,
        upper=FAR,
    )
    time: float = parameter(
        0.0, 's', 'simulated time since the start of the run from which it is added', lower=0.0
    )


@dataclass(frozen=True, kw_only=True)
class Disturbance(Parameters):
    """An external force on the axis."""

    kind: str = parameter('constant', '', 'how the disturbance varies', choices=KINDS)
    force: float = parameter(
        0.0,
        'N',
        'the constant force, the amplitude of the sinusoid, the standard deviation of '
        'the noise; 0 for none',
        lower=-FAR,
        upper=FAR,
    )
    start: float = parameter(
        0.0, 's', 'simulated time since the start of the run from which it acts', lower=0.0
    )
    end: float = parameter(0.0, 's', 'simulated time up to which it acts; 0 for no end', lower=0.0)
    bandwidth: float = bandwidth_parameter()
    seed: int = parameter(1, '', 'seed of the noise', lower=0, upper=MOST_SEED)

    prefix = 'disturbance.'
    RULES = (
        Rule(
            'end',
            '0 or > disturbance.start = {start:g} [s]',
            {'start': max, 'end': min},
            lambda start, end: (end == 0.0) | (end > start),
        ),
    )


# Values that make the axis ideal.
OFF: Mapping[str, Any] = {
    'sensor.resolution': 0.0,
    'sensor.position_noise': 0.0,
    'sensor.velocity': 'ideal',
    'sensor.velocity_noise': 0.0,
    'actuator.limit': 0.0,
    'actuator.time_constant': 0.0,
    'actuator.delay': 0,
    'payload.mass': 0.0,
    'disturbance.force': 0.0,
    'stribeck.F_s': 0.0,
}


def packed_hardware(values: Mapping[str, Any], runs: int) -> np.ndarray:
    """Pack values, or arrays of shape (runs,), by the names of `Plant`: dtype HARDWARE."""
    rows, time_step = np.zeros(runs, HARDWARE), values['time_step']
    for name, source in (
        ('resolution', 'sensor.resolution'),
        ('position_noise', 'sensor.position_noise'),
        ('velocity_noise', 'sensor.velocity_noise'),
        ('sensor_seed', 'sensor.seed'),
        ('delay', 'actuator.delay'),
        ('mass', 'payload.mass'),
        ('force', 'disturbance.force'),
        ('force_seed', 'disturbance.seed'),
        ('F_s', 'stribeck.F_s'),
        ('v_s', 'stribeck.v_s'),
    ):
        rows[name] = values[source]
    for name, source in (
        ('mass_time', 'payload.time'),
        ('start', 'disturbance.start'),
        ('end', 'disturbance.end'),
    ):
        rows[name] = np.round(np.asarray(values[source]) / time_step)  # in ticks
    for name, source, kinds in (
        ('velocity', 'sensor.velocity', VELOCITIES),
        ('kind', 'disturbance.kind', KINDS),
    ):
        for index, kind in enumerate(kinds):
            rows[name][np.asarray(values[source]) == kind] = index
    rows['limit'] = np.where(
        np.asarray(values['actuator.limit']) > 0.0, values['actuator.limit'], np.inf
    )
    rows['end'][rows['end'] == 0.0] = np.inf
    lag = np.broadcast_to(np.asarray(values['actuator.time_constant']) / time_step, runs)
    # math.exp, value by value: numpy.exp differs in the last bit between machines.
    rows['pole'] = [math.exp(-1.0 / item) if item > 0.0 else 0.0 for item in lag.tolist()]
    rows['share'] = [
        -math.expm1(-1.0 / item) * item if item > 0.0 else 0.0 for item in lag.tolist()
    ]
    rows['turn'] = np.asarray(values['disturbance.bandwidth']) * time_step
    rows['force_pole'] = low_pass_pole(rows['turn'])
    rows['force_gain'] = np.sqrt(1.0 - rows['force_pole'] * rows['force_pole'])
    return rows


@compiled
def normal(seed, start, tick):
    """
    Return normal noise of unit variance, from the stream of ``seed`` that starts at ``start``.

    The noise is the sum of twelve uniform variables of 16 bits. It stays within 6 standard
    deviations and, unlike log and cos, has the same bits on any machine.
    """
    total = 0.0
    for i in range(3):
        bits = word(seed, start + np.uint64(3 * tick + i))
        for _ in range(4):
            total += np.float64(bits & np.uint64(0xFFFF))
            bits = bits >> np.uint64(16)
    return (total + 6.0) * 2.0**-16 - 6.0


@compiled
def measure(hardware, state, memory, sample_rate):
    """Measure the state: set ``memory.position`` and ``memory.velocity``."""
    x, v = state.position, state.velocity
    if hardware.position_noise > 0.0:
        x += hardware.position_noise * normal(hardware.sensor_seed, POSITION_NOISE, state.tick)
    if hardware.resolution > 0.0:
        x = hardware.resolution * np.floor(x / hardware.resolution + 0.5)
    if hardware.velocity == DIFFERENCE:
        v = 0.0 if np.isnan(memory.measured) else (x - memory.measured) * sample_rate
    if hardware.velocity_noise > 0.0:
        v += hardware.velocity_noise * normal(hardware.sensor_seed, VELOCITY_NOISE, state.tick)
    memory.position, memory.measured = x, x
    memory.velocity = np.nan if hardware.velocity == NONE else v


@compiled
def actuate(hardware, memory, tick, command):
    """Return the mean effort [N] over the sample that starts at ``tick``."""
    memory.queue[tick % (MOST_DELAY + 1)] = command
    arrived = memory.queue[(tick - hardware.delay) % (MOST_DELAY + 1)]
    target = min(max(arrived, -hardware.limit), hardware.limit)
    if hardware.pole == 0.0:
        memory.actuator = target
        return target
    away = memory.actuator - target
    memory.actuator = target + away * hardware.pole
    return target + away * hardware.share


@compiled
def disturb(hardware, memory, tick):
    """Return the disturbance [N] over the sample that starts at ``tick``."""
    shape = 1.0
    if hardware.kind == NOISE:
        fresh = white(hardware.force_seed, FORCE_NOISE + np.uint64(tick))
        memory.noise = (
            fresh
            if np.isnan(memory.noise)
            else (hardware.force_pole * memory.noise + hardware.force_gain * fresh)
        )
        shape = memory.noise
    elif hardware.kind == SINUSOIDAL:
        shape = sine(hardware.turn * (tick - hardware.start))
    return hardware.force * shape if hardware.start <= tick < hardware.end else 0.0


@compiled
def begin(hardware, state, memory, sample_rate):
    """Clear the memory of the hardware and measure the initial state."""
    memory.measured, memory.noise, memory.actuator = np.nan, np.nan, 0.0
    for i in range(len(memory.queue)):
        memory.queue[i] = 0.0
    measure(hardware, state, memory, sample_rate)
