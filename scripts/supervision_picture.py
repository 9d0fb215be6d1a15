"""
Draw docs/images/supervision.png: an axis of half the assumed mass, behind a delay.

    python -m scripts.supervision_picture docs/images/supervision.png
"""

from collections.abc import Sequence
from pathlib import Path
import sys

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.impulse_verdicts import CONFIRMED, NO_VERDICT, VERDICTS
from impulse_control_ros.core.nonidealities import Actuator
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import Run, simulate
from impulse_control_ros.tools.figures import DOCS_DPI, save, STYLE

AXIS = Plant(m=0.05, F_c=0.0, actuator=Actuator(delay=20))  # the gains assume 0.1 kg
CURVES = (
    ('PD', '#0072B2', ControlGains(impulses=False)),
    ('impulses, supervision: false', '#D55E00', ControlGains(supervision=False)),
    ('impulses, supervised', '#009E73', ControlGains()),
)
DURATION, NEAR = 1.0, 0.12  # s: of the left panel, and of the right one
LARGEST, LEAST = 0.8, 1e-9  # m: what the panels show


def picture() -> Figure:
    """Return position and abs(error) of PD, impulses and supervised impulses over time."""
    figure = Figure(figsize=(9.6, 3.8), layout='constrained')
    left, right = figure.subplots(1, 2)
    for label, colour, gains in CURVES:
        run = simulate(AXIS, gains, DURATION)
        shown = slice(lost(run))
        time, position = run.time[shown], run.position[shown]
        left.plot(time, position, color=colour, label=label)
        right.plot(time, np.maximum(abs(position), LEAST), color=colour)
        if shown.stop:
            left.annotate('diverges', (time[-1], LARGEST), (8, -12), textcoords='offset points')
    left.set(xlim=(0.0, DURATION), ylim=(-LARGEST, LARGEST), ylabel='position [m]')
    right.set(xlim=(-0.003, NEAR), ylim=(LEAST, 2.0 * LARGEST), ylabel='abs(e) [m]', yscale='log')
    for axes in (left, right):
        mark(axes, run, colour)
        axes.set_xlabel('time [s]')
    figure.legend(handles=left.lines[: len(CURVES)], ncols=len(CURVES), loc='outside upper center')
    right.legend(loc='lower left', title='impulses, by verdict')
    return figure


def lost(run: Run) -> int | None:
    """Return the first sample at which a run has left the picture, None if it stays."""
    away = np.flatnonzero(abs(run.position) > LARGEST)
    return int(away[0]) + 1 if len(away) else None


def mark(axes: Axes, run: Run, colour: str) -> None:
    """Mark the impulses of each verdict, with a filled circle where they are confirmed."""
    ticks, _ = run.impulse_samples()
    verdicts = np.full(len(ticks), NO_VERDICT)
    verdicts[np.searchsorted(ticks, run.verdicts['tick']) - 1] = run.verdicts['verdict']
    for verdict in np.unique(verdicts):
        at = ticks[verdicts == verdict]
        axes.plot(
            run.time[at],
            run.position[at] if axes.get_yscale() == 'linear' else abs(run.position[at]),
            'o' if verdict == CONFIRMED else 's',
            color=colour,
            markerfacecolor=colour if verdict == CONFIRMED else 'white',
            label=VERDICTS[verdict].replace('_', ' ') or 'none yet',
        )


def main(arguments: Sequence[str]) -> None:
    """Save the picture."""
    with rc_context(STYLE):
        save(picture(), Path(arguments[0]), DOCS_DPI)


if __name__ == '__main__':
    main(sys.argv[1:])
