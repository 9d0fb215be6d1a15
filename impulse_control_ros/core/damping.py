"""
Damping profiles d(t) inside the bounds of (1), as a function of the tick.

==============  =============  =======  =================================================
symbol          name           unit     meaning
==============  =============  =======  =================================================
d               damping        N s/m    damping coefficient of sample k
d_low, d_bar    lower, upper   N s/m    bounds (1)
f               bandwidth      Hz       corner of the low-pass filter; frequency of the sinusoid
w               noise          1        filtered white noise, zero mean, unit variance
==============  =============  =======  =================================================

The noise profile is the paper's Fig. 3: low-pass filtered white noise with a bias. The bias is
the middle of the bounds and the standard deviation a fifth of their distance; what would leave
the bounds (1.2 % of the time) is held at them. White noise is a hash of (seed, tick), so it is
the same whoever computes it, in whatever order: node, simulation, or a batch on many cores.
"""

from dataclasses import dataclass
import math

import numba
import numpy as np

from impulse_control_ros.core.parameter import parameter, Parameters, refusal

KINDS = ('constant', 'noise', 'sinusoidal')
DAMPING = np.dtype([('kind', 'i8'), ('value', 'f8'), ('lower', 'f8'), ('upper', 'f8'),
                    ('pole', 'f8'), ('gain', 'f8'), ('angle', 'f8'), ('seed', 'u8')])


@dataclass(frozen=True, kw_only=True)
class Damping(Parameters):
    """A damping profile; ``value`` serves the constant one, the bounds the others."""

    kind: str = parameter('constant', '', 'how the damping varies', choices=KINDS)
    value: float = parameter(
        0.15, 'N s/m', 'damping of the constant profile', lower=0.0, open_lower=True,
        reference='(1)')
    lower: float = parameter(
        0.15, 'N s/m', 'least damping of a varying profile', lower=0.0, open_lower=True,
        reference='(1)')
    upper: float = parameter(
        1.5, 'N s/m', 'greatest damping of a varying profile', lower=0.0, open_lower=True,
        reference='(1)')
    bandwidth: float = parameter(
        5.0, 'Hz', 'corner of the noise filter, frequency of the sinusoid', lower=0.0,
        open_lower=True)
    seed: int = parameter(1, '', 'seed of the noise', lower=0)

    def check(self) -> None:
        """Refuse crossed bounds."""
        if self.lower > self.upper:
            raise refusal('damping.lower', self.lower,
                          f'<= damping.upper = {self.upper:g} [N s/m]')

    def packed(self, time_step: float) -> np.ndarray:
        """Return the kernels' view: shape (1,), dtype DAMPING."""
        angle = 2.0 * math.pi * self.bandwidth * time_step
        pole = math.exp(-angle)
        return np.array([(KINDS.index(self.kind), self.value, self.lower, self.upper,
                          pole, math.sqrt(1.0 - pole * pole), angle, self.seed)], DAMPING)


@numba.njit(cache=True)
def white(seed, tick):
    """Return white noise of unit variance: uniform, from the splitmix64 hash of both."""
    z = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(tick)
    for _ in range(2):
        z += np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return (np.float64(z >> np.uint64(11)) * 2.0**-53 - 0.5) * math.sqrt(12.0)


@numba.njit(cache=True)
def damping_at(profile, state):
    """Set ``damping``, and the filter's ``noise``, for the sample that starts at the tick."""
    if profile.kind == 0:
        state.damping = profile.value
        return
    middle, width = 0.5 * (profile.lower + profile.upper), profile.upper - profile.lower
    if profile.kind == 1:
        fresh = white(profile.seed, state.tick)
        state.noise = fresh if state.tick == 0 else (
            profile.pole * state.noise + profile.gain * fresh)
        wanted = middle + 0.2 * width * state.noise
    else:
        wanted = middle + 0.5 * width * math.sin(profile.angle * state.tick)
    state.damping = min(max(wanted, profile.lower), profile.upper)
