"""What all figures draw alike: panels of a trajectory, the phase plane, marks of impulses."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.metric_catalogue import SAMPLE_COLUMNS
from impulse_control_ros.core.trajectory import Trajectory

TIME, POSITION, VELOCITY, EFFORT = (
    SAMPLE_COLUMNS[name].label for name in ('time', 'position', 'velocity', 'effort')
)
MARKS: dict[str, dict[str, Any]] = {
    'position_zero': {'color': '#CC79A7', 'marker': 'o', 'label': 'impulse at e = 0'},
    'velocity_zero': {'color': '#009E73', 'marker': 'D', 'label': 'impulse at v = 0'},
    'sticking': {'color': '#E69F00', 'marker': 's', 'label': 'impulse while sticking'},
}
PANELS = {'position': POSITION, 'velocity': VELOCITY, 'effort': EFFORT}
SET_POINT: dict[str, Any] = {
    'label': 'set-point',
    'color': '0.5',
    'linestyle': '--',
    'drawstyle': 'steps-post',
    'zorder': 0,
}
MANY = 5000  # markers of a kind; more are drawn as pixels


def plot(motion: Trajectory, axes: Mapping[str, Axes] | None, label: str) -> dict[str, Axes]:
    """Draw a trajectory, see `Trajectory.plot`, into new axes where there are none."""
    panels = dict(axes) if axes is not None else new_panels()
    impulses = motion.impulse_samples()
    for name in [one for one in PANELS if one in panels]:
        values = getattr(motion, name)
        style = 'steps-post' if name == 'effort' else 'default'
        panels[name].plot(motion.time, values, drawstyle=style, label=label or None)
        mark_impulses(panels[name], motion.time, values, *impulses)
    if 'position' in panels:
        panels['position'].plot(motion.time, motion.set_point, **SET_POINT)
        entries = legend_entries(panels['position'])
        panels['position'].legend(entries.values(), entries.keys(), loc='upper right')
    if 'phase' in panels:
        panels['phase'].plot(motion.position, motion.velocity)
        mark_impulses(panels['phase'], motion.position, motion.velocity, *impulses)
    return panels


def new_panels() -> dict[str, Axes]:
    """Return the axes of a new pyplot figure: three over time, the phase plane beside them."""
    from matplotlib import pyplot

    _, panels = pyplot.subplot_mosaic(
        [[name, 'phase'] for name in PANELS],
        figsize=(11.0, 6.0),
        layout='constrained',
        width_ratios=(1.5, 1.0),
    )
    for name, text in PANELS.items():
        panels[name].sharex(panels['position'])
        panels[name].set_ylabel(text)
        panels[name].grid(alpha=0.3)
    panels['effort'].set_xlabel(TIME)
    phase_plane(panels['phase'])
    return panels


def phase_plane(axes: Axes) -> None:
    """Label the axes of a phase plane, and draw its state axes, the guards."""
    axes.set(xlabel=POSITION, ylabel=VELOCITY)
    axes.axhline(0.0, color='0.5', linewidth=0.6, zorder=0)
    axes.axvline(0.0, color='0.5', linewidth=0.6, zorder=0)


def mark_impulses(
    axes: Axes, x: np.ndarray, y: np.ndarray, index: np.ndarray, guard: np.ndarray
) -> None:
    """Mark the points ``index`` (k,) of a curve (n,) by the ``guard`` (k,) that fired there."""
    for name, style in MARKS.items():
        at = index[guard == GUARDS.index(name)]
        if at.size:
            axes.plot(
                x[at],
                y[at],
                linestyle='',
                markersize=3,
                zorder=3,
                rasterized=at.size > MANY,
                **style,
            )


def legend_entries(*axes: Axes) -> dict[str, Any]:
    """Return one handle for each label that the ``axes`` show."""
    return {
        label: handle
        for one in axes
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True)
    }
