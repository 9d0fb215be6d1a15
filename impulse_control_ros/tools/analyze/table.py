"""Metrics of recorded runs, as text, JSON or CSV."""

from collections.abc import Callable, Sequence
import csv
from dataclasses import dataclass
from io import StringIO
import json
import math
from pathlib import Path

from impulse_control_ros.core.metric_catalogue import METRICS
from impulse_control_ros.tools.analyze.run import Run

WIDTH = 34


@dataclass(frozen=True, kw_only=True)
class Response:
    """The values of `METRICS` over a span of a run, by name; ``name`` heads them."""

    name: str
    path: Path
    metrics: dict[str, float]


def responses_of(run: Run, every: bool) -> list[Response]:
    """Return the metrics of the last response of a run, or of ``every`` one."""
    spans = run.responses if every else run.responses[-1:]
    return [
        Response(
            name=run.name if len(spans) == 1 else f'{run.name}:{number}',
            path=run.path,
            metrics={name: metric.of(run.samples(span)) for name, metric in METRICS.items()},
        )
        for number, span in enumerate(spans, start=1)
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
    return json.dumps([plain(response) for response in responses], indent=2)


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
