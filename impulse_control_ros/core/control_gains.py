"""
Gains and options of the control law (Table I), and their packed form for the kernels.

The fields of `ControlGains` are the parameters of the controller. The kernels read `Gains` and
`LawOptions`, which hold these and derived values as floats.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.damping import low_pass_pole
from impulse_control_ros.core.jit import record
from impulse_control_ros.core.parameter import FAR, parameter, Parameters
from impulse_control_ros.core.tick import nanoseconds


class Gains(NamedTuple):
    """
    Gains of the law, by the names of `ControlGains`.

    Derived: position_gain = 2 alpha / abs(v) [kg], velocity_gain = 2 beta / abs(e) [N s/m],
    sample_rate = 1 / time_step [Hz]. Without a limit, ``effort_limit`` is infinite.
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


class LawOptions(NamedTuple):
    """
    Options of the law for real signals, by the names of `ControlGains`.

    Derived: lookahead_time [s], release_velocity [m/s] above which an axis at rest moves again,
    pole = exp(-2 pi velocity_bandwidth time_step), inverse_m [1/kg], integral_gain = K_i time_step
    [N/m], estimates, 1 if the velocity is estimated, least_mass and most_mass from
    mass_ratio_limits, and half_d_bar = d_bar / 2 [N s/m], a guess of the damping.
    """

    lookahead_time: float
    position_hysteresis: float
    release_velocity: float
    stiction_wait_samples: float
    pole: float
    inverse_m: float
    integral_gain: float
    estimates: float
    supervision: float
    learn_mass: float
    least_mass: float
    most_mass: float
    response_timeout: float
    half_d_bar: float


LAW = record([(name, 'f8') for name in (*Gains._fields, *LawOptions._fields)])
# the values of the parameters with which all options are off
OFF: Mapping[str, Any] = {
    'guard_lookahead': 0.0,
    'position_hysteresis': 0.0,
    'velocity_hysteresis': 0.0,
    'stiction_wait_samples': 1,
    'K_i': 0.0,
    'velocity_source': 'measured',
    'supervision': False,
}


@dataclass(frozen=True, kw_only=True)
class MassRatioLimits(Parameters):
    """Bounds of the learnt mass, relative to m."""

    lower: float = parameter(
        0.2, '', 'smallest learnt mass, relative to m', lower=0.0, open_lower=True, upper=1.0
    )
    upper: float = parameter(5.0, '', 'largest learnt mass, relative to m', lower=1.0)

    prefix = 'mass_ratio_limits.'


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
    supervision: bool = parameter(
        True,
        '',
        'whether impulses are checked by their jumps, and suspended if they do not work; false '
        'is the law of the paper',
    )
    learn_mass: bool = parameter(
        True, '', 'whether impulses are computed for the mass learnt from their jumps'
    )
    mass_ratio_limits: MassRatioLimits = parameter(
        MassRatioLimits(), '', 'bounds of the learnt mass'
    )
    response_timeout: int = parameter(
        1000,
        'samples',
        'an impulse without a jump in this time is absent; must exceed the delay of the loop',
        lower=1,
    )
    time_step: float = parameter(
        1e-4, 's', 'sampling period of plant and controller', lower=1e-9, upper=1.0, read_only=True
    )

    def check(self) -> None:
        """Require a sampling period of whole nanoseconds, since stamps are integers."""
        nanoseconds(self.time_step, 'time_step')

    def packed(self) -> np.ndarray:
        """Return the values as the kernels read them: shape (1,), dtype LAW."""
        return packed_law(self.flat(), 1)

    @cached_property
    def values(self) -> Gains:
        """The gains as the kernels read them."""
        return Gains(*self.packed()[0].item()[: len(Gains._fields)])

    @cached_property
    def options(self) -> LawOptions:
        """The options as the kernels read them."""
        return LawOptions(*self.packed()[0].item()[len(Gains._fields) :])

    @property
    def has_options(self) -> bool:
        """Whether an option of the law for real signals is on."""
        values = self.flat()
        return any(values[name] != off for name, off in OFF.items())


def packed_law(values: Mapping[str, Any], runs: int) -> np.ndarray:
    """Pack values, or arrays of shape (runs,), by the names of `ControlGains`: dtype LAW."""
    limit = np.asarray(values['effort_limit'])
    turn = np.broadcast_to(np.asarray(values['velocity_bandwidth']) * values['time_step'], runs)
    derived = {
        'position_gain': 2.0 * values['alpha_ratio'] * values['m'],
        'velocity_gain': values['d_bar'] / values['c'],
        'effort_limit': np.where(limit > 0.0, limit, np.inf),
        'sample_rate': 1.0 / values['time_step'],
        'lookahead_time': np.asarray(values['guard_lookahead']) * values['time_step'],
        'release_velocity': np.asarray(values['velocity_deadband'])
        + values['velocity_hysteresis'],
        'pole': low_pass_pole(turn),
        'inverse_m': 1.0 / np.asarray(values['m']),
        'integral_gain': np.asarray(values['K_i']) * values['time_step'],
        'estimates': np.asarray(values['velocity_source']) == 'estimated',
        'least_mass': values['mass_ratio_limits.lower'],
        'most_mass': values['mass_ratio_limits.upper'],
        'half_d_bar': 0.5 * np.asarray(values['d_bar']),
    }
    law = np.zeros(runs, LAW)
    for name in LAW.names or ():
        law[name] = derived[name] if name in derived else values[name]
    return law
