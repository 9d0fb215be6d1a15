"""
What `identify` takes and returns: records, estimates with honest errors, and the bound of d.

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
m           m               kg       moving mass
d           d               N s/m    viscous damping, its mean over the records
F_c         F_c             N        Coulomb friction force
o           offset          N        constant force against the effort: gravity, drift of a drive
d_bar       d_bar           N s/m    upper bound of d(t) in the records (1)
T           window          s        length of the windows of the weak form
lambda      attenuation     1        share of m that quantisation and noise take away
==========  ==============  =======  ==========================================================

The model is m x'' + d x' + F_c sign(x') + o = u. Its asymmetric form has d and F_c by direction,
and no offset, which F_c_plus and F_c_minus then hold.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

IDENTIFIED = 'identified'
SYMMETRIC = ('m', 'd', 'F_c', 'offset')
ASYMMETRIC = ('m', 'd_plus', 'd_minus', 'F_c_plus', 'F_c_minus')
UNITS: Mapping[str, str] = {
    'm': 'kg',
    **dict.fromkeys(('d', 'd_plus', 'd_minus', 'd_bar'), 'N s/m'),
    **dict.fromkeys(('F_c', 'F_c_plus', 'F_c_minus', 'offset'), 'N'),
}


@dataclass(frozen=True, kw_only=True)
class Record:
    """
    The record of one axis: n samples, each signal of shape (n,).

    ``time`` [s], ``position`` [m], ``effort`` [N] and, where it is measured, ``velocity`` [m/s].
    ``effort_held`` is how the effort acts, see `identify`, or None where that is not known.
    ``name`` is for messages.
    """

    time: np.ndarray
    position: np.ndarray
    effort: np.ndarray
    velocity: np.ndarray | None = None
    effort_held: str | None = None
    name: str = 'record'


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """
    One parameter: ``value``, ``standard_error`` and 95 % ``interval``, in ``unit``.

    ``share`` is the parameter's own part of the effort: the rms of its term made orthogonal to
    the other terms, over the rms of the effort. ``verdict`` is 'identified', or 'not excited: '
    with the reason; then the value is nan, and so is the interval unless it still holds.
    """

    name: str
    value: float
    unit: str
    standard_error: float
    interval: tuple[float, float]
    share: float
    verdict: str

    @property
    def is_identified(self) -> bool:
        """Whether the records determine the parameter."""
        return self.verdict == IDENTIFIED


@dataclass(frozen=True, kw_only=True)
class WindowSweep:
    """
    The estimates as functions of the window: a right model does not drift with it.

    ``window`` [s] has shape (k,), from T to 4 T where the records are long enough. ``values`` and
    ``standard_errors`` map the names of the symmetric parameters to arrays of shape (k,).
    ``drift`` maps them to the largest change from the first window, in standard errors.
    """

    window: np.ndarray
    values: Mapping[str, np.ndarray]
    standard_errors: Mapping[str, np.ndarray]
    drift: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class DampingBlocks:
    """
    The damping d(t) by blocks, each array of shape (k,); blocks that are too uncertain are absent.

    ``record`` is the index of the record, ``time`` [s] the middle of the block, ``d`` [N s/m] its
    damping and ``standard_error`` [N s/m] that of d, that of m, F_c and offset included.
    """

    duration: float
    record: np.ndarray
    time: np.ndarray
    d: np.ndarray
    standard_error: np.ndarray


@dataclass(frozen=True, kw_only=True)
class FrictionCurve:
    """
    The friction force by windows in motion, each array of shape (k,).

    ``velocity`` [m/s] is the mean of a window, ``force`` [N] the effort minus m x'' and offset.
    """

    velocity: np.ndarray
    force: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Identification:
    """
    The result of `identify`.

    ``parameters`` has the estimates m, d, F_c, offset; ``asymmetric`` m, d_plus, d_minus,
    F_c_plus, F_c_minus (empty if the axis moves in one direction only). ``asymmetry_z`` is the
    Wald statistic of d_plus = d_minus (nan without both directions): beyond 2, the damping
    depends on the direction.

    ``d_bar`` [N s/m] bounds the damping over the recorded motion with 95 % confidence;
    ``d_bar_margin`` [N s/m] is how far it is above the largest block. Both are nan if refused;
    ``d_bar_verdict`` is 'identified' or the reason. ``d_range`` [N s/m] is the range of the
    blocks ``d_blocks``.

    ``window`` [s] is T, ``attenuation`` lambda at T, ``sweep`` the test of the model over T to
    4 T; ``residual`` is the rms of the equation error over the rms of the effort, and
    ``condition`` the condition number of the scaled regressors. ``encoder_step`` [m] and
    ``position_noise`` [m] are of the position, ``velocity_noise`` [m/s] of a measured velocity at
    rest (nan without one); 0 where none is seen. ``effort_held`` is how the effort was taken to
    act: after, sampled or before; ``effort_delay`` [s] is the time by which it acts later than
    that, with the standard error ``effort_delay_error``; nan and inf where the motion shows none.

    ``warnings`` are sentences about the records and the model; ``advice`` says which excitation
    would identify what is refused. ``time_step`` [s] has one value per piece without a gap.
    """

    parameters: Mapping[str, Estimate]
    asymmetric: Mapping[str, Estimate]
    asymmetry_z: float
    d_blocks: DampingBlocks
    d_range: tuple[float, float]
    d_bar: float
    d_bar_margin: float
    d_bar_verdict: str
    friction: FrictionCurve
    window: float
    attenuation: float
    sweep: WindowSweep
    residual: float
    condition: float
    encoder_step: float
    position_noise: float
    velocity_noise: float
    effort_held: str
    effort_delay: float
    effort_delay_error: float
    time_step: tuple[float, ...]
    warnings: tuple[str, ...] = field(default=())
    advice: tuple[str, ...] = field(default=())

    @property
    def is_identified(self) -> bool:
        """Whether both m and d_bar, which the control law needs, are identified."""
        return self.parameters['m'].is_identified and self.d_bar_verdict == IDENTIFIED
