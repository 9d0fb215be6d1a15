"""
What a study says about PD, PID, impulses and supervised impulses, under one disturbance.

The study's axes are the disturbance, F_c (unless that is the disturbance), controller.impulses,
supervision and K_i, in this order; any others have one value. Quantiles are those of the sweep's
summary.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from impulse_control_ros.core.metric_catalogue import settling
from impulse_control_ros.core.sweep_config import SweepConfig
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.tools.sweep_summary import Column, quantiles, shown

AXES = {'F_c': 2, 'controller.impulses': 2, 'supervision': 2, 'K_i': 2}
# where each is along the last three axes, as one: off is 0, on is 4, 2 and 1
PLACES = {'PD': 0, 'PID': 1, 'impulses': 4, 'supervised': 6}
CONTROLLERS = tuple(PLACES)
FIGURES = {'residual': 'final_error', 'peak': 'peak_effort', 'impulses': 'impulses'}
LOW, MEDIAN, HIGH = range(3)
SHARES = (0.1, 0.5, 0.9)
LOST = 100.0  # m; a run that ends farther away has diverged, long before it leaves all bounds
SAME = {'settling': 1e-3, 'residual': 1e-5}  # s, m: a difference that is none


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """
    Quantiles `SHARES` of the figures of merit of a study.

    ``disturbance`` is the name of its first axis, ``levels`` its values, ``frictions`` those of
    F_c [N], () where that is the disturbance. ``figures`` have shape (3, levels, frictions or 1,
    4 controllers): settling time [s], nan for never; residual error [m], peak effort [N] and
    number of impulses, nan for a run that diverged.
    """

    disturbance: str
    levels: tuple[float, ...]
    frictions: tuple[float, ...]
    figures: Mapping[str, np.ndarray]

    def worse(self, figure: str, friction: int, one: str, other: str) -> list[int]:
        """Return at which levels one is worse than another, in the median or at 90 %."""
        ours, theirs = (
            self.figures[figure][MEDIAN:, :, friction, CONTROLLERS.index(name)]
            for name in (one, other)
        )
        worse = ~np.isnan(theirs) & (np.isnan(ours) | (ours > theirs + SAME[figure]))
        return np.flatnonzero(worse.any(axis=0)).tolist()


def compared(study: SweepConfig, column: Column) -> Comparison:
    """Return the comparison that a study holds, or raise `ParameterError` where it holds none."""
    (disturbance, levels), *others = study.axes.items()
    expected = {name: size for name, size in AXES.items() if name != disturbance}
    if {name: len(values) for name, values in others if len(values) > 1} != expected:
        raise ParameterError(
            f'invalid axes {", ".join(study.axes)}: must be a '
            f'disturbance and two values of {", ".join(expected)}'
        )
    shape = (len(levels), *expected.values(), study.extent.runs)
    frictions = tuple(study.axes['F_c']) if 'F_c' in expected else ()

    lost = ~(shown(column, FIGURES['residual']) < LOST)

    def of(name: str) -> np.ndarray:
        values = np.where(lost, np.nan, shown(column, name)).reshape(shape)
        ranked = quantiles(values, SHARES).reshape(
            len(SHARES), len(levels), len(frictions) or 1, 8
        )
        return ranked[..., list(PLACES.values())]

    return Comparison(
        disturbance=disturbance,
        levels=tuple(levels),
        frictions=frictions,
        figures={'settling': of(settling(study.tolerances[0]))}
        | {figure: of(name) for figure, name in FIGURES.items()},
    )


def runs_of(places: list[int]) -> Iterator[tuple[int, int]]:
    """Yield the first and the last of each row of places that follow one another."""
    breaks = [i for i in range(1, len(places)) if places[i] != places[i - 1] + 1]
    for start, end in zip([0, *breaks], [*breaks, len(places)], strict=True):
        if places:
            yield places[start], places[end - 1]
