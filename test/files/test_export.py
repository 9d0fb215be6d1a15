"""A bag as a table: every number has the bits of its message, in memory and in a file."""

import csv

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag import BagWriter
from impulse_control_ros.files.export import finite, to_csv, to_numpy, to_pandas, to_parquet, UNITS
from impulse_control_ros.files.recording import read_bag
from test.files.test_bag import begun, COMMAND, EVENT, STATE

NUMBERS = (
    'time',
    'stamp_ns',
    'position',
    'velocity',
    'effort',
    'command',
    'impulse_area',
    'damping',
)


@pytest.fixture(scope='module', params=['underdamped', 'left'])
def bag(request, recorded):
    return recorded / request.param


@pytest.fixture(scope='module')
def run(bag):
    return read_bag(bag)


@pytest.fixture(scope='module')
def table(bag):
    return to_numpy(bag)


def test_there_is_a_row_for_each_sample_in_the_order_of_time(run, table):
    assert np.array_equal(table['stamp_ns'], run.states['stamp'])
    assert np.array_equal(table['time'], np.arange(len(run.states)) * 100_000 / 1e9)
    assert tuple(table.dtype.names) == tuple(UNITS)


def test_a_row_has_the_bits_of_the_messages_of_its_stamp(run, table):
    for ours, theirs in (
        (table['position'], run.states['position']),
        (table['velocity'], run.states['velocity']),
        (table['effort'], run.states['effort']),
        (table['command'], run.commands['effort']),
        (table['is_reset'], run.states['is_reset']),
    ):
        assert ours.tobytes() == theirs.tobytes()


def test_impulses_and_damping_stand_at_their_stamp_and_nowhere_else(run, table):
    fired = table[table['guard'] != '']
    assert np.array_equal(fired['stamp_ns'], run.impulses['stamp'])
    assert list(fired['guard']) == [GUARDS[guard] for guard in run.impulses['guard']]
    assert fired['impulse_area'].tobytes() == run.impulses['area'].tobytes()
    assert not table['impulse_area'][table['guard'] == ''].any()
    known = table[~np.isnan(table['damping'])]
    assert np.array_equal(known['stamp_ns'], run.damping['stamp'])
    assert known['damping'].tobytes() == run.damping['damping'].tobytes()


def assert_same(frame, table):
    for name in NUMBERS:
        assert np.asarray(frame[name]).tobytes() == table[name].tobytes(), name
    assert list(frame['guard'].fillna('')) == list(table['guard'])
    assert list(frame['is_reset']) == list(table['is_reset'])


def test_pandas_has_the_same_bits_and_the_parameters(bag, run, table):
    frame = to_pandas(bag)
    assert_same(frame, table)
    assert isinstance(frame['guard'].dtype, pd.CategoricalDtype)
    assert frame.attrs['parameters'] == run.parameters
    assert frame.attrs['units']['velocity'] == 'm/s'
    assert frame.attrs['recording_summary']['missing'] == '0'
    assert (frame.attrs['run'], frame.attrs['lacks']) == (run.run, [])


def test_a_parquet_file_has_the_same_bits_and_the_parameters(bag, table, tmp_path):
    assert to_parquet(bag, tmp_path / 'run.parquet') == len(table)
    frame = pd.read_parquet(tmp_path / 'run.parquet')
    assert_same(frame, table)
    assert frame.attrs == to_pandas(bag).attrs
    schema = pq.read_schema(tmp_path / 'run.parquet')
    assert {field.name: field.metadata[b'unit'].decode() for field in schema} == UNITS


def test_a_csv_file_is_read_back_as_the_same_bits(bag, table, tmp_path):
    assert to_csv(bag, tmp_path / 'run.csv') == len(table)
    with (tmp_path / 'run.csv').open(newline='') as stream:
        rows = list(csv.DictReader(stream))
    for name in NUMBERS:
        kind = int if name == 'stamp_ns' else lambda text: float(text or 'nan')
        assert np.array([kind(row[name]) for row in rows]).tobytes() == table[name].tobytes()
    assert [row['guard'] for row in rows] == list(table['guard'])
    assert_same(pd.read_csv(tmp_path / 'run.csv', keep_default_na=True), table)


def test_a_sample_that_lacks_a_message_is_a_row_with_a_gap(tmp_path):
    writer = begun(tmp_path / 'run', 0)
    second = 10**9
    writer.write(
        [
            (second, 1, STATE.encode(1, 0, 0.5, -1.0, 2.0)),
            (second + 1, 3, COMMAND.encode(1, 1, 7.0)),
            (second + 2, 2, EVENT.encode(1, 2, 0.25, -1.0, 0.125)),
        ]
    )
    writer.close()
    table = to_numpy(tmp_path / 'run')
    assert list(table['stamp_ns']) == [second, second + 1, second + 2]
    assert np.isnan(table['position'][1:]).all()
    assert list(np.isnan(table['command'])) == [True, False, True]
    assert list(table['impulse_area']) == [0.0, 0.0, 0.125]
    assert list(table['guard']) == ['', '', 'position_zero']


def test_parameters_that_are_not_finite_are_null_as_json_has_no_such_numbers():
    told = {'K': float('nan'), 'limits': (float('-inf'), 1.0), 'name': 'axis', 'on': True}
    assert finite(told) == {'K': None, 'limits': [None, 1.0], 'name': 'axis', 'on': True}


def test_a_bag_without_samples_is_refused_and_no_file_is_left(tmp_path):
    BagWriter(tmp_path / 'run').close()
    for write in (to_csv, to_parquet):
        with pytest.raises(BagError, match='run.* has no samples'):
            write(tmp_path / 'run', tmp_path / 'table')
    assert [path.name for path in tmp_path.iterdir()] == ['run']
