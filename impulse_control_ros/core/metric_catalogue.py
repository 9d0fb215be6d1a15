"""
Every metric of a response and every column of its samples: title, unit, meaning.

``analyze``, ``sweep``, ``export_bag``, their pictures and docs/reference/metrics.md take all of
them from here. A sweep has the metrics that `figures` and a batch compute during a run. For each
of these smaller is better, so a quantile counts undefined values as the largest.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
import math

import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.metrics import (
    COUNTS,
    integral,
    overshoot,
    peak,
    settling_time,
    stuck,
    work,
)

TOLERANCES = (1e-2, 1e-3)  # m


@dataclass(frozen=True)
class Quantity:
    """A number with a ``title``, its SI ``unit`` ('' for none), and its ``meaning``."""

    title: str
    unit: str
    meaning: str

    @property
    def label(self) -> str:
        """Title and unit, such as ``peak effort [N]``."""
        return f'{self.title} [{self.unit}]' if self.unit else self.title


@dataclass(frozen=True, kw_only=True)
class Samples:
    """
    The n samples of a response to a set-point, and its k impulses.

    ``time`` [s], ``position`` x [m], ``error`` e = x - x_r [m], ``velocity`` v [m/s], ``command``
    u [N], ``impulse`` [N] the impulsive part of u, ``applied`` [N] the effort until the next
    sample: shape (n,). ``guard`` (index in GUARDS) and ``area`` J [N s]: shape (k,). ``verdict``
    (index in VERDICTS) of the supervision: shape (j,). ``missing`` is the number of missing
    samples. ``learnt_mass`` [kg] and ``learnt_delay`` [s] at the end, and ``suspended`` [s] in
    total, are nan where they are unknown.
    """

    time: np.ndarray
    position: np.ndarray
    error: np.ndarray
    velocity: np.ndarray
    command: np.ndarray
    impulse: np.ndarray
    applied: np.ndarray
    guard: np.ndarray
    area: np.ndarray
    verdict: np.ndarray
    missing: int = 0
    learnt_mass: float = math.nan
    learnt_delay: float = math.nan
    suspended: float = math.nan


@dataclass(frozen=True)
class Metric(Quantity):
    """
    A metric: ``compute`` gives it for a response.

    ``undefined`` is the word for a value that is not finite, '' where it cannot be computed.
    """

    compute: Callable[[Samples], float]
    undefined: str = ''

    def of(self, samples: Samples) -> float:
        """Return the metric of a response; nan or infinite where it cannot be computed."""
        with np.errstate(all='ignore'):  # recorded values may be nan, infinite or huge
            value = self.compute(samples)
        return value if isinstance(value, int) else float(value)

    def text(self, value: float) -> str:
        """Format a value."""
        if isinstance(value, int):
            return str(value)
        return f'{value:.5g}' if math.isfinite(value) else self.undefined


def settling(tolerance: float) -> str:
    """Return the name of the settling time to a tolerance [m]."""
    return f'settling_time_{tolerance:g}'


def _settled(tolerance: float, samples: Samples) -> float:
    return settling_time(samples.time - samples.time[0], samples.error, tolerance)


def _area(guard: str, samples: Samples) -> float:
    return float(np.abs(samples.area[samples.guard == GUARDS.index(guard)]).sum())


def _count(guard: str, samples: Samples) -> int:
    return int(np.count_nonzero(samples.guard == GUARDS.index(guard)))


def _verdicts(verdict: str, samples: Samples) -> int:
    return int(np.count_nonzero(samples.verdict == VERDICTS.index(verdict)))


def settling_times(tolerances: Iterable[float]) -> dict[str, Metric]:
    """Return the settling times to the ``tolerances`` [m], by name."""
    return {
        settling(tolerance): Metric(
            f'settling time to {tolerance:g} m',
            's',
            f'time until abs(e) stays within {tolerance:g} m; nan if it never does',
            partial(_settled, tolerance),
            'never',
        )
        for tolerance in tolerances
    }


PLACES = {
    'position_zero': ('at position zero', 'e = 0, (10)'),
    'velocity_zero': ('at velocity zero', 'v = 0, (15)'),
    'sticking': ('while sticking', 'v = 0 with e != 0, where friction holds the axis'),
}
JUDGED = {  # by verdict: of what it is a number
    'confirmed': 'impulses whose jump was the expected one',
    'absent': 'impulses without a jump within response_timeout',
    'out_of_band': 'impulses whose jump was much larger or smaller than expected',
    'reversed': 'impulses with a jump in the opposite direction',
    'growing': 'times the error grew beyond its last turning point while impulses acted',
    'stalled': 'series of eight impulses at rest that hardly brought the axis nearer',
}
METRICS = {
    'start': Metric('from', 's', 'start, since the first state of the bag', lambda r: r.time[0]),
    'end': Metric('to', 's', 'end, since the first state of the bag', lambda r: r.time[-1]),
    **settling_times(TOLERANCES),
    'overshoot': Metric(
        'overshoot', 'm', 'largest error of the opposite sign', lambda r: overshoot(r.error)
    ),
    'iae': Metric(
        'IAE', 'm s', 'trapezoidal integral of abs(e)', lambda r: integral(r.time, abs(r.error))
    ),
    'ise': Metric(
        'ISE', 'm^2 s', 'trapezoidal integral of e^2', lambda r: integral(r.time, r.error**2)
    ),
    'final_error': Metric('final error', 'm', 'e at the end', lambda r: r.error[-1]),
    'peak_velocity': Metric('peak velocity', 'm/s', 'largest abs(v)', lambda r: peak(r.velocity)),
    'peak_feedback': Metric(
        'peak effort without impulses',
        'N',
        'largest abs(u) of the feedback (4)',
        lambda r: peak(r.command - r.impulse),
    ),
    'peak_effort': Metric('peak effort', 'N', 'largest abs(u)', lambda r: peak(r.command)),
    'impulses': Metric('impulses', '', 'number of impulses', lambda r: len(r.guard)),
    **{
        guard: Metric(
            f'impulses {place}', '', f'number of impulses at {condition}', partial(_count, guard)
        )
        for guard, (place, condition) in PLACES.items()
    },
    'impulse_area': Metric('impulse area', 'N s', 'sum of abs(J)', lambda r: np.abs(r.area).sum()),
    **{
        f'{guard}_area': Metric(
            f'area {place}', 'N s', f'sum of abs(J) at {condition}', partial(_area, guard)
        )
        for guard, (place, condition) in PLACES.items()
    },
    **{
        verdict: Metric(
            f'verdicts {verdict.replace("_", " ")}',
            '',
            f'number of {what}',
            partial(_verdicts, verdict),
        )
        for verdict, what in JUDGED.items()
    },
    'suspended_time': Metric(
        'impulses suspended',
        's',
        'total time in which impulses were suspended',
        lambda r: r.suspended,
    ),
    'learnt_mass': Metric(
        'learnt mass',
        'kg',
        'median of the masses from the last five jumps',
        lambda r: r.learnt_mass,
    ),
    'learnt_delay': Metric(
        'learnt delay',
        's',
        'median of the delays from impulse to jump, over the last five jumps',
        lambda r: r.learnt_delay,
    ),
    'work': Metric(
        'work of the effort',
        'N m',
        'sum of u_k (x_k+1 - x_k) of the applied effort: exact, as it is held over each sample',
        lambda r: work(r.position, r.applied),
    ),
    'impulse_work': Metric(
        'work of the impulses',
        'N m',
        'work of the impulsive part of u; negative if impulses brake',
        lambda r: work(r.position, r.impulse),
    ),
    'stuck': Metric(
        'stuck intervals',
        '',
        'number of intervals of two samples or more with v = 0 and e != 0',
        lambda r: stuck(r.time, r.velocity, r.error)[0],
    ),
    'stuck_time': Metric(
        'time stuck',
        's',
        'total time of the stuck intervals',
        lambda r: stuck(r.time, r.velocity, r.error)[1],
    ),
    'samples': Metric('samples', '', 'number of states', lambda r: len(r.time)),
    'missing': Metric(
        'samples missing', '', 'number of states missing in between', lambda r: r.missing
    ),
}
SWEPT = (
    *('overshoot', 'iae', 'ise', 'impulses', *COUNTS, 'impulse_area'),
    *('peak_effort', 'peak_velocity', 'final_error'),
)
DIVERGED = Quantity('diverged', '', 'whether the run left all bounds; its other metrics are nan')


def sweep_metrics(tolerances: Iterable[float]) -> dict[str, Quantity]:
    """Return the metrics of each run of a sweep, in the order of their columns."""
    swept = {name: METRICS[name] for name in SWEPT}
    return {**settling_times(tolerances), **swept, 'diverged': DIVERGED}


SAMPLE_COLUMNS = {
    'time': Quantity('time', 's', 'time since the first sample'),
    'stamp_ns': Quantity('stamp', 'ns', 'stamp of the sample in its messages'),
    'position': Quantity('position', 'm', 'x of the state'),
    'velocity': Quantity('velocity', 'm/s', 'v of the state'),
    'effort': Quantity('effort', 'N', 'effort applied since the sample before'),
    'command': Quantity('command', 'N', 'u commanded for this state'),
    'impulse_area': Quantity(
        'impulse area', 'N s', 'J of the impulse that this state triggered; 0 if none'
    ),
    'guard': Quantity('guard', '', "guard of that impulse; '' if none"),
    'verdict': Quantity('verdict', '', "verdict on an earlier impulse at this state; '' if none"),
    'damping': Quantity('damping', 'N s/m', 'd, if it was published at this sample'),
    'is_reset': Quantity('is_reset', '', 'whether a run or an episode starts here'),
}
PANELS = {  # signals of a run, plotted over time
    'position': SAMPLE_COLUMNS['position'],
    'velocity': SAMPLE_COLUMNS['velocity'],
    'feedback': Quantity('PD effort', 'N', 'u without its impulsive part'),
    'impulse': Quantity('impulse effort', 'N', 'impulsive part of u'),
    'damping': SAMPLE_COLUMNS['damping'],
}
