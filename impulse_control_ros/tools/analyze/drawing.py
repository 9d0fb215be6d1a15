"""A figure of recorded runs for print: over time on the left, in the phase plane on the right."""

from collections.abc import Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from impulse_control_ros.core.metric_catalogue import PANELS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.plotting import legend_entries, mark_impulses, phase_plane, TIME
from impulse_control_ros.tools.analyze.run import Run
from impulse_control_ros.tools.figures import PRINT_DPI, saved, STYLE, WIDTH

COLORS = ('#0072B2', '#D55E00', 'black', '#56B4E9', '#882255', '#999933')
HEIGHT = 1.35  # in; of a panel
CLOSE = 0.01  # share of the largest error that is near the origin


def figure(runs: Sequence[Run], suffix: str) -> bytes:
    """Return the content of a file; the same runs give the same bytes."""
    with rc_context({**STYLE, 'agg.path.chunksize': 20_000}):
        return saved(drawn(runs), suffix, PRINT_DPI)


def drawn(runs: Sequence[Run]) -> Figure:
    """Return the figure."""
    has_damping = any(len(run.recording.damping) for run in runs)
    names = [name for name in PANELS if name != 'damping' or has_damping]
    whole = Figure(figsize=(WIDTH, HEIGHT * len(names) + 0.5), layout='constrained')
    halves: Any = whole.subfigures(1, 2, width_ratios=(1.5, 1.0))
    left, right = halves
    panels = left.subplots(len(names), 1, sharex=True)
    plane, near = right.subplots(2, 1)
    for run, color in zip(runs, COLORS * len(runs), strict=False):
        for axes, name in zip(panels, names, strict=True):
            over_time(axes, run, name, color)
        impulses = run.recording.impulse_samples()
        for axes in (plane, near):
            axes.plot(run.error, run.states['velocity'], color=color)
            mark_impulses(axes, run.error, run.states['velocity'], *impulses)
    for axes, name in zip(panels, names, strict=True):
        axes.set_ylabel(PANELS[name].label)
    panels[-1].set_xlabel(TIME)
    for axes in (plane, near):
        phase_plane(axes)
        axes.set_xlabel('error [m]')
    near.set(title='near the origin', **close_limits(runs))
    entries = legend_entries(panels[0], plane)
    whole.legend(entries.values(), entries.keys(), loc='outside upper center', ncols=4)
    return whole


def over_time(axes: Axes, run: Run, name: str, color: str) -> None:
    """Draw one panel of a run."""
    if name == 'damping':
        damping = run.recording.damping
        time = (damping['stamp'] - run.states['stamp'][0]) / SECOND
        axes.plot(time, damping['damping'], color=color, linewidth=1.0)
        return
    values = run.states[name] if name in ('position', 'velocity') else getattr(run, name)
    axes.plot(run.time, values, color=color, label=run.name)
    if name != 'feedback':
        mark_impulses(axes, run.time, values, *run.recording.impulse_samples())


def close_limits(runs: Sequence[Run]) -> dict[str, tuple[float, float]]:
    """Return the limits of the phase plane near the origin."""
    close = CLOSE * max(float(np.abs(run.error).max()) for run in runs) or CLOSE
    speeds = np.concatenate(
        [[0.0], *(run.states['velocity'][np.abs(run.error) < close] for run in runs)]
    )
    speeds = speeds[np.isfinite(speeds)]  # they may be unknown
    room = 0.05 * float(np.ptp(speeds)) or close
    return {
        'xlim': (-close, close),
        'ylim': (float(speeds.min()) - room, float(speeds.max()) + room),
    }
