"""
Damping profiles d(t) within the bounds (1), as functions of the tick.

==============  =============  =======  =================================================
symbol          name           unit     meaning
==============  =============  =======  =================================================
d               damping        N s/m    damping coefficient of sample k
d_low, d_bar    lower, upper   N s/m    bounds (1)
f               bandwidth      Hz       corner of the low-pass filter; frequency of the sinusoid
w               noise          1        filtered white noise, zero mean, unit variance
==============  =============  =======  =================================================

The noise profile is the paper's Fig. 3: low-pass filtered white noise with a bias. The bias is the
midpoint of the bounds and the standard deviation a fifth of their distance; values outside the
bounds (1.2 % of the time) are clipped to them. White noise is a hash of (seed, tick), so nodes,
simulations and batches compute the same values in any order.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from impulse_control_ros.core.jit import compiled, record
from impulse_control_ros.core.parameter import parameter, Parameters, Rule

KINDS = ('constant', 'noise', 'sinusoidal')
CONSTANT, NOISE, SINUSOIDAL = range(3)
MOST_SEED = 2**63 - 1  # an integer parameter of ROS
DAMPING = record(
    [
        ('kind', 'i8'),
        ('value', 'f8'),
        ('lower', 'f8'),
        ('upper', 'f8'),
        ('pole', 'f8'),
        ('gain', 'f8'),
        ('turn', 'f8'),
        ('seed', 'u8'),
    ]
)


def bandwidth_parameter() -> Any:
    """Declare the bandwidth of a profile, that of the damping or of a disturbance."""
    return parameter(
        5.0,
        'Hz',
        'corner of the noise filter, frequency of the sinusoid',
        lower=0.0,
        open_lower=True,
    )


@dataclass(frozen=True, kw_only=True)
class Damping(Parameters):
    """A damping profile, constant at ``value`` or varying between ``lower`` and ``upper``."""

    kind: str = parameter('constant', '', 'how the damping varies', choices=KINDS)
    value: float = parameter(
        0.15,
        'N s/m',
        'damping of the constant profile',
        lower=0.0,
        open_lower=True,
        reference='(1)',
    )
    lower: float = parameter(
        0.15,
        'N s/m',
        'least damping of a varying profile',
        lower=0.0,
        open_lower=True,
        reference='(1)',
    )
    upper: float = parameter(
        1.5,
        'N s/m',
        'greatest damping of a varying profile',
        lower=0.0,
        open_lower=True,
        reference='(1)',
    )
    bandwidth: float = bandwidth_parameter()
    seed: int = parameter(1, '', 'seed of the noise', lower=0, upper=MOST_SEED)

    prefix = 'damping.'
    RULES = (
        Rule(
            'lower',
            '<= damping.upper = {upper:g} [N s/m]',
            {'lower': max, 'upper': min},
            lambda lower, upper: lower <= upper,
        ),
    )


def low_pass_pole(turn: np.ndarray) -> list[float]:
    """Return the pole of a low-pass filter for its corner in turns per sample, shape (n,)."""
    # math.exp, value by value: numpy.exp differs in the last bit between machines.
    return [math.exp(-2.0 * math.pi * item) for item in turn.tolist()]


def packed_damping(values: Mapping[str, Any], time_step: float, runs: int) -> np.ndarray:
    """Pack values, or arrays of shape (runs,), by the names of `Damping`: dtype DAMPING."""
    profile = np.zeros(runs, DAMPING)
    for name in ('value', 'lower', 'upper', 'seed'):
        profile[name] = values[name]
    for index, kind in enumerate(KINDS):
        profile['kind'][np.asarray(values['kind']) == kind] = index
    profile['turn'] = np.asarray(values['bandwidth']) * time_step
    profile['pole'] = low_pass_pole(profile['turn'])
    profile['gain'] = np.sqrt(1.0 - profile['pole'] * profile['pole'])
    return profile


@compiled
def word(seed, tick):
    """Return 64 random bits: the splitmix64 hash of ``seed`` and ``tick``."""
    z = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(tick)
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return z


@compiled
def white(seed, tick):
    """Return uniform white noise of unit variance."""
    return (np.float64(word(seed, tick) >> np.uint64(11)) * 2.0**-53 - 0.5) * math.sqrt(12.0)


@compiled
def filtered(noise, pole, gain, seed, tick):
    """Return the filtered noise at ``tick``, given ``noise`` at the previous sample."""
    fresh = white(seed, tick)
    return fresh if tick == 0 else pole * noise + gain * fresh


@compiled
def sine(turns):
    """Return sin(2 pi turns) by its series: the same bits on any machine, without a branch."""
    part = turns - np.floor(turns + 0.5)
    part = 0.5 - part if part > 0.25 else (-0.5 - part if part < -0.25 else part)
    angle = 2.0 * math.pi * part
    square = angle * angle
    term = series = angle
    for order in range(2, 22, 2):
        term *= -square / (order * (order + 1.0))
        series += term
    return series


@compiled
def within_bounds(kind, value, lower, upper, noise, wave):
    """Return d of a profile, given its filtered noise or its sine wave."""
    share = 0.2 * noise if kind == NOISE else 0.5 * wave
    wanted = 0.5 * (lower + upper) + (upper - lower) * share
    return value if kind == CONSTANT else min(max(wanted, lower), upper)


@compiled
def damping_at(profile, noise, tick):
    """Return d and the filtered noise for the sample that starts at ``tick``."""
    wave = 0.0
    if profile.kind == NOISE:
        noise = filtered(noise, profile.pole, profile.gain, profile.seed, tick)
    elif profile.kind == SINUSOIDAL:
        wave = sine(profile.turn * tick)
    return within_bounds(
        profile.kind, profile.value, profile.lower, profile.upper, noise, wave
    ), noise
