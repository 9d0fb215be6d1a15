"""
Pictures of a study: its shape is that of its axes.

No axis: the distribution of each figure of merit. One: its median and the band from 5 to 95 %
along the axis. Two: a heat map of its median. More: the distributions over all points. Quantiles
are those of the summary, so a median that never settles is grey or leaves a gap.
"""

from collections.abc import Callable
import math
from pathlib import Path
from typing import Any

from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
import numpy as np

from impulse_control_ros.core.batch import found
from impulse_control_ros.core.study import Study
from impulse_control_ros.files.replaced import replaced
from impulse_control_ros.tools.sweep_summary import (
    Column,
    heading,
    quantiles,
    shown,
    shown_columns,
)

WIDE = 3  # panels in a row
BINS = 50
TICKS = 6
DECADES = 100.0  # a larger ratio of the values is shown on a log scale
BLUE, GREY = '#1f5a94', '#c8c8c8'
Panel = Callable[[Any, Study, str, np.ndarray], None]


def save_pictures(study: Study, column: Column, folder: Path, name: str) -> list[Path]:
    """Draw the picture of the study ``name`` and save it as PNG and PDF; returns the paths."""
    figure = picture(study, column, name)
    paths = [folder / 'figures.png', folder / 'figures.pdf']
    for path in paths:
        with replaced(path) as made:
            # no date: the same study gives the same files
            metadata = {'CreationDate': None} if path.suffix == '.pdf' else None
            figure.savefig(made, dpi=110, format=path.suffix[1:], metadata=metadata)
    return paths


def picture(study: Study, column: Column, name: str) -> Figure:
    """Return the picture of a study: a panel for each figure of merit."""
    columns = shown_columns(study)
    high = -(-len(columns) // WIDE)
    figure = Figure(figsize=(4.2 * WIDE, 3.0 * high), layout='constrained')
    panels = figure.subplots(high, WIDE, squeeze=False).flat
    draw, what = STYLES.get(len(study.axes), (distribution, 'all points together'))
    for axes, key in zip(panels, columns, strict=False):
        values = shown(column, key)
        axes.set_title(title_of(study, key, values), fontsize=10)
        draw(axes, study, key, values)
    for axes in list(panels):
        axes.remove()
    points = math.prod(len(values) for values in study.axes.values())
    runs = f'{study.extent.runs:,} run' + ('s' if study.extent.runs > 1 else '')
    extent = f'{points:,} points, {runs} each' if study.axes else runs
    figure.suptitle(f'{name}: {extent}, {study.extent.duration:g} s long; {what}')
    return figure


def title_of(study: Study, key: str, values: np.ndarray) -> str:
    """Return a panel's title: its figure of merit, and how many runs it leaves out."""
    never = float(np.mean(np.isnan(values)))
    why = 'never settle' if key.startswith('settling') else 'diverge'
    return heading(study, key) + (f'\n{never:.2%} of the runs {why}' if never else '')


def distribution(axes: Any, study: Study, key: str, values: np.ndarray) -> None:
    """Draw a histogram, with the median."""
    finite = values[np.isfinite(values)]
    axes.set_xlabel(heading(study, key))
    if not finite.size:
        axes.text(0.5, 0.5, 'no run', ha='center', transform=axes.transAxes)
        return
    positive = finite[finite > 0.0]
    is_log = is_wide(positive)
    edges = bins(positive if is_log else finite, is_log, key == 'impulses')
    axes.hist(positive if is_log else finite, edges, color=BLUE,
              weights=np.full(len(positive if is_log else finite), 1.0 / len(values)))
    axes.set_xscale('log' if is_log else 'linear')
    if is_log and len(positive) < len(finite):
        axes.text(0.02, 0.97, f'{1.0 - len(positive) / len(finite):.1%} are 0', va='top',
                  transform=axes.transAxes, fontsize=9)
    median = quantiles(values, (0.5,))[0]
    if np.isfinite(median) and (median > 0.0 or not is_log):
        axes.axvline(median, color='black', lw=1, ls='--')
        axes.annotate(f'median {median:.3g}', (median, 1.0), (3, -3), va='top', fontsize=9,
                      xycoords=('data', 'axes fraction'), textcoords='offset points')
    axes.set_ylabel('share of the runs')
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def is_wide(positive: np.ndarray) -> bool:
    """Tell whether values > 0 need a log scale."""
    if not positive.size:
        return False
    low, high = np.quantile(positive, (0.01, 0.99))
    return bool(high > DECADES * low)


def bins(values: np.ndarray, is_log: bool, is_count: bool) -> np.ndarray:
    """Return the edges of a histogram's bins; counts get a bin each while that is few."""
    low, high = float(values.min()), float(values.max())
    if is_log:
        return np.geomspace(low, high, BINS + 1)
    if is_count and high - low <= 2 * BINS:
        return np.arange(low, high + 2.0) - 0.5
    return np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])


def along_axis(axes: Any, study: Study, key: str, values: np.ndarray) -> None:
    """Draw the median along the one axis, and the band from 5 to 95 %."""
    (name, points), = study.axes.items()
    low, middle, high = quantiles(
        values.reshape(len(points), study.extent.runs), (0.05, 0.5, 0.95))
    is_number = type(points[0]) in (float, int)
    where = points if is_number else range(len(points))
    if study.extent.runs > 1:
        top = np.nanmax(values) if np.isfinite(values).any() else 0.0
        # where the 95 % quantile never settles the band is open: it ends at the top
        axes.fill_between(where, low, np.where(np.isnan(high), top, high), color=BLUE, alpha=0.25,
                          lw=0, label='5 to 95 %')
    axes.plot(where, middle, color=BLUE, marker='.' if len(points) < 40 else None, label='median')
    if study.vary[name].kind == 'log_grid':
        axes.set_xscale('log')
    if not is_number:
        axes.set_xticks(where, [str(point) for point in points])
    axes.set_yscale('log' if is_wide(middle[middle > 0.0]) else 'linear')
    axes.set(xlabel=axis_label(name), ylabel=heading(study, key))
    axes.grid(alpha=0.3)


def heat_map(axes: Any, study: Study, key: str, values: np.ndarray) -> None:
    """Draw the median over the two axes; the first one goes up, the second to the right."""
    (up, rows), (right, columns) = study.axes.items()
    middle = quantiles(values.reshape(len(rows), len(columns), study.extent.runs), (0.5,))[0]
    positive = middle[middle > 0.0]
    # a zero, or what lies far below, has the darkest colour
    norm = (LogNorm(np.quantile(positive, 0.01), positive.max(), clip=True)
            if is_wide(positive) else Normalize())
    axes.set_facecolor(GREY)
    image = axes.imshow(np.ma.masked_invalid(middle), origin='lower', aspect='auto', norm=norm,
                        interpolation='nearest')
    axes.figure.colorbar(image, ax=axes)
    if np.isnan(middle).any():
        axes.plot([], [], 's', color=GREY, label='half or more')
        axes.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), fontsize=8, frameon=False,
                    borderpad=0, handletextpad=0.2)
    for axis, name, points in ((axes.yaxis, up, rows), (axes.xaxis, right, columns)):
        places = np.unique(np.linspace(0, len(points) - 1, TICKS).round().astype(int))
        axis.set_ticks(places, [label(points[place]) for place in places])
        axis.set_label_text(axis_label(name))


def label(value: Any) -> str:
    """Return a value of an axis, short."""
    return format(value, '.3g') if type(value) is float else str(value)


def axis_label(name: str) -> str:
    """Return e.g. ``F_c [N]``."""
    unit = found(name)[3].unit
    return f'{name} [{unit}]' if unit else name


STYLES: dict[int, tuple[Panel, str]] = {
    0: (distribution, 'distributions'), 1: (along_axis, 'median and 5 to 95 %'),
    2: (heat_map, 'medians')}
