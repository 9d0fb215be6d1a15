"""The picture of a comparison: settling time, residual error and peak effort over its levels."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
import numpy as np

from impulse_control_ros.tools.sweep_pictures import axis_label
from scripts.robustness.comparison import (
    Comparison,
    CONTROLLERS,
    HIGH,
    LOW,
    MEDIAN,
)

# The Okabe-Ito colours, which stay apart for any eye; marks and dashes do so in print.
STYLES: tuple[dict[str, Any], ...] = (
    {'color': '#0072B2', 'marker': 's'},
    {'color': '#009E73', 'marker': '^'},
    {'color': '#D55E00', 'marker': 'o'},
    {'color': '#CC79A7', 'marker': 'D'},
)
FLOOR = {'settling': 0.0, 'residual': 1e-6, 'peak': 0.0, 'impulses': 1.0}  # less is drawn there
LABELS = {
    'settling': 'settling time [s]',
    'residual': 'residual error [m]',
    'peak': 'peak effort [N]',
    'impulses': 'impulses in a run',
}
WITHOUT = 2  # so many controllers have no impulses


def picture(comparison: Comparison, duration: float) -> Figure:
    """
    Return the picture; a run of ``duration`` [s] that does not settle is at `never`.

    A cross at the top is a median that diverges.
    """
    frictions = comparison.frictions or (None,)
    figure = Figure(figsize=(4.6 * len(frictions) + 0.4, 9.6), layout='constrained')
    panels = figure.subplots(len(LABELS), len(frictions), sharex=True, sharey='row', squeeze=False)
    for row, key in zip(panels, LABELS, strict=True):
        row[0].set_ylabel(LABELS[key])
        for place, axes in enumerate(row):
            for number in range(WITHOUT if key == 'impulses' else 0, len(CONTROLLERS)):
                values = comparison.figures[key][:, :, place, number]
                if key == 'settling':
                    values = np.where(np.isnan(values), 2.0 * duration, values)
                curve(axes, comparison.levels, np.maximum(values, FLOOR[key]), number)
            axes.set_yscale('log')
        name_ticks(row[0])
    for axes, friction in zip(panels[0], frictions, strict=True):
        mark_never(axes, duration)
        if friction is not None:
            axes.set_title(f'F_c = {friction:g} N')
    for axes in panels[-1]:
        axes.set_xlabel(axis_label(comparison.disturbance))
        scale(axes, comparison.levels)
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(),
        ncols=len(CONTROLLERS),
        loc='outside upper center',
    )
    return figure


def curve(axes: Axes, levels: tuple[float, ...], values: np.ndarray, number: int) -> None:
    """Draw the median of a controller, and its band from 10 to 90 % of the runs."""
    style = STYLES[number]
    axes.fill_between(levels, values[LOW], values[HIGH], color=style['color'], alpha=0.15, lw=0)
    axes.plot(levels, values[MEDIAN], markersize=3.5, label=CONTROLLERS[number], **style)
    lost = [level for level, value in zip(levels, values[MEDIAN], strict=True) if np.isnan(value)]
    axes.plot(
        lost, [0.96] * len(lost), 'x', color=style['color'], transform=axes.get_xaxis_transform()
    )


def name_ticks(axes: Axes) -> None:
    """Name powers of ten alone, or more where they are too few."""
    low, high = axes.get_ylim()
    if high > 100.0 * low:
        axes.yaxis.set_minor_formatter(NullFormatter())
        return
    axes.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axes.yaxis.set_minor_formatter(lambda value, _: f'{value:g}')


def mark_never(axes: Axes, duration: float) -> None:
    """Give those that do not settle a place above the ``duration`` [s] of a run."""
    axes.axhline(1.3 * duration, color='black', lw=0.6)
    axes.set_yticks(
        [0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 2.0 * duration],
        ['0.02', '0.05', '0.1', '0.2', '0.5', '1', '2', '5', 'never'],
    )
    axes.minorticks_off()
    axes.set_ylim(top=2.7 * duration)


def scale(axes: Axes, levels: tuple[float, ...]) -> None:
    """Choose the scale that spreads the levels: a logarithm, from 0 on where 0 is one of them."""
    if levels[-1] <= 50.0 * min(level for level in levels if level > 0.0):
        axes.set_xscale('linear')
    elif levels[0] == 0.0:
        axes.set_xscale('symlog', linthresh=levels[1], linscale=0.5)
    else:
        axes.set_xscale('log')
    axes.set_xlim(levels[0], levels[-1])
