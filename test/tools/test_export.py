"""``export_bag`` as a process."""

import os
import subprocess

import pandas as pd
import pytest

from impulse_control_ros.files.bag import BagWriter
from impulse_control_ros.files.export import to_pandas
from test.conftest import BIN, Process


@pytest.fixture
def export(tmp_path):
    started = []

    def run(*arguments):
        started.append(
            Process(
                'export_bag',
                [str(BIN / 'export_bag'), *map(str, arguments)],
                tmp_path / f'{len(started)}.log',
                {},
            )
        )
        return started[-1]

    yield run
    for process in started:
        process.kill()


def test_a_bag_becomes_a_parquet_file_that_pandas_reads(export, recorded, tmp_path):
    process = export(recorded / 'left', tmp_path / 'run.parquet')
    assert process.wait() == 0
    frame = to_pandas(recorded / 'left')
    assert process.output == f'export_bag: {tmp_path}/run.parquet has {len(frame)} rows\n'
    assert pd.read_parquet(tmp_path / 'run.parquet').equals(frame)


def test_a_bag_becomes_a_csv_file_and_replaces_the_one_before(export, recorded, tmp_path):
    file = tmp_path / 'run.csv'
    for bag in ('left', 'underdamped'):
        assert export(recorded / bag, file).wait() == 0
    assert (pd.read_csv(file)['position'] == to_pandas(recorded / 'underdamped')['position']).all()


@pytest.mark.parametrize('name', ['läuf', b'l\xe4uf'])
@pytest.mark.parametrize('suffix', ['.csv', '.parquet'])
@pytest.mark.parametrize('utf8', ['0', '1'])
def test_a_file_may_have_any_name_in_any_locale(recorded, tmp_path, name, suffix, utf8):
    file = tmp_path / (os.fsdecode(name) + suffix)
    done = subprocess.run(
        [BIN / 'export_bag', recorded / 'left', file],
        env=os.environ | {'LC_ALL': 'C', 'PYTHONUTF8': utf8, 'PYTHONCOERCECLOCALE': '0'},
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b'')
    assert file.exists()


def test_a_file_alone_without_its_folder_is_exported_too(export, recorded, tmp_path):
    assert export(recorded / 'left' / 'left_0.mcap', tmp_path / 'run.csv').wait() == 0


def test_a_bag_that_was_cut_off_is_exported_as_far_as_it_goes_with_a_warning(
    export, recorded, tmp_path
):
    whole = (recorded / 'left' / 'left_0.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(whole[: len(whole) // 2])
    process = export(tmp_path / 'cut.mcap', tmp_path / 'run.parquet')
    assert process.wait() == 0
    assert 'cut.mcap was cut off; ' in process.output
    frame = pd.read_parquet(tmp_path / 'run.parquet')
    all_of_it = to_pandas(recorded / 'left')
    assert 0.2 * len(all_of_it) < len(frame) < len(all_of_it)
    assert frame.attrs['unread'] > 0
    first, same = (one.head(len(frame) - 1) for one in (frame, all_of_it))
    # damping is not of the series: what DDS delivers late stands later in the file
    assert first.equals(same.assign(damping=same['damping'].where(first['damping'].notna())))


@pytest.mark.parametrize(
    ('bag', 'file', 'said'),
    [
        ('left', 'run.xlsx', 'run.xlsx: must end in .parquet or .csv'),
        ('left', 'none/run.csv', 'none/run.csv: must be a file in a folder that exists'),
        ('nothing', 'run.csv', "nothing' does not exist"),
        ('broken.mcap', 'run.csv', 'broken.mcap: '),
        ('empty', 'run.csv', "empty' has no samples"),
    ],
)
def test_bad_input_is_one_line_that_names_it_and_leaves_no_file(
    export, recorded, tmp_path, bag, file, said
):
    bags = {name: tmp_path / name for name in ('broken.mcap', 'empty')}
    bags['broken.mcap'].write_bytes(b'no bag at all')
    BagWriter(bags['empty']).close()
    process = export(bags.get(bag, recorded / bag), tmp_path / file)
    assert process.wait() == 2
    assert said in process.output
    assert len(process.output.splitlines()) == 1
    assert not list(tmp_path.glob('*run*'))


def test_a_file_that_cannot_be_written_is_named(export, recorded, tmp_path):
    (tmp_path / 'run.csv').mkdir()
    process = export(recorded / 'left', tmp_path / 'run.csv')
    assert process.wait() == 2
    assert 'run.csv: must be a file' in process.output
    process = export(recorded / 'left', '/proc/run.csv')
    assert process.wait() == 1
    assert process.output.startswith('export_bag: /proc/run.csv: ')
    assert len(process.output.splitlines()) == 1
