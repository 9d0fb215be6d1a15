"""Metrics of recorded runs, as text, JSON or CSV."""

from collections.abc import Callable, Sequence
import csv
from dataclasses import dataclass
from io import StringIO
import json
import math
from pathlib import Path

import numpy as np

from impulse_control_ros.core.metric_catalogue import METRICS
from impulse_control_ros.errors import UsageError
from impulse_control_ros.tools.analyze.run import Run

WIDTH = 34


@dataclass(frozen=True, kw_only=True)
class Response:
    """The values of `METRICS` over a span of a run, by name; ``name`` heads them."""

    name: str
    path: Path
    metrics: dict[str, float]


@np.errstate(all='ignore')  # recorded values may be nan, infinite or huge
def responses_of(run: Run, every: bool, chosen: int | None = None) -> list[Response]:
    """
    Return the metrics of the last response of a run, of ``every`` one, or of the ``chosen`` one.

    They are numbered from 1. Raises `UsageError` for a number that there is not.
    """
    count = len(run.responses)
    if chosen is not None and not 1 <= chosen <= count:
        raise UsageError(
            f'{run.path}: --set-point-change {chosen}: must be in [1, {count}], the '
            'responses that --all shows'
        )
    numbers = range(1, count + 1) if every else [chosen or count]
    return [
        Response(
            name=f'{run.name}:{number}' if chosen or len(numbers) > 1 else run.name,
            path=run.path,
            metrics={name: metric.of(samples) for name, metric in METRICS.items()},
        )
        for number in numbers
        for samples in [run.samples(run.responses[number - 1])]
    ]


def rows_of(responses: Sequence[Response]) -> list[tuple[str, ...]]:
    """Return the rows of a table: the names, then each metric, a column a response."""
    return [('', *(response.name for response in responses))] + [
        (metric.label, *(metric.text(response.metrics[name]) for response in responses))
        for name, metric in METRICS.items()
    ]


def as_text(responses: Sequence[Response]) -> str:
    """Return a table with a column for each response."""
    rows = rows_of(responses)
    columns = list(zip(*rows, strict=True))[1:]
    widths = [max(12, *(len(cell) + 2 for cell in column)) for column in columns]
    return '\n'.join(
        f'{label:<{WIDTH}}'
        + ''.join(f'{cell:>{width}}' for cell, width in zip(cells, widths, strict=True))
        for label, *cells in rows
    )


def plain(response: Response) -> dict[str, float | str | None]:
    """Return a response by name; None for what is undefined."""
    return {'bag': response.name, 'path': str(response.path)} | {
        name: value if math.isfinite(value) else None for name, value in response.metrics.items()
    }


def as_json(responses: Sequence[Response]) -> str:
    """Return a list of objects, one a response."""
    return json.dumps([plain(response) for response in responses], indent=2, allow_nan=False)


def as_csv(responses: Sequence[Response]) -> str:
    """Return a header and a line for each response; what is undefined is empty."""
    text = StringIO()
    writer = csv.DictWriter(text, ['bag', 'path', *METRICS], lineterminator='\n')
    writer.writeheader()
    writer.writerows(plain(response) for response in responses)
    return text.getvalue().rstrip('\n')


FORMATS: dict[str, Callable[[Sequence[Response]], str]] = {
    'text': as_text,
    'json': as_json,
    'csv': as_csv,
}
