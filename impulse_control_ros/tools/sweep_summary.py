"""
The metrics of a study in a table.

Quantiles are values of runs: the p-quantile of n runs is the least that p n runs do not exceed.
A run that does not settle, or diverges, counts as later, or worse, than all that do.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
import math

import numpy as np

from impulse_control_ros.core.metric_catalogue import Metric, METRICS, settling, settling_times
from impulse_control_ros.core.sweep_config import SweepConfig

SHOWN = (
    *('overshoot', 'iae', 'impulses', 'impulse_area'),
    *('peak_effort', 'peak_velocity', 'final_error'),
)
SHARES = {'median': 0.5, 'p5': 0.05, 'p95': 0.95, 'max': 1.0}
Column = Callable[[str], np.ndarray]


def quantiles(values: np.ndarray, shares: Iterable[float]) -> np.ndarray:
    """Return quantiles along the last axis, shape (shares, ...); nan counts as the largest."""
    ranked = np.sort(values, axis=-1)
    places = [max(math.ceil(share * values.shape[-1]) - 1, 0) for share in shares]
    return np.moveaxis(ranked[..., places], -1, 0)


def shown_metrics(study: SweepConfig) -> dict[str, Metric]:
    """Return the metrics that are shown, in order."""
    metrics = settling_times(study.tolerances) | {name: METRICS[name] for name in SHOWN}
    size = metrics['final_error']
    return metrics | {'final_error': replace(size, title=f'abs({size.title})')}


def shown(column: Column, name: str) -> np.ndarray:
    """Return a metric as it is shown: nan where a run diverged, errors by their size."""
    values = column(name).astype(float)
    values[column('diverged')] = np.nan
    return np.abs(values) if name == 'final_error' else values


def summary(study: SweepConfig, column: Column) -> str:
    """Return the table, and the shares of runs that do not settle and that diverge."""
    lines = [f'{"":<32}' + ''.join(f'{head:>12}' for head in SHARES)]
    for name, metric in shown_metrics(study).items():
        cells = quantiles(shown(column, name), SHARES.values())
        lines.append(f'{metric.label:<32}' + ''.join(f'{metric.text(cell):>12}' for cell in cells))
    for tolerance in study.tolerances:
        share = float(np.mean(np.isnan(column(settling(tolerance)))))
        lines.append(f'not settled to {tolerance:g} m: {100.0 * share:.3g} %')
    lines.append(f'diverged: {100.0 * float(np.mean(column("diverged"))):.3g} %')
    return '\n'.join(lines) + '\n'
