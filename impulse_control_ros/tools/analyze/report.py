"""One HTML page with the runs, their figures of merit and all that it needs to show them."""

from collections.abc import Iterable, Iterator, Sequence
from importlib import resources
import json
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from impulse_control_ros import __version__
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.metric_catalogue import PANELS
from impulse_control_ros.core.metrics import differs
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.tools.analyze.packing import deflated, on_grid, packed
from impulse_control_ros.tools.analyze.run import Run
from impulse_control_ros.tools.analyze.supervision import failed_impulses
from impulse_control_ros.tools.analyze.table import Response, rows_of

PAGE = resources.files('impulse_control_ros.tools.analyze') / 'page'
BLOB = '<script type="text/plain" data-name="{}">{}</script>'


@np.errstate(all='ignore')  # recorded values may be nan, infinite or huge
def report(runs: Sequence[Run], responses: Sequence[Response]) -> str:
    """Return the page; it asks for nothing but a browser."""
    facts = {
        'version': __version__,
        'guards': GUARDS,
        'panels': {name: panel.label for name, panel in PANELS.items()},
        'table': rows_of(responses),
        'runs': [facts_of(run) for run in runs],
    }
    blobs = [
        BLOB.format(f'{number}.{name}', packed(values))
        for number, run in enumerate(runs)
        for name, values in arrays_of(run)
    ]
    return filled(part('page.html'), facts, blobs, part('page.js'))


def filled(page: str, facts: dict[str, Any], blobs: Sequence[str], script: str) -> str:
    """Return a ``page`` with its style, its content and its ``script``, and with plotly."""
    # '<' could end the element
    data = json.dumps(facts, separators=(',', ':'), allow_nan=False).replace('<', '\\u003c')
    for place, content in (
        ('STYLE', part('page.css')),
        ('FACTS', data),
        ('BLOBS', '\n'.join([BLOB.format('plotly', deflated(get_plotlyjs().encode())), *blobs])),
        ('SCRIPT', part('samples.js') + part('look.js') + script),
    ):
        before, after = page.split(f'<!--{place}-->')
        page = before + content + after
    return page


def part(name: str) -> str:
    """Return a file of the page."""
    return (PAGE / name).read_text(encoding='utf-8')


def arrays_of(run: Run) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what the page draws, by name; times in units of `facts_of`."""
    states, damping = run.states, run.recording.damping
    yield 'time', on_grid(states['stamp'] - states['stamp'][0])[0]
    yield 'error', run.error
    yield 'velocity', states['velocity']
    yield 'impulse', run.impulse
    # the feedback is the law's, nearly always: nothing else is to be packed
    rest = run.feedback - np.where(np.isfinite(run.law), run.law, 0.0)
    yield 'rest', np.where(differs(run.feedback, run.law), rest, 0.0)
    yield 'fired', run.fired
    yield 'guard', run.recording.impulses['guard']
    yield 'failed', failed_impulses(run.recording)
    yield 'suspended', run.recording.places(run.supervision.suspensions.ravel())
    yield 'damping_at', np.searchsorted(states['stamp'][:-1], damping['stamp'])
    yield 'damping', damping['damping']


def facts_of(run: Run) -> dict[str, Any]:
    """Return what the page says of a run, and needs to draw it."""
    recording, stamps = run.recording, run.states['stamp']
    cut = f'cut off: {recording.unread} bytes at the end could not be read'
    return {
        'name': run.name,
        'count': len(stamps),
        'unit': on_grid(stamps - stamps[0])[1] / SECOND,
        'settings': [{'first': setting.first, **setting.values} for setting in run.settings],
        'parameters': {
            node: texts(values.items()) for node, values in recording.parameters.items()
        },
        'changes': [
            (
                f'{(change.stamp - stamps[0]) / SECOND:.9g} s',
                change.node,
                texts((change.changed or change.values).items()),
            )
            for change in recording.changes
        ],
        'provenance': texts(
            [
                ('bag', str(run.path)),
                ('recorded by', f'impulse_control_ros {recording.version}'),
                ('first state at', f'{stamps[0] / SECOND:.9f} s'),
                *recording.recording_summary.items(),
                *([] if recording.unread is None else [('end', cut)]),
            ]
        ),
    }


def texts(items: Iterable[tuple[str, Any]]) -> dict[str, str]:
    """Return values as they are read."""
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in items}
