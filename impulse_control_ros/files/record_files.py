"""
Read records of an axis for identification, from bags and from tables in CSV or Parquet files.

The effort of joint_states acted up to the state, as that of our plant does, and is moved to the
sample before, unless the user says how it acts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from pathlib import Path
from typing import Any

import numpy as np

from impulse_control_ros.core.axis_record import AFTER
from impulse_control_ros.core.identification import Record
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import BagError, MissingPackageError, RecordError
from impulse_control_ros.files.recording import read_bag, Recording

TABLES = ('.csv', '.parquet')
COLUMNS = {name: name for name in ('time', 'position', 'effort', 'velocity')}
NEEDED = ('time', 'position', 'effort')
PLENTY = 0.5  # share of the states that commands must reach to be taken for the effort


@dataclass(frozen=True, kw_only=True)
class Reading:
    """
    What to read from a file.

    ``columns`` maps time, position, effort and perhaps velocity to columns of a table, None for
    the columns of these names; ``selection`` has the arguments of `read_bag`. ``effort_scale``
    multiplies the effort, and ``as_is`` leaves that of joint_states at its sample. Only samples
    from ``begin`` to ``end`` [s], counted from the first one, are taken.
    """

    columns: Mapping[str, str] | None = None
    selection: Mapping[str, Any] = field(default_factory=dict)
    as_is: bool = False
    effort_scale: float = 1.0
    begin: float = 0.0
    end: float = math.inf


def read_record(path: Path, reading: Reading) -> tuple[Record, list[str]]:
    """
    Return the record of a file, and sentences about how it was read.

    Raises `BagError` for an invalid bag, `RecordError` for a table that cannot be used or has too
    few samples, and `MissingPackageError` where pyarrow is needed and not there.
    """
    if path.suffix in TABLES:
        columns, notes = columns_of_table(path, reading.columns)
        held = None
    else:
        columns, notes, held = columns_of_bag(read_bag(path, **reading.selection), reading.as_is)
    columns['effort'] = reading.effort_scale * columns['effort']
    # the ends of a record may lack an effort
    whole = np.isfinite(columns['position']) & np.isfinite(columns['effort'])
    time = columns['time'] - columns['time'][:1]
    inside = whole & (time >= reading.begin) & (time <= reading.end)
    columns = {name: values[inside] for name, values in columns.items()} | {'time': time[inside]}
    if len(columns['time']) < 2:
        raise RecordError(
            f'{path}: {len(columns["time"])} samples with position and effort'
            + (' in the chosen time' if len(time) > 1 else '')
            + '; two or more are needed'
        )
    lost = int(np.count_nonzero(~whole))
    if lost:
        notes.append(f'{lost} of {len(whole)} samples lack position or effort and are left out')
    return Record(**columns, effort_held=held, name=str(path)), notes


# -- bags -----------------------------------------------------------------------------------


def columns_of_bag(
    recording: Recording, as_is: bool
) -> tuple[dict[str, np.ndarray], list[str], str | None]:
    """Return the columns of a recording, sentences about it, and how its effort acts if known."""
    states = recording.states
    if not len(states):
        raise BagError('the bag has no states of the joint')
    notes = list(recording.lacks)
    if recording.unread is not None:
        notes.append(f'the bag was cut off: {recording.unread} bytes at its end cannot be read')
    effort = commanded(recording)
    held: str | None = AFTER
    if np.count_nonzero(np.isfinite(effort)) < PLENTY * len(states):
        effort, held = states['effort'], None
        if not as_is:
            effort = np.append(effort[1:], effort[-1:])
        notes.append(
            'the effort is that of joint_states, for the bag has no commands; a driver may give '
            'a current or an uncalibrated value there: see --effort-scale'
        )
    columns = {
        'time': (states['stamp'] - states['stamp'][0]) / SECOND,
        'position': states['position'],
        'effort': effort,
    }
    if np.isfinite(states['velocity']).all():
        columns['velocity'] = states['velocity']
    return columns, notes, held


def commanded(recording: Recording) -> np.ndarray:
    """Return the effort [N] that is commanded from each state on: nan before the first one."""
    commands = recording.commands
    stamps = np.append(commands['stamp'], recording.withdrawn)
    efforts = np.append(commands['effort'], np.zeros(len(recording.withdrawn)))
    order = np.argsort(stamps, kind='stable')
    last = np.searchsorted(stamps[order], recording.states['stamp'], 'right')
    return np.insert(efforts[order], 0, np.nan)[last]


# -- tables ---------------------------------------------------------------------------------


def columns_of_table(
    path: Path, columns: Mapping[str, str] | None
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the columns of a CSV or Parquet file; raises `RecordError` and `OSError`."""
    try:
        import pyarrow as pa
        from pyarrow import csv, parquet
    except ModuleNotFoundError:
        raise MissingPackageError(
            "pyarrow is missing: pip install 'impulse_control_ros[analysis]', or pip install "
            'pyarrow'
        ) from None
    try:
        with path.open('rb') as stream:  # not each name is UTF-8
            table = csv.read_csv(stream) if path.suffix == '.csv' else parquet.read_table(stream)
    except pa.ArrowException as error:
        raise RecordError(f'{path}: {" ".join(str(error).split())}') from None
    names = table.column_names
    wanted = dict(columns or {name: name for name in COLUMNS if name in names})
    for name in NEEDED:
        if wanted.get(name) not in names:
            raise RecordError(
                f'{path}: no column {wanted.get(name, name)!r} for the {name}, but '
                f'{", ".join(names)}: --columns {name}=COLUMN,... names it'
            )
    found = {}
    for name, column in wanted.items():
        if column not in names:
            raise RecordError(f'{path}: no column {column!r}, but {", ".join(names)}')
        kind = table.schema.field(column).type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            raise RecordError(f'{path}: column {column!r} has no numbers, but {kind}')
        values = table.column(column).combine_chunks().to_numpy(zero_copy_only=False)
        found[name] = values.astype(float)
    if 'velocity' in found and not np.isfinite(found['velocity']).all():
        del found['velocity']
    return found, []
