"""Records of an axis from bags of ours and of others, and from tables."""

import numpy as np
import pyarrow as pa
from pyarrow import parquet
from pyarrow.csv import write_csv
import pytest

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import BagError, RecordError
from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.record_files import read_record, Reading
from test.files.test_bag import START, STEP
from test.tools.bags import experiment, recorded, recorded_elsewhere, sent, STATES

TIME = np.arange(100) * 1e-3
COLUMNS = {
    'time': TIME,
    'position': np.sin(TIME),
    'effort': np.cos(TIME),
    'velocity': np.cos(TIME) + 1e-3,
}
NAMES = dict(zip(COLUMNS, ('t', 'x', 'u', 'v'), strict=True))


def written(path, columns):
    table = pa.table(columns)
    (write_csv if path.suffix == '.csv' else parquet.write_table)(table, path)
    return path


@pytest.mark.parametrize('suffix', ['.csv', '.parquet'])
def test_a_table_is_read_by_the_usual_names_or_those_that_are_given(tmp_path, suffix):
    usual = written(tmp_path / f'usual{suffix}', COLUMNS)
    own = written(
        tmp_path / f'own{suffix}', {NAMES[name]: values for name, values in COLUMNS.items()}
    )
    for path, reading in ((usual, Reading()), (own, Reading(columns=NAMES))):
        record, notes = read_record(path, reading)
        assert notes == []
        assert record.name == str(path)
        for name, values in COLUMNS.items():
            assert getattr(record, name).tobytes() == values.tobytes()
    needed = {name: NAMES[name] for name in ('time', 'position', 'effort')}
    assert read_record(own, Reading(columns=needed))[0].velocity is None


def test_a_part_of_a_record_is_read_and_its_effort_is_scaled(tmp_path):
    path = written(tmp_path / 'a.csv', COLUMNS | {'time': TIME + 5.0})
    record, _ = read_record(path, Reading(begin=0.0195, end=0.0495, effort_scale=-2.0))
    assert np.allclose(record.time, TIME[20:50])
    assert np.array_equal(record.effort, -2.0 * COLUMNS['effort'][20:50])


@pytest.mark.parametrize(
    ('columns', 'reading', 'said'),
    [
        ({'t': TIME}, Reading(), "no column 'time' for the time, but t: --columns time=COLUMN"),
        (COLUMNS, Reading(columns=NAMES), "no column 't' for the time, but time, position"),
        (
            COLUMNS,
            Reading(columns={name: name for name in COLUMNS} | {'velocity': 'w'}),
            "no column 'w'",
        ),
        (COLUMNS | {'effort': ['much'] * 100}, Reading(), "column 'effort' has no numbers"),
        (COLUMNS, Reading(begin=7.0), '0 samples with position and effort in the chosen time'),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_with_what_it_has(tmp_path, columns, reading, said):
    path = written(tmp_path / 'a.csv', columns)
    with pytest.raises(RecordError) as refused:
        read_record(path, reading)
    assert said in str(refused.value)
    assert str(path) in str(refused.value)


def test_what_is_no_table_is_refused_in_one_line(tmp_path):
    for name in ('a.csv', 'a.parquet'):
        path = tmp_path / name
        path.write_bytes(b'\x00\x01')
        with pytest.raises(RecordError) as refused:
            read_record(path, Reading())
        assert '\n' not in str(refused.value)


def test_samples_without_position_or_effort_are_left_out_and_counted(tmp_path):
    position = COLUMNS['position'].copy()
    position[[3, 4]] = np.nan
    record, notes = read_record(
        written(tmp_path / 'a.parquet', COLUMNS | {'position': position}), Reading()
    )
    assert len(record.time) == 98
    assert notes == ['2 of 100 samples lack position or effort and are left out']


def test_the_effort_of_our_bag_is_that_of_the_commands(tmp_path):
    bag, run = recorded(tmp_path / 'bag', 'underdamped', duration=0.02)
    record, notes = read_record(bag, Reading())
    assert notes == []
    assert record.effort.tobytes() == run.effort.tobytes()
    assert record.effort_held == 'after'
    assert record.position.tobytes() == run.position.tobytes()
    assert record.velocity.tobytes() == run.velocity.tobytes()
    assert np.allclose(record.time, run.time)


def test_the_effort_of_states_alone_acted_before_them_unless_it_is_taken_as_it_is(tmp_path):
    made = experiment('underdamped')
    run = simulate(made.plant, made.gains, 0.02)
    applied = np.append(0.0, run.effort[:-1])
    layout = JointStateLayout('lift', 'world', ('position', 'effort'))
    states = [
        (0, STATES, layout.encode(*divmod(START + k * STEP, 10**9), x, u))
        for k, (x, u) in enumerate(zip(run.position, applied, strict=True))
    ]
    bag = recorded_elsewhere(tmp_path / 'bag', sent(states))
    record, notes = read_record(bag, Reading())
    assert record.effort[:-1].tobytes() == run.effort[:-1].tobytes()
    assert record.velocity is None
    assert record.effort_held is None
    assert any('the effort is that of joint_states' in note for note in notes)
    record, _ = read_record(bag, Reading(as_is=True, selection={'joint': 'lift'}))
    assert record.effort.tobytes() == applied.tobytes()
    with pytest.raises(BagError, match='tilt'):
        read_record(bag, Reading(selection={'joint': 'tilt'}))
