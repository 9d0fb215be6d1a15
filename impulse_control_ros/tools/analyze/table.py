"""Figures of merit of recorded runs, as text, JSON or CSV."""

from collections.abc import Callable, Sequence
import csv
from dataclasses import dataclass
from io import StringIO
import json
import math
from pathlib import Path

import numpy as np

from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.metrics import (
    COUNTS,
    integral,
    overshoot,
    peak,
    settling_time,
    stuck,
    work,
)
from impulse_control_ros.core.sweep_config import MEASURES, settling, title
from impulse_control_ros.tools.analyze.run import Run

Figure = float | int
TOLERANCES = (1e-2, 1e-3)
FIGURES = {  # in their order: unit, name
    'start': ('s', 'from'),
    'end': ('s', 'to'),
    **{settling(tolerance): ('s', title(settling(tolerance))) for tolerance in TOLERANCES},
    **{
        name: MEASURES[name]
        for name in ('overshoot', 'iae', 'ise', 'final_error', 'peak_velocity')
    },
    'peak_feedback': ('N', 'peak effort without impulses'),
    **{name: MEASURES[name] for name in ('peak_effort', 'impulses', *COUNTS, 'impulse_area')},
    **{f'{name}_area': ('N s', MEASURES[name][1].replace('impulses', 'area')) for name in COUNTS},
    'work': ('N m', 'work of the effort'),
    'impulse_work': ('N m', 'work of the impulses'),
    'stuck': ('', 'stuck intervals'),
    'stuck_time': ('s', 'time stuck'),
    'samples': ('', 'samples'),
    'missing': ('', 'samples missing'),
}
WIDTH = 34


@dataclass(frozen=True, kw_only=True)
class Response:
    """The ``figures`` of a span of a run, by the names of `FIGURES`; ``name`` heads them."""

    name: str
    path: Path
    figures: dict[str, Figure]


def responses_of(run: Run, every: bool) -> list[Response]:
    """Return the figures of the last response of a run, or of ``every`` one."""
    spans = run.responses if every else run.responses[-1:]
    names = (
        [run.name]
        if len(spans) == 1
        else [f'{run.name}:{number}' for number in range(1, len(spans) + 1)]
    )
    return [
        Response(name=name, path=run.path, figures=figures_of(run, span))
        for name, span in zip(names, spans, strict=True)
    ]


def figures_of(run: Run, span: slice) -> dict[str, Figure]:
    """Return the figures of the states of ``span``, by the names of `FIGURES`."""
    states, time, error = run.states[span], run.time[span], run.error[span]
    since, size = time - time[0], np.abs(error)
    intervals, stuck_time = stuck(time, states['velocity'], error)
    steps = np.diff(states['stamp'])
    step = int(np.median(steps)) if len(steps) else 1
    figures: dict[str, Figure] = {
        'start': float(time[0]),
        'end': float(time[-1]),
        **{settling(item): settling_time(since, error, item) for item in TOLERANCES},
        'overshoot': overshoot(error),
        'iae': integral(time, size),
        'ise': integral(time, size * size),
        'final_error': float(error[-1]),
        'peak_velocity': peak(states['velocity']),
        'peak_feedback': peak(run.feedback[span]),
        'peak_effort': peak(run.effort[span]),
        **impulses_of(run, span),
        'work': work(states['position'], run.applied[span]),
        'impulse_work': work(states['position'], run.impulse[span]),
        'stuck': intervals,
        'stuck_time': stuck_time,
        'samples': len(states),
        'missing': int(np.maximum(np.rint(steps / step) - 1, 0).sum()),
    }
    return {name: figures[name] for name in FIGURES}


def impulses_of(run: Run, span: slice) -> dict[str, Figure]:
    """Return number and area of the impulses of ``span``, in all and by guard."""
    ours = run.recording.impulses[(run.fired >= span.start) & (run.fired < span.stop)]
    area = np.abs(ours['area'])
    figures: dict[str, Figure] = {'impulses': len(ours), 'impulse_area': float(area.sum())}
    for guard in COUNTS:
        which = ours['guard'] == GUARDS.index(guard)
        figures |= {guard: int(which.sum()), f'{guard}_area': float(area[which].sum())}
    return figures


def rows_of(responses: Sequence[Response]) -> list[tuple[str, ...]]:
    """Return the rows of a table: the names, then each figure in words, a column a response."""
    rows: list[tuple[str, ...]] = [('', *(response.name for response in responses))]
    for name, (unit, words) in FIGURES.items():
        rows.append(
            (
                f'{words} [{unit}]' if unit else words,
                *(shown(name, response.figures[name]) for response in responses),
            )
        )
    return rows


def shown(name: str, figure: Figure) -> str:
    """Return a figure for reading."""
    if isinstance(figure, int):
        return str(figure)
    if math.isfinite(figure):
        return f'{figure:.5g}'
    return 'never' if name in map(settling, TOLERANCES) else 'unknown'


def as_text(responses: Sequence[Response]) -> str:
    """Return a table with a column for each response."""
    rows = rows_of(responses)
    widths = [
        max(12, *(len(row[column]) + 2 for row in rows)) for column in range(1, len(rows[0]))
    ]
    return '\n'.join(
        f'{words:<{WIDTH}}'
        + ''.join(f'{cell:>{width}}' for cell, width in zip(cells, widths, strict=True))
        for words, *cells in rows
    )


def plain(response: Response) -> dict[str, Figure | str | None]:
    """Return a response by name; None for what there is not."""
    return {'bag': response.name, 'path': str(response.path)} | {
        name: figure if math.isfinite(figure) else None
        for name, figure in response.figures.items()
    }


def as_json(responses: Sequence[Response]) -> str:
    """Return a list of objects, one a response."""
    return json.dumps([plain(response) for response in responses], indent=2)


def as_csv(responses: Sequence[Response]) -> str:
    """Return a header and a line for each response; empty is what there is not."""
    text = StringIO()
    writer = csv.DictWriter(text, ['bag', 'path', *FIGURES], lineterminator='\n')
    writer.writeheader()
    writer.writerows(plain(response) for response in responses)
    return text.getvalue().rstrip('\n')


FORMATS: dict[str, Callable[[Sequence[Response]], str]] = {
    'text': as_text,
    'json': as_json,
    'csv': as_csv,
}
