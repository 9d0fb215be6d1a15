"""The folder of a sweep: parts are whole and of this study, or made again, or refused."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from impulse_control_ros.errors import ParameterError, SweepError
from impulse_control_ros.files import sweep_folder
from impulse_control_ros.files.sweep_folder import SweepFolder

UNITS = {'F_c': 'N', 'impulses': '', 'kind': ''}


def columns(number):
    draw = np.random.default_rng(number)
    return {
        'F_c': draw.random(100),
        'impulses': draw.integers(0, 9, 100),
        'kind': np.array(['noise', 'constant'] * 50),
    }


@pytest.fixture
def folder(tmp_path):
    made = SweepFolder(tmp_path / 'out', json.dumps({'seed': 1}), UNITS)
    made.path.mkdir()
    for number in range(3):
        made.save(number, columns(number))
    return made


def part(folder, number):
    return folder.path / 'parts' / f'part_{number:07}.parquet'


def other(folder):
    return SweepFolder(folder.path, json.dumps({'seed': 2}), UNITS)


def test_the_result_holds_the_chunks_in_order_with_units_and_study(folder, monkeypatch):
    monkeypatch.setattr(sweep_folder, 'ROW_GROUP', 200)
    folder.conclude(3)
    for name in UNITS:
        assert np.array_equal(
            folder.column(name), np.concatenate([columns(number)[name] for number in range(3)])
        )
    schema = pq.read_schema(folder.result)
    assert schema.field('F_c').metadata == {b'unit': b'N'}
    assert json.loads(schema.metadata[b'impulse_control_ros']) == {'seed': 1}
    assert [path.name for path in folder.path.iterdir()] == ['runs.parquet']
    assert pq.ParquetFile(folder.result).num_row_groups == 2
    assert folder.is_concluded()


def test_a_result_can_be_read_by_anyone(folder):
    folder.conclude(3)
    table = pq.read_table(folder.result)
    assert table.column_names == list(UNITS)
    assert table.num_rows == 300


def test_the_order_in_which_chunks_come_leaves_every_byte(folder, tmp_path):
    folder.conclude(3)
    again = SweepFolder(tmp_path / 'again', json.dumps({'seed': 1}), UNITS)
    again.path.mkdir()
    for number in (2, 0, 1):
        again.save(number, columns(number))
    again.conclude(3)
    assert again.result.read_bytes() == folder.result.read_bytes()


def flipped(content):
    middle = len(content) // 4
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    'damage',
    [
        lambda content: content[:-1],
        lambda content: content[:50],
        lambda content: b'',
        flipped,
        lambda content: b'\0' * len(content),
    ],
)
def test_a_damaged_part_is_not_finished(folder, damage):
    assert folder.finished() == {0, 1, 2}
    path = part(folder, 1)
    path.write_bytes(damage(path.read_bytes()))
    assert folder.finished() == {0, 2}


def test_a_part_that_was_being_written_is_not_finished(folder):
    part(folder, 1).rename(part(folder, 1).with_name('.part_0000001.parquet.new'))
    assert folder.finished() == {0, 2}


def test_a_folder_of_another_study_is_refused_by_the_difference(folder):
    said = r'out holds another study \(seed = 1 there, 2 here\): choose another --out'
    with pytest.raises(ParameterError, match=said):
        other(folder).finished()
    folder.conclude(3)
    with pytest.raises(ParameterError, match=said):
        other(folder).is_concluded()


def test_a_result_that_cannot_be_opened_is_refused_by_the_reason(folder):
    folder.result.mkdir()
    with pytest.raises(IsADirectoryError, match=r'Is a directory: .*runs\.parquet'):
        folder.is_concluded()


def test_a_result_that_is_none_is_refused(folder):
    folder.result.write_bytes(b'PAR1')
    with pytest.raises(ParameterError, match=r'runs\.parquet is not the result of a sweep'):
        folder.is_concluded()


def test_a_file_where_the_folder_should_be_is_refused(tmp_path):
    (tmp_path / 'out').write_text('mine')
    with pytest.raises(ParameterError, match='out: must be a folder'):
        SweepFolder(tmp_path / 'out', '{}', UNITS).is_concluded()


def test_one_sweep_at_a_time_works_in_a_folder(folder):
    with (
        folder.held(),
        pytest.raises(SweepError, match='another sweep is working in '),
        other(folder).held(),
    ):
        pass
    with folder.held():
        pass


def test_a_sweep_that_is_kept_out_leaves_the_folder_of_the_first(tmp_path):
    first, second = (SweepFolder(tmp_path / 'out', '{}', UNITS) for _ in '12')
    with first.held():
        with pytest.raises(SweepError, match='another sweep is working in '), second.held():
            pass
        assert first.path.is_dir()


def test_a_folder_in_which_nothing_came_to_be_is_removed(tmp_path):
    folder = SweepFolder(tmp_path / 'out', '{}', UNITS)
    with folder.held():
        assert folder.path.exists()
    assert not folder.path.exists()
