"""Figs. 1 to 5, drawn from the runs; nothing is computed here but what to show."""

from collections.abc import Callable
import re
import textwrap
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
import numpy as np

from impulse_control_ros.core.design import dead_zone
from impulse_control_ros.plotting import phase_plane, POSITION, TIME, VELOCITY
from impulse_control_ros.tools.figures import WIDTH
from impulse_control_ros.tools.paper.runs import Case, FRICTION_SECONDS, Runs

# The Okabe-Ito colours, which stay apart for any eye; the dashes do so in print.
PD: dict[str, Any] = {'color': '#0072B2', 'label': 'PD alone'}
IMPULSES: dict[str, Any] = {'color': '#D55E00', 'label': 'PD and impulses, sampled at 10 kHz'}
BOUNCE: dict[str, Any] = {
    'color': '#009E73',
    'label': 'exact, one jump a crossing',
    'linestyle': (0, (4, 2)),
}
STRICT: dict[str, Any] = {
    'color': 'black',
    'label': 'exact, read strictly',
    'linestyle': (0, (1, 1.5)),
}
LINE = 0.155  # in; from line to line of a caption
COLUMNS, NO_BREAK = 148, '\xa0'  # of a line of the caption


def draw(figure: int, runs: Runs, caption: str = '') -> Figure:
    """Return Fig. ``figure`` with its caption below, in `STYLE`, which the caller sets."""
    panels, height = DRAWN[figure]
    bound = re.sub(r'(?<=\d) ', NO_BREAK, caption)  # a number and its unit
    lines = [line for part in bound.splitlines() for line in textwrap.wrap(part, COLUMNS)]
    below = LINE * len(lines) + (0.1 if lines else 0.0)
    whole = height + below
    drawn = Figure(
        figsize=(WIDTH, whole),
        layout=ConstrainedLayoutEngine(rect=(0.0, below / whole, 1.0, height / whole)),
    )
    panels(drawn, runs)
    drawn.text(0.012, 0.06 / whole, '\n'.join(lines), fontsize=8.0, va='bottom', linespacing=1.25)
    return drawn


def fig1(figure: Figure, runs: Runs) -> None:
    """Show PD alone at both bounds of the damping: over time, and in the phase plane."""
    left, right = figure.subplots(1, 2)
    for case, color, bound in (
        (runs.pd_upper, 'black', 'upper'),
        (runs.pd_lower, PD['color'], 'lower'),
    ):
        label = f'PD alone, {bound} bound d = {case.axis.damping.value:g} N s/m'
        left.plot(case.run.time, case.run.position, color=color, label=label)
        right.plot(case.run.position, case.run.velocity, color=color)
    left.set(xlabel=TIME, ylabel=POSITION, xlim=(0.0, 2.0))
    left.legend(loc='upper right')
    phase_plane(right)


def fig2(figure: Figure, runs: Runs) -> None:
    """Show position and velocity with and without impulses; the cascade at e = 0 in the zoom."""
    axes = figure.subplots(2, 2, sharex='col', width_ratios=(1.7, 1.0))
    for row, name in enumerate(('position', 'velocity')):
        wide, near = axes[row]
        wide.plot(runs.pd_lower.run.time, getattr(runs.pd_lower.run, name), **PD)
        wide.plot(*exact(runs.impulses, row, 1.5), **BOUNCE)
        wide.plot(runs.impulses.run.time, getattr(runs.impulses.run, name), **IMPULSES)
        cascade(near, runs.impulses, row, 1e3 if name == 'position' else 1.0)
    axes[0, 0].set(ylabel=POSITION, xlim=(0.0, 1.5))
    axes[1, 0].set(ylabel=VELOCITY, xlabel=TIME)
    axes[0, 1].set(ylabel='position [mm]', title='the first position zero, sample by sample')
    axes[1, 1].set(ylabel=VELOCITY, xlabel='time after it [ms]')
    handles = axes[0, 0].get_lines()[:1] + axes[0, 1].get_lines()
    figure.legend(handles=handles, loc='outside upper center', ncols=4)


def exact(case: Case, state: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and position (``state`` 0) or velocity (1) with one jump a crossing."""
    jumps = case.one_jump.events['time']
    around = np.concatenate([np.linspace(0.0, end, 1500), jumps, np.nextafter(jumps, -1.0)])
    time = np.sort(around[(around >= 0.0) & (around <= end)])
    return time, case.one_jump.at(time)[state]


def cascade(axes: Axes, case: Case, state: int, scale: float) -> None:
    """Draw position or velocity around the first position zero."""
    run, zero = case.run, case.strict.end_time
    near = np.flatnonzero(np.abs(run.time - zero - 1.0e-3) < 1.6e-3)
    offset = 1e3 * (run.time[near] - zero)
    time = np.linspace(zero - 0.6e-3, zero + 2.6e-3, 400)
    for solution, style in ((case.one_jump, BOUNCE), (case.strict, STRICT)):
        axes.plot(1e3 * (time - zero), scale * solution.at(time)[state], **style)
    values = (run.position, run.velocity)[state][near]
    axes.plot(offset, scale * values, marker='.', markersize=5, linewidth=0.9, **IMPULSES)
    axes.set(xlim=(-0.6, 2.6))
    if state == 0:
        axes.set_ylim(-0.35, 1.0)


def fig3(figure: Figure, runs: Runs) -> None:
    """Show the damping over time, and its bounds."""
    axes, run, damping = figure.subplots(), runs.varying.run, runs.varying.axis.damping
    text = f'white noise through a filter of {damping.bandwidth:g} Hz, seed {damping.seed}'
    axes.plot(run.time[:-1], run.damping, color='black', linewidth=1.0, label=text)
    for bound, label in ((damping.upper, 'bounds of (1)'), (damping.lower, None)):
        axes.axhline(bound, color='#CC79A7', linestyle='--', label=label)
    axes.set(xlabel=TIME, ylabel='damping d(t) [N s/m]', xlim=(0.0, 2.0), ylim=(0.0, 1.9))
    axes.legend(loc='upper right', ncols=2)


def fig4(figure: Figure, runs: Runs) -> None:
    """Show varying damping in the phase plane, the zoom on its origin, and over time."""
    plane, zoom, time = figure.subplots(1, 3)
    for axes in (plane, zoom):
        for case, style in ((runs.pd_varying, PD), (runs.varying, IMPULSES)):
            axes.plot(case.run.position, case.run.velocity, **style)
        position, velocity = (exact(runs.varying, state, 2.0)[1] for state in (0, 1))
        axes.plot(position, velocity, **BOUNCE)
        phase_plane(axes)
    zoom.set(xlim=(-0.03, 0.06), ylim=(-1.6, 0.5), title='zoom on the origin')
    for case, style in ((runs.pd_varying, PD), (runs.varying, IMPULSES)):
        time.plot(case.run.time, case.run.position, **style)
    time.plot(*exact(runs.varying, 0, 2.0), **BOUNCE)
    time.set(xlabel=TIME, ylabel=POSITION, xlim=(0.0, 1.2))
    handles, labels = plane.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper center', ncols=3)


def fig5(figure: Figure, runs: Runs) -> None:
    """Show Coulomb friction in the phase plane with its dead zone, and the error over time."""
    plane, time = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    inset = plane.inset_axes((0.13, 0.33, 0.38, 0.4))
    zone = dead_zone(runs.coulomb.gains, runs.coulomb.axis.F_c)
    for axes in (plane, inset):
        style = {'color': '0.75', 'linewidth': 6.0, 'zorder': 0, 'solid_capstyle': 'butt'}
        label = f'$\\pm F_c/K$ = $\\pm${zone:g} m: PD sticks'
        axes.plot((-zone, zone), (0.0, 0.0), label=label, **style)
        for case, style in ((runs.pd_coulomb, PD), (runs.coulomb, IMPULSES)):
            axes.plot(case.run.position, case.run.velocity, **style)
    phase_plane(plane)
    plane.set(xlim=(-0.11, 0.16), ylim=(-1.9, 0.15))
    inset.set(xlim=(-0.002, 0.03), ylim=(-0.24, 0.02))
    inset.tick_params(labelsize=7)
    inset.grid(visible=False)
    plane.indicate_inset_zoom(inset, edgecolor='0.4')
    plane.legend(loc='lower right')
    error_over_time(time, runs)


def error_over_time(axes: Axes, runs: Runs) -> None:
    """Draw abs(e) without and with impulses, exactly and at each time step."""
    axes.semilogy(runs.pd_coulomb.run.time, runs.pd_coulomb.run.position, **PD)
    grid = np.linspace(0.0, FRICTION_SECONDS, 601)
    style = STRICT | {'label': 'exact, either reading', 'zorder': 3}
    axes.semilogy(grid, runs.coulomb.strict.at(grid)[0], **style)
    shades = ('#E69F00', IMPULSES['color'], '#882255')
    for (step, run), color in zip(runs.steps.items(), shades, strict=True):
        thin = slice(None, None, max(1, round(1e-3 / step)))
        label = f'sampled, time step {step:g} s'
        axes.semilogy(run.time[thin], np.abs(run.position[thin]), color=color, label=label)
    axes.set(xlabel=TIME, ylabel='|error| [m]', xlim=(0.0, FRICTION_SECONDS), ylim=(5e-7, 0.5))
    axes.legend(loc='lower left')


DRAWN: dict[int, tuple[Callable[[Figure, Runs], None], float]] = {
    1: (fig1, 3.0),
    2: (fig2, 4.4),
    3: (fig3, 2.4),
    4: (fig4, 3.3),
    5: (fig5, 3.8),
}
