"""
The controlled axis (3) with Coulomb friction, stepped exactly over one zero-order-hold sample.

    m x'' + d x' + F_c sign(x') = u

==========  ==============  =======  ==========================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================
m           m               kg       moving mass
F_c         F_c             N        Coulomb friction (section IV-C)
d           d               N s/m    damping, constant within the sample
u           effort          N        effort, constant within the sample
x, x'       position, v...  m, m/s   state
dt          time_step       s        length of the sample
==========  ==============  =======  ==========================================

With ``u`` and ``d`` constant, the motion in one direction s has a closed form. With z = d t / m
and the initial acceleration a = (u - F_c s - d v) / m,

    v(t) = v + a t phi1(z),    x(t) = x + v t + a t^2 phi2(z),
    phi1(z) = (1 - exp(-z)) / z,    phi2(z) = (z - 1 + exp(-z)) / z^2.

The velocity vanishes at t = -log1p(d v / (m a)) m / d, so the time of a stop is computed exactly.
There the axis sticks if abs(u) <= F_c, and otherwise moves on in the direction of u.

While d dt / m is small, as at any sensible time step, series replace exp and log1p. They are
accurate to the last bits, faster, and the same for every run, so a batch steps many runs at once.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from impulse_control_ros.core.damping import DAMPING, Damping, packed_damping
from impulse_control_ros.core.jit import compiled, record, sign
from impulse_control_ros.core.nonidealities import (
    Actuator,
    Disturbance,
    OFF,
    packed_hardware,
    Payload,
    Sensor,
)
from impulse_control_ros.core.parameter import FAR, parameter, Parameters, Rule
from impulse_control_ros.core.stribeck import Stribeck
from impulse_control_ros.core.tick import nanoseconds
from impulse_control_ros.errors import DivergedError

DIVERGED = DivergedError.bound
PLANT = record([('m', 'f8'), ('F_c', 'f8'), ('time_step', 'f8'), ('damping', DAMPING)])
SHORT = 1e-2  # bound of d dt / m, below which the series are exact to the last bits


@dataclass(frozen=True, kw_only=True)
class Plant(Parameters):
    """The axis and its initial state (Table I, section IV)."""

    m: float = parameter(0.1, 'kg', 'moving mass', lower=0.0, open_lower=True)
    F_c: float = parameter(1.0, 'N', 'Coulomb friction force', lower=0.0)
    x_0: float = parameter(
        0.5, 'm', 'position at the start and after a reset', lower=-FAR, upper=FAR
    )
    v_0: float = parameter(
        0.0, 'm/s', 'velocity at the start and after a reset', lower=-FAR, upper=FAR
    )
    time_step: float = parameter(
        1e-4, 's', 'sampling period of plant and controller', lower=1e-9, upper=1.0, read_only=True
    )
    damping: Damping = parameter(Damping(), '', 'damping profile d(t) (1)')
    stribeck: Stribeck = parameter(Stribeck(), '', 'friction at rest')
    sensor: Sensor = parameter(Sensor(), '', 'what is measured')
    actuator: Actuator = parameter(Actuator(), '', 'what becomes of a command')
    payload: Payload = parameter(Payload(), '', 'step of the mass')
    disturbance: Disturbance = parameter(Disturbance(), '', 'force beside the effort')

    RULES = (
        Rule(
            'payload.mass',
            '> -m = -{m:g} [kg]',
            {'m': min, 'payload.mass': min},
            lambda m, mass: m + mass > 0.0,
        ),
        Rule(
            'stribeck.F_s',
            '0 or >= F_c = {F_c:g} [N]',
            {'F_c': max, 'stribeck.F_s': min},
            lambda F_c, F_s: (F_s == 0.0) | (F_s >= F_c),
        ),
    )

    def check(self) -> None:
        """Require a sampling period of whole nanoseconds, since stamps are integers."""
        nanoseconds(self.time_step, 'time_step')

    @property
    def is_ideal(self) -> bool:
        """Whether the plant has none of the nonidealities of core/nonidealities.py."""
        values = self.flat()
        return all(values[name] == off for name, off in OFF.items())

    def packed(self) -> np.ndarray:
        """Return the values as the kernels read them: shape (1,), dtype PLANT."""
        return packed_plant(self.flat(), 1)

    def packed_hardware(self) -> np.ndarray:
        """Return the nonidealities as the kernels read them: shape (1,), dtype HARDWARE."""
        return packed_hardware(self.flat(), 1)


def packed_plant(values: Mapping[str, Any], runs: int) -> np.ndarray:
    """Pack values, or arrays of shape (runs,), by the names of `Plant`: dtype PLANT."""
    plant = np.zeros(runs, PLANT)
    for name in ('m', 'F_c', 'time_step'):
        plant[name] = values[name]
    profile = {name.removeprefix('damping.'): value for name, value in values.items()}
    plant['damping'] = packed_damping(profile, values['time_step'], runs)
    return plant


@compiled
def short_shapes(z):
    """Return phi1 and phi2 by series, accurate to the last bits for z < SHORT."""
    phi2 = 1 / 2 - z * (1 / 6 - z * (1 / 24 - z * (1 / 120 - z * (1 / 720 - z * (1 / 5040)))))
    return 1.0 - z * phi2, phi2


@compiled
def shapes(z):
    """Return phi1 and phi2."""
    if z < SHORT:
        return short_shapes(z)
    phi1 = -math.expm1(-z) / z
    return phi1, (1.0 - phi1) / z


@compiled
def moved(position, velocity, acceleration, rate, duration):
    """Return the state after ``duration`` in one direction; ``rate`` is d / m in 1/s."""
    phi1, phi2 = shapes(rate * duration)
    return (
        position + velocity * duration + acceleration * duration * duration * phi2,
        velocity + acceleration * duration * phi1,
    )


@compiled
def axis_step(position, velocity, effort, damping, m, friction, duration):
    """
    Step the axis exactly over ``duration`` seconds of constant effort and damping.

    All arguments are scalars in SI units. Returns (position, velocity) at the end; a velocity of
    exactly zero means that the axis is at rest.
    """
    x, v, whole = short_step(position, velocity, effort, damping, 1.0 / m, friction, duration)
    if whole:
        return x, v
    return long_step(position, velocity, effort, damping, m, friction, duration)


@compiled
def short_step(position, velocity, effort, damping, inverse_m, friction, duration):
    """
    Do `axis_step` for at most one motion, which may end with the axis sticking.

    Conditions only select values, so a batch computes both branches, for many runs.

    Returns (position, velocity, whole). ``whole`` is false if the axis turns within the step or
    the series are not accurate that far; `long_step` then computes the step.
    """
    rate = damping * inverse_m
    moves, slides = velocity != 0.0, abs(effort) > friction
    direction = sign(velocity) if moves else sign(effort)
    force = effort - friction * direction - damping * velocity
    acceleration = force * inverse_m if moves | slides else 0.0
    phi1, phi2 = short_shapes(rate * duration)
    x = position + velocity * duration + acceleration * duration * duration * phi2
    v = velocity + acceleration * duration * phi1
    stops = moves & (v * direction <= 0.0)
    whole = (rate * duration < SHORT) & (not (stops & slides))
    if stops:
        # At the stop, phi1, phi2 and log1p combine to one series in q = -d v / (m a).
        tau = -velocity / acceleration
        q = rate * tau
        share = 1 / 2 + q * (
            1 / 6
            + q
            * (1 / 12 + q * (1 / 20 + q * (1 / 30 + q * (1 / 42 + q * (1 / 56 + q * (1 / 72))))))
        )
        x, v = position + velocity * tau * share, 0.0
    return x, v, whole


@compiled
def long_step(position, velocity, effort, damping, m, friction, duration):
    """Do `axis_step` motion by motion, over any duration."""
    rate = damping / m
    if velocity != 0.0:
        direction = 1.0 if velocity > 0.0 else -1.0
        acceleration = (effort - friction * direction - damping * velocity) / m
        x, v = moved(position, velocity, acceleration, rate, duration)
        if v * direction > 0.0:
            return x, v
        # Here the motion decelerates and stops within the sample. The ratio rounds to -1 or below
        # when the motion decays towards zero without a stop.
        ratio = rate * velocity / acceleration
        stop = duration if ratio <= -1.0 else -math.log1p(ratio) / rate
        stop = min(max(stop, 0.0), duration)
        position, _ = moved(position, velocity, acceleration, rate, stop)
        duration -= stop
    if abs(effort) <= friction:
        return position, 0.0
    push = effort - friction if effort > 0.0 else effort + friction
    return moved(position, 0.0, push / m, rate, duration)
