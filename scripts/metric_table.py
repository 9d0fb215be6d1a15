"""Write docs/reference/metrics.md: every metric and sample column, from the one catalogue."""

from collections.abc import Mapping
import sys

from impulse_control_ros.core.metric_catalogue import (
    METRICS,
    Quantity,
    SAMPLE_COLUMNS,
    sweep_metrics,
    TOLERANCES,
)

HEAD = """# Metrics

Made by `python scripts/metric_table.py`. The error is e = x - x_r, v the velocity, u the
commanded effort, J the area of an impulse. Numbers in parentheses are equations of the paper.
"""
RESPONSES = """
## Of a response

`analyze` measures one response: from the last change of the set-point `x_r` (or the last reset,
or the first answered state) to the end of the bag; with `--all` each response. If no command has
the stamp of a state, the response begins with the first effort that acts. The set-point of each
sample comes from the recorded controller parameters. The impulsive part of u is its
difference from the feedback -K e - D v (within the effort limit), from the sample of an impulse
until the two are equal again. If the bag has no gains, it is all of u. An integral (`K_i`) is
not separated: during an impulse it counts as impulsive. A settling time that is not reached is
`never` in the table. A value that cannot be computed, as the peak velocity of a bag without
velocities, is empty. In JSON both are null, in CSV empty.
"""
SWEEPS = """
## Of the runs of a sweep

The columns of `runs.parquet` after those of the varied parameters, with a settling time for each
of the `tolerances` of the study: {}. The last one tells {}.
"""
COLUMNS = """
## Columns of a sample

`export_bag` writes a row for each sample. A value that is not recorded at it is NaN, or empty.
"""


def rows(quantities: Mapping[str, Quantity]) -> str:
    """Return a Markdown table."""
    lines = ['| name | printed as | unit | meaning |', '|---|---|---|---|']
    lines += [
        f'| `{name}` | {one.title} | {one.unit} | {one.meaning} |'
        for name, one in quantities.items()
    ]
    return '\n' + '\n'.join(lines) + '\n'


def document() -> str:
    """Return the whole file."""
    *names, last = sweep_metrics(TOLERANCES)
    listed = ', '.join(f'`{name}`' for name in (*names, last))
    sweeps = SWEEPS.format(listed, sweep_metrics(())[last].meaning)
    return HEAD + RESPONSES + rows(METRICS) + sweeps + COLUMNS + rows(SAMPLE_COLUMNS)


if __name__ == '__main__':
    sys.stdout.write(document())
