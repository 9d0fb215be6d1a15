"""An HTML page of an identified axis, in the style of `analyze --report`."""

from collections.abc import Iterator
from importlib import resources
import math
from pathlib import Path

import numpy as np

from impulse_control_ros import __version__
from impulse_control_ros.core.identification import Identification, Record
from impulse_control_ros.files.export import finite
from impulse_control_ros.tools.analyze.packing import packed
from impulse_control_ros.tools.analyze.report import BLOB, filled
from impulse_control_ros.tools.identify.table import facts_of, HEADS, is_asymmetric, rows_of
from impulse_control_ros.tools.identify.validation import SEGMENT, Validation

PAGE = resources.files('impulse_control_ros.tools.identify') / 'page'
MOST_POINTS = 4000  # of the friction; more cannot be told apart


def report(found: Identification, records: list[Record], validation: Validation) -> str:
    """Return the page, which needs nothing but a browser."""
    facts = {
        'version': __version__,
        'table': [HEADS, *rows_of(found)],
        'facts': [*facts_of(found), *found.warnings, *found.advice],
        'records': [Path(record.name).name for record in records],
        'validation': {
            'name': Path(validation.name).name,
            'start': float(validation.time[0]),
            'seen': validation.seen,
            'segment': SEGMENT,
            'rms': float(np.sqrt(np.mean(validation.error**2))),
        },
        'd_bar': found.d_bar,
        'friction': lines_of(found),
        'sweep': {
            'window': found.sweep.window.tolist(),
            'units': {name: found.parameters[name].unit for name in found.sweep.values},
            'values': {name: one.tolist() for name, one in found.sweep.values.items()},
            'errors': {name: one.tolist() for name, one in found.sweep.standard_errors.items()},
        },
    }
    blobs = [BLOB.format(name, packed(values)) for name, values in arrays_of(found, validation)]
    page, script = ((PAGE / name).read_text(encoding='utf-8') for name in ('page.html', 'page.js'))
    return filled(page, finite(facts), blobs, script)


def lines_of(found: Identification) -> list[tuple[float, float, float]]:
    """Return (direction, force at rest [N], damping [N s/m]) of the lines of the friction."""
    values = {**found.asymmetric, **found.parameters}
    names = (
        ((1.0, 'F_c_plus', 'd_plus'), (-1.0, 'F_c_minus', 'd_minus'))
        if is_asymmetric(found)
        else ((1.0, 'F_c', 'd'), (-1.0, 'F_c', 'd'))
    )
    lines = [(side, values[force].value, values[d].value) for side, force, d in names]
    return [line for line in lines if all(map(math.isfinite, line))]


def arrays_of(found: Identification, validation: Validation) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the data of the page, by name, in SI units."""
    yield 'time', validation.time - validation.time[0]
    yield 'position', validation.position
    yield 'simulated', validation.simulated
    yield 'error', validation.error
    every = max(1, math.ceil(len(found.friction.velocity) / MOST_POINTS))
    yield 'velocity', found.friction.velocity[::every]
    yield 'force', found.friction.force[::every]
    yield 'block_record', found.d_blocks.record.astype(np.uint32)
    yield 'block_time', found.d_blocks.time
    yield 'block_d', found.d_blocks.d
    yield 'block_error', found.d_blocks.standard_error
