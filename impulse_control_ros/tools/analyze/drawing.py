"""A figure of recorded runs for print: over time on the left, in the phase plane on the right."""

from collections.abc import Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from impulse_control_ros.core.metric_catalogue import PANELS
from impulse_control_ros.plotting import legend_entries, mark_impulses, phase_plane, TIME
from impulse_control_ros.tools.analyze.run import Run
from impulse_control_ros.tools.figures import PRINT_DPI, saved, STYLE, WIDTH

COLORS = ('#0072B2', '#D55E00', 'black', '#56B4E9', '#882255', '#999933')
HEIGHT = 1.35  # in; of a panel
CLOSE = 0.01  # share of the largest error that is near the origin


@np.errstate(all='ignore')  # recorded values may be nan, infinite or huge
def figure(runs: Sequence[Run], suffix: str) -> bytes:
    """Return the content of a file; the same runs give the same bytes."""
    with rc_context({**STYLE, 'agg.path.chunksize': 20_000}):
        return saved(drawn(runs), suffix, PRINT_DPI)


def drawn(runs: Sequence[Run]) -> Figure:
    """Return the figure; what no run tells is left out, with the phase plane the velocity."""
    names = [name for name in PANELS if any(run.shows(name) for run in runs)]
    whole = Figure(figsize=(WIDTH, HEIGHT * len(names) + 0.5), layout='constrained')
    widths = (1.5, 1.0) if 'velocity' in names else (1.0,)
    halves: Any = whole.subfigures(1, len(widths), width_ratios=widths, squeeze=False)[0]
    panels = halves[0].subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    planes = halves[1].subplots(2, 1) if 'velocity' in names else ()
    for run, color in zip(runs, COLORS * len(runs), strict=False):
        for axes, name in zip(panels, names, strict=True):
            over_time(axes, run, name, color)
        for axes in planes:
            axes.plot(run.error, run.states['velocity'], color=color)
            mark_impulses(
                axes, run.error, run.states['velocity'], *run.recording.impulse_samples()
            )
    for axes, name in zip(panels, names, strict=True):
        axes.set_ylabel(PANELS[name].label)
    panels[-1].set_xlabel(TIME)
    for axes in planes:
        phase_plane(axes)
        axes.set_xlabel('error [m]')
    for axes in planes[1:]:
        axes.set(title='near the origin', **close_limits(runs))
    entries = legend_entries(panels[0], *planes[:1])
    whole.legend(entries.values(), entries.keys(), loc='outside upper center', ncols=4)
    return whole


def over_time(axes: Axes, run: Run, name: str, color: str) -> None:
    """Draw one panel of a run."""
    time, values = run.panel(name)
    if name == 'damping':
        axes.plot(time, values, color=color, linewidth=1.0)
        return
    axes.plot(time, values, color=color, label=run.name)
    if name != 'feedback':
        mark_impulses(axes, time, values, *run.recording.impulse_samples())


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
