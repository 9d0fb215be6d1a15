"""
Export a bag as a table: one row per sample in time order, with the `SAMPLE_COLUMNS`.

Numbers keep the bits of the messages. Values not recorded at a sample are NaN, and empty in a
file. ``DataFrame.attrs`` and the metadata of a Parquet file hold the parameters, their changes,
the units, the recording summary and what is missing; a CSV file has no room for them.
"""

from collections.abc import Mapping
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.metric_catalogue import SAMPLE_COLUMNS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.atomic_write import replaced
from impulse_control_ros.files.recording import read_bag, Recording

UNITS = {name: column.unit for name, column in SAMPLE_COLUMNS.items()}
KEY = 'impulse_control_ros'
WORDS = {'guard': GUARDS, 'verdict': VERDICTS}
PANDAS_KEY = 'PANDAS_ATTRS'  # where pandas looks for DataFrame.attrs
Bag = str | Path | Recording  # a folder, a file, or the result of `read_bag`


def to_numpy(bag: Bag) -> np.ndarray:
    """Return a structured array of shape (n,), see above; raises `BagError` for an invalid bag."""
    columns = columns_of(sampled(bag))
    columns |= {name: np.array(words)[columns[name]] for name, words in WORDS.items()}
    table = np.empty(
        len(columns['time']), [(name, column.dtype) for name, column in columns.items()]
    )
    for name, column in columns.items():
        table[name] = column
    return table


def to_pandas(bag: Bag) -> Any:
    """Return a `pandas.DataFrame`, see above; raises `BagError` for an invalid bag."""
    table = to_arrow(bag)
    frame = table.to_pandas()
    frame.attrs = json.loads(table.schema.metadata[KEY.encode()])
    return frame


def to_parquet(bag: Bag, file: str | Path) -> int:
    """Write or replace ``file``; return the number of rows. Raises `BagError` and `OSError`."""
    import pyarrow.parquet as pq

    table = to_arrow(bag)
    with replaced(Path(file)) as path, path.open('wb') as stream:  # not each name is UTF-8
        pq.write_table(
            table, stream, compression='zstd', use_dictionary=[*WORDS], write_page_checksum=True
        )
    return len(table)


def to_csv(bag: Bag, file: str | Path) -> int:
    """Write or replace ``file``, with numbers in the shortest form that preserves their bits."""
    from pyarrow.csv import write_csv, WriteOptions

    table = to_arrow(bag)
    with replaced(Path(file)) as path, path.open('wb') as stream:
        write_csv(table, stream, WriteOptions(quoting_style='none', quoting_header='none'))
    return len(table)


def to_arrow(bag: Bag) -> Any:
    """Return a `pyarrow.Table`, see above; raises `BagError` for an invalid bag."""
    import pyarrow as pa

    run = sampled(bag)
    columns = columns_of(run)
    arrays = {name: pa.array(column, from_pandas=True) for name, column in columns.items()}
    for name, words in WORDS.items():
        arrays[name] = pa.DictionaryArray.from_arrays(arrays[name], words)
    about = json.dumps(finite(provenance(run)), allow_nan=False)
    return pa.table(
        list(arrays.values()),
        schema=pa.schema(
            [
                pa.field(name, array.type, metadata={'unit': UNITS[name]})
                for name, array in arrays.items()
            ],
            metadata={KEY: about, PANDAS_KEY: about},
        ),
    )


def sampled(bag: Bag) -> Recording:
    """Return the recording; raise `BagError` if it has no samples."""
    run = bag if isinstance(bag, Recording) else read_bag(bag)
    if not len(run.states):
        name = 'the recording' if run is bag else f'bag {str(bag)!r}'
        raise BagError(f'{name} has no samples')
    return run


def columns_of(run: Recording) -> dict[str, np.ndarray]:
    """Return the columns, each of shape (n,), with indices in place of `WORDS`."""
    series = (run.states, run.commands, run.events, run.damping)
    stamp = np.unique(np.concatenate([rows['stamp'] for rows in series]))

    def column(rows: np.ndarray, name: str, otherwise: Any = np.nan) -> np.ndarray:
        made = np.full(len(stamp), otherwise)
        made[np.searchsorted(stamp, rows['stamp'])] = rows[name]
        return made

    return {
        'time': (stamp - stamp[0]) / SECOND,
        'stamp_ns': stamp,
        'position': column(run.states, 'position'),
        'velocity': column(run.states, 'velocity'),
        'effort': column(run.states, 'effort'),
        'command': column(run.commands, 'effort'),
        'impulse_area': column(run.events, 'area', 0.0),
        'guard': column(run.events, 'guard', np.int8(0)),
        'verdict': column(run.events, 'verdict', np.int8(0)),
        'damping': column(run.damping, 'damping'),
        'is_reset': column(run.states, 'is_reset', False),
    }


def finite(value: Any) -> Any:
    """Return what JSON can hold: null for a number that is not finite."""
    if isinstance(value, Mapping):
        return {name: finite(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def provenance(run: Recording) -> Mapping[str, Any]:
    """Return the metadata of a run."""
    return {
        'units': UNITS,
        'run': run.run,
        'parameters': run.parameters,
        'changes': [change._asdict() for change in run.changes],
        'version': run.version,
        'recording_summary': run.recording_summary,
        'unread': run.unread,
        'lacks': run.lacks,
    }
