"""
The figures of a study in a table.

Quantiles are values of runs: the p-quantile of n runs is the least that p n runs do not exceed.
A run that does not settle, or diverges, counts as later, or worse, than all that do.
"""

from collections.abc import Callable
import math

import numpy as np

from impulse_control_ros.core.sweep_config import MEASURES, settling, SweepConfig, title, units

SHOWN = (
    'overshoot',
    'iae',
    'impulses',
    'impulse_area',
    'peak_effort',
    'peak_velocity',
    'final_error',
)
HEADS = ('median', 'p5', 'p95', 'max')
SHARES = (0.5, 0.05, 0.95, 1.0)
Column = Callable[[str], np.ndarray]


def quantiles(values: np.ndarray, shares: tuple[float, ...]) -> np.ndarray:
    """Return quantiles along the last axis, shape (shares, ...); nan counts as the largest."""
    ranked = np.sort(values, axis=-1)
    places = [max(math.ceil(share * values.shape[-1]) - 1, 0) for share in shares]
    return np.moveaxis(ranked[..., places], -1, 0)


def shown_columns(study: SweepConfig) -> list[str]:
    """Return the figures that are shown, in order."""
    return [*map(settling, study.tolerances), *SHOWN]


def shown(column: Column, name: str) -> np.ndarray:
    """Return a figure as it is shown: nan where a run diverged, errors by their size."""
    values = column(name).astype(float)
    values[column('diverged')] = np.nan
    return np.abs(values) if name == 'final_error' else values


def heading(study: SweepConfig, name: str) -> str:
    """Return e.g. ``peak effort [N]``."""
    words = f'abs({title(name)})' if name == 'final_error' else title(name)
    unit = units(study)[name]
    return f'{words} [{unit}]' if unit else words


def summary(study: SweepConfig, column: Column) -> str:
    """Return the table, and the shares of runs that do not settle and that diverge."""
    lines = [f'{"":<32}' + ''.join(f'{head:>12}' for head in HEADS)]
    for name in shown_columns(study):
        cells = quantiles(shown(column, name), SHARES)
        bad = '-' if name in MEASURES else 'never'
        lines.append(
            f'{heading(study, name):<32}'
            + ''.join(f'{bad if math.isnan(cell) else format(cell, ".4g"):>12}' for cell in cells)
        )
    for tolerance in study.tolerances:
        share = float(np.mean(np.isnan(column(settling(tolerance)))))
        lines.append(f'not settled to {tolerance:g} m: {100.0 * share:.3g} %')
    lines.append(f'diverged: {100.0 * float(np.mean(column("diverged"))):.3g} %')
    return '\n'.join(lines) + '\n'
