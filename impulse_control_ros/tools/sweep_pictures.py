"""
Pictures of a study: its shape is that of its axes.

No axis: the distribution of each metric. One: its median and the band from 5 to 95 % along the
axis. Two: a heat map of its median. More: the distributions over all points. Quantiles are those
of the summary, so a median that never settles is grey or leaves a gap.
"""

from collections.abc import Callable
import math
from pathlib import Path
from typing import Any

from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
import numpy as np

from impulse_control_ros.core.metric_catalogue import Metric, Quantity
from impulse_control_ros.core.sweep_config import SweepConfig
from impulse_control_ros.core.varied import found
from impulse_control_ros.tools.figures import save
from impulse_control_ros.tools.sweep_summary import Column, quantiles, shown, shown_metrics

WIDE = 3  # panels in a row
DPI = 110
BINS = 50
TICKS = 6
DECADES = 100.0  # a larger ratio of the values is shown on a log scale
EXTEND = ('neither', 'min', 'max', 'both')  # of a colour bar: 1 below, 2 above
BLUE, GREY = '#1f5a94', '#c8c8c8'
Panel = Callable[[Any, SweepConfig, Metric, np.ndarray], None]


def save_pictures(study: SweepConfig, column: Column, folder: Path, name: str) -> list[Path]:
    """Draw the picture of the study ``name`` and save it as PNG and PDF; returns the paths."""
    figure = picture(study, column, name)
    paths = [folder / 'figures.png', folder / 'figures.pdf']
    for path in paths:
        save(figure, path, DPI)
    return paths


def picture(study: SweepConfig, column: Column, name: str) -> Figure:
    """Return the picture of a study: a panel for each metric."""
    metrics = shown_metrics(study)
    high = -(-len(metrics) // WIDE)
    figure = Figure(figsize=(4.2 * WIDE, 3.0 * high), layout='constrained')
    panels = figure.subplots(high, WIDE, squeeze=False).flat
    draw, what = STYLES.get(len(study.axes), (distribution, 'all points together'))
    for axes, (key, metric) in zip(panels, metrics.items(), strict=False):
        draw(axes, study, metric, shown(column, key))
    for axes in list(panels):
        axes.remove()
    extent = f'{study.extent.runs:,} run' + ('s' if study.extent.runs > 1 else '')
    if study.axes:
        extent = f'{study.rows // study.extent.runs:,} points, {extent} each'
        what = what if study.extent.runs > 1 else ''
    title = f'{name}: {extent}, {study.extent.duration:g} s long'
    figure.suptitle('; '.join(filter(None, [title, what])))
    return figure


def left_out(metric: Metric, values: np.ndarray) -> str:
    """Say how many runs a panel leaves out, if any."""
    share = float(np.mean(np.isnan(values)))
    why = 'never settle' if metric.undefined == 'never' else 'diverge'
    return f'{100.0 * share:.3g} % of the runs {why}' if share else ''


def distribution(axes: Any, study: SweepConfig, metric: Metric, values: np.ndarray) -> None:
    """Draw a histogram, with the median."""
    axes.set_title(left_out(metric, values), fontsize=10)
    axes.set(xlabel=metric.label, ylabel='share of the runs')
    if is_same(axes, values, 'in all runs'):
        return
    finite = values[np.isfinite(values)]
    low, high, is_log = span(finite)
    drawn = finite[(finite >= low) & (finite <= high)]
    if len(drawn) < len(finite):
        note = f'{100.0 * (1.0 - len(drawn) / len(values)):.3g} % of the runs are not shown'
        axes.set_title(note, fontsize=10)
    weights = np.full(len(drawn), 1.0 / len(values))
    axes.hist(drawn, bins(drawn, is_log, not metric.unit), color=BLUE, weights=weights)
    axes.margins(x=0.03, y=0.2)
    axes.yaxis.set_major_formatter(lambda share, _: f'{100.0 * share:g} %')
    if is_log:
        axes.set_xscale('log')
    else:
        axes.ticklabel_format(axis='x', scilimits=(-3, 5))
    mark_median(axes, metric, float(quantiles(values, (0.5,))[0]))


def mark_median(axes: Any, metric: Metric, median: float) -> None:
    """Draw the median, unless it is no value of the axis; its text on the side with room."""
    if not (math.isfinite(median) and (median > 0.0 or axes.get_xscale() == 'linear')):
        return
    axes.axvline(median, color='black', lw=1, ls='--')
    place = axes.transAxes.inverted().transform(axes.transData.transform((median, 0.0)))[0]
    offset, side = (4, 'left') if place < 0.5 else (-4, 'right')
    axes.annotate(
        f'median {metric.text(median)}',
        (median, 1.0),
        (offset, -4),
        ('data', 'axes fraction'),
        'offset points',
        va='top',
        ha=side,
        fontsize=9,
    )


def is_same(axes: Any, values: np.ndarray, where: str) -> bool:
    """Tell whether no two finite values differ; then say it instead of drawing."""
    finite = values[np.isfinite(values)]
    if finite.size and np.ptp(finite) > 1e-12 * np.abs(finite).max():
        return False
    where = where if finite.size == values.size else 'in all others'
    text = f'{finite[0]:.6g}\n{where}' if finite.size else 'never'
    axes.text(0.5, 0.5, text, ha='center', va='center', transform=axes.transAxes)
    axes.set(xticks=[], yticks=[], ylabel='')
    return True


def span(values: np.ndarray) -> tuple[float, float, bool]:
    """
    Return (low, high) of the finite ``values`` >= 0 to show, and whether on a log scale.

    What lies far beyond all but a few values is left out, as is 0 on a log scale.
    """
    high, most = float(values.max()), float(np.quantile(values, 0.95))
    if high > DECADES * most > 0.0:
        high = float(values[values <= 3.0 * most].max())
    positive = values[(values > 0.0) & (values <= high)]
    low = float(np.quantile(positive, 0.02)) if positive.size else high
    if high > DECADES * low:
        least = float(positive.min())
        return (low if low > DECADES**3 * least else least), high, True
    return float(values.min()), high, False


def bins(values: np.ndarray, is_log: bool, is_count: bool) -> np.ndarray:
    """Return the edges of a histogram's bins; counts get a bin each while that is few."""
    low, high = float(values.min()), float(values.max())
    if is_log:
        return np.geomspace(low, high, BINS + 1)
    if is_count and high - low <= 2 * BINS:
        return np.arange(low, high + 2.0) - 0.5
    return np.linspace(low, high, BINS + 1) if high > low else np.array([low - 0.5, low + 0.5])


def along_axis(axes: Any, study: SweepConfig, metric: Metric, values: np.ndarray) -> None:
    """Draw the median along the one axis, and the band from 5 to 95 %."""
    ((name, points),) = study.axes.items()
    runs = values.reshape(len(points), study.extent.runs)
    low, middle, high = quantiles(runs, (0.05, 0.5, 0.95))
    axes.set_xlabel(axis_label(name))
    axes.set_title('\n'.join([metric.label, left_out(metric, values)]).strip(), fontsize=10)
    if is_same(axes, np.concatenate([low, middle, high]), 'at all points'):
        return
    # where the 95 % quantile never settles the band is open: it ends at the top
    high = np.where(np.isnan(high), np.nanmax(values), high)
    if type(points[0]) in (float, int):
        axes.fill_between(points, low, high, color=BLUE, alpha=0.25, lw=0)
        axes.plot(points, middle, color=BLUE, marker='.' if len(points) < 40 else None)
        axes.set_xscale('log' if study.vary[name].kind == 'log_grid' else 'linear')
        axes.set_xlim(points[0], points[-1])
    else:
        places = range(len(points))
        axes.vlines(places, low, high, color=BLUE, alpha=0.25, lw=8)
        axes.plot(places, middle, 'o', color=BLUE)
        axes.set_xticks(places, [str(point) for point in points])
        axes.set_xlim(-0.5, len(points) - 0.5)
    if np.isfinite(middle).any():
        axes.set_yscale('log' if span(middle[np.isfinite(middle)])[2] else 'linear')
    axes.grid(alpha=0.3)


def heat_map(axes: Any, study: SweepConfig, metric: Metric, values: np.ndarray) -> None:
    """Draw the median over the two axes; the first one goes up, the second to the right."""
    shape = *(len(points) for points in study.axes.values()), study.extent.runs
    middle = quantiles(values.reshape(shape), (0.5,))[0]
    note = left_out(metric, values)
    if np.isnan(middle).any():
        note += '; grey: half or more' if study.extent.runs > 1 else '; grey: these'
    axes.set_title('\n'.join([metric.label, note]).strip(), fontsize=10)
    if is_same(axes, middle, 'at all points'):
        return
    low, high, is_log = span(middle[np.isfinite(middle)])
    axes.set_facecolor(GREY)
    # what is below the scale, as 0 is, has its darkest colour
    drawn = np.ma.masked_invalid(np.maximum(middle, 0.5 * low) if is_log else middle)
    norm = LogNorm(low, high) if is_log else Normalize(low, high)
    image = axes.imshow(drawn, norm=norm, origin='lower', aspect='auto', interpolation='nearest')
    beyond = EXTEND[(middle < low).any() + 2 * (middle > high).any()]
    bar = axes.figure.colorbar(image, ax=axes, extend=beyond)
    if not is_log:
        bar.formatter.set_powerlimits((-3, 5))
    for axis, (name, points) in zip((axes.yaxis, axes.xaxis), study.axes.items(), strict=True):
        labels = [format(one, '.3g') if type(one) is float else str(one) for one in points]
        most = TICKS if max(map(len, labels)) < 6 else TICKS // 2  # long ones would overlap
        step = -(-(len(points) - 1) // most) or 1
        axis.set_ticks(range(0, len(points), step), labels[::step])
        axis.set_label_text(axis_label(name))


def axis_label(name: str) -> str:
    """Return e.g. ``F_c [N]``."""
    return Quantity(name, found(name)[3].unit, '').label


STYLES: dict[int, tuple[Panel, str]] = {
    0: (distribution, 'distributions'),
    1: (along_axis, 'median and 5 to 95 %'),
    2: (heat_map, 'medians'),
}
