"""The sweep as a process: interrupted, killed, continued and distributed, to the same bytes."""

import signal
import sys

import pyarrow.parquet as pq
import pytest

from impulse_control_ros.files.sweep_config_file import read_study
from test.conftest import BIN, CONFIG, Process, wait_for

# 42 chunks of some hundredths of a second of a core
STUDY = f"""
experiment: {CONFIG / 'time_varying.yaml'}
duration: 8.0
seed: 1
runs: 2000
vary:
  F_c: {{values: [0.0, 1.0]}}
  plant_simulator.m: {{normal: [0.1, 0.002]}}
  damping.seed: {{seeds: true}}
"""
SHORT = STUDY.replace('8.0', '0.01').replace('2000', '50')


class Desk:
    """A folder to start processes in."""

    def __init__(self, folder, env):
        self.folder, self.env, self.started = folder, env, []

    def start(self, name, *command):
        log = self.folder / f'{len(self.started)}_{name}.log'
        self.started.append(Process(name, [str(word) for word in command], log, self.env))
        return self.started[-1]

    def sweep(self, *arguments):
        return self.start('sweep', BIN / 'sweep', *arguments)

    def study(self, text=STUDY, name='study.yaml'):
        path = self.folder / name
        path.write_text(text)
        return path

    def close(self):
        for process in reversed(self.started):
            process.kill()


@pytest.fixture
def desk(tmp_path, graph):
    made = Desk(tmp_path, graph.env)
    yield made
    made.close()


@pytest.fixture(scope='module')
def undisturbed(tmp_path_factory):
    """Return the bytes of the result that nothing disturbed, and what the sweep said."""
    desk = Desk(tmp_path_factory.mktemp('undisturbed'), None)
    process = desk.sweep(desk.study(), '--out', desk.folder / 'out')
    assert process.wait() == 0, process.output
    return (desk.folder / 'out' / 'runs.parquet').read_bytes(), process.output


def parts(out):
    """Return what identifies each part that is there, by its name."""
    found = {}
    for path in (out / 'parts').glob('part_*.parquet'):
        state = path.stat()
        found[path.name] = (state.st_ino, state.st_mtime_ns)
    return found


def chunks_of(path):
    return read_study(path).chunks


def test_a_sweep_that_is_killed_and_interrupted_repeats_no_chunk_and_ends_the_same(
    desk, undisturbed
):
    study, out = desk.study(), desk.folder / 'out'
    chunks = chunks_of(study)
    first = desk.sweep(study, '--out', out)
    wait_for(lambda: len(parts(out)) >= 3, 'three parts')
    first.kill()
    killed = parts(out)
    assert 3 <= len(killed) < chunks
    second = desk.sweep(study, '--out', out)
    wait_for(lambda: len(parts(out)) >= len(killed) + 3, 'three more parts')
    assert second.interrupt() == 1
    there = parts(out)
    assert killed.items() <= there.items()
    assert f'{chunks} chunks, {len(killed)} of them finished, on ' in second.output
    assert second.output.splitlines()[-1] == (
        f'sweep: interrupted with {len(there)} of {chunks} chunks finished; '
        'the same command goes on from there'
    )
    assert 'Traceback' not in second.output
    damaged = out / 'parts' / max(there)
    damaged.write_bytes(damaged.read_bytes()[:-100])
    third = desk.sweep(study, '--out', out)
    assert third.wait() == 0, third.output
    assert f'{chunks} chunks, {len(there) - 1} of them finished, on ' in third.output
    assert (out / 'runs.parquet').read_bytes() == undisturbed[0]
    assert sorted(path.name for path in out.iterdir()) == [
        'figures.pdf',
        'figures.png',
        'runs.parquet',
    ]


def test_a_second_ctrl_c_ends_a_sweep_whose_chunks_are_long(desk):
    path = desk.folder / 'long.yaml'
    path.write_text('experiment: coulomb\nduration: 90000\nvary: {F_c: {grid: [0.5, 1, 3]}}\n')
    process = desk.sweep(path)
    process.says('1 chunks')
    process.send(signal.SIGINT)
    process.send(signal.SIGTERM)
    assert process.wait() == 1
    assert process.output.splitlines()[-1] == 'interrupted'


def start_cluster(desk, workers):
    """Start a Dask scheduler and workers on free ports of this machine; returns their names."""
    contact = desk.folder / 'scheduler.json'
    scheduler = desk.start(
        'scheduler',
        sys.executable,
        '-m',
        'distributed.cli.dask_scheduler',
        '--host',
        '127.0.0.1',
        '--port',
        0,
        '--no-dashboard',
        '--dashboard-address',
        '127.0.0.1:0',
        '--scheduler-file',
        contact,
    )
    scheduler.says('Scheduler at:')
    address = next(word for word in scheduler.output.split() if word.startswith('tcp://'))
    started = [
        desk.start(
            'worker',
            sys.executable,
            '-m',
            'distributed.cli.dask_worker',
            address,
            '--host',
            '127.0.0.1',
            '--nthreads',
            1,
            '--no-nanny',
            '--no-dashboard',
            '--dashboard-address',
            '127.0.0.1:0',
            '--local-directory',
            desk.folder / f'worker_{number}',
        )
        for number in range(workers)
    ]
    for worker in started:
        worker.says('Registered to:')
    return address, scheduler, started


def test_a_cluster_that_loses_a_worker_gives_the_bytes_of_this_machine(desk, undisturbed):
    study, out = desk.study(), desk.folder / 'out'
    address, scheduler, workers = start_cluster(desk, 2)
    sweep = desk.sweep(study, '--out', out, '--scheduler', address)
    wait_for(lambda: len(parts(out)) >= 4, 'four parts')
    workers[1].kill()
    assert len(parts(out)) < chunks_of(study)
    scheduler.says('Remove worker')
    assert sweep.running
    assert sweep.wait() == 0, sweep.output
    assert f'of them finished, on {address}' in sweep.output
    assert (out / 'runs.parquet').read_bytes() == undisturbed[0]


def test_a_sweep_begun_on_a_cluster_goes_on_here_when_the_scheduler_dies(desk, undisturbed):
    study, out = desk.study(), desk.folder / 'out'
    address, scheduler, _ = start_cluster(desk, 1)
    sweep = desk.sweep(study, '--out', out, '--scheduler', address)
    wait_for(lambda: len(parts(out)) >= 3, 'three parts')
    scheduler.kill()
    assert sweep.wait() == 1
    assert sweep.output.splitlines()[-1] == (
        f'sweep: the scheduler at {address} has gone; the same command goes on from there'
    )
    assert 'Traceback' not in sweep.output
    again = desk.sweep(study, '--out', out)
    assert again.wait() == 0, again.output
    assert (out / 'runs.parquet').read_bytes() == undisturbed[0]


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    """Return the folder of a finished short sweep, and what it said."""
    desk = Desk(tmp_path_factory.mktemp('finished'), None)
    process = desk.sweep(desk.study(SHORT), '--out', desk.folder / 'out')
    assert process.wait() == 0, process.output
    return desk.folder / 'out', process.output


def test_a_finished_sweep_shows_its_summary_again_without_running(desk, finished):
    out, said = finished
    result, picture = out / 'runs.parquet', out / 'figures.png'
    state, drawn = result.stat(), picture.read_bytes()
    picture.unlink()
    again = desk.sweep(desk.study(SHORT), '--out', out)
    assert again.wait() == 0, again.output
    assert (result.stat().st_ino, result.stat().st_mtime_ns) == (state.st_ino, state.st_mtime_ns)
    assert picture.read_bytes() == drawn
    assert again.output.splitlines()[0] == f'sweep: {result} is finished'
    table = again.output[again.output.index('median') :].split('\n\n')[0]
    assert table in said
    assert 'not settled to 0.01 m: 100 %' in table


def test_the_result_has_a_row_for_each_run_and_a_column_for_each_figure(finished):
    table = pq.read_table(finished[0] / 'runs.parquet')
    assert table.num_rows == 100
    assert table.column_names[:5] == [
        'F_c',
        'plant_simulator.m',
        'damping.seed',
        'settling_time_0.01',
        'settling_time_0.001',
    ]
    assert table['F_c'].to_pylist() == [0.0] * 50 + [1.0] * 50
    assert table.schema.field('peak_effort').metadata == {b'unit': b'N'}


def test_another_study_is_kept_out_of_the_folder(desk, finished):
    out = finished[0]
    before = (out / 'runs.parquet').read_bytes()
    other = desk.sweep(desk.study(SHORT.replace('seed: 1', 'seed: 2')), '--out', out)
    assert other.wait() == 2
    assert other.output == (
        f'sweep: {out} holds another study (seed = 1 there, 2 here): '
        'choose another --out or move it away\n'
    )
    assert (out / 'runs.parquet').read_bytes() == before


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('F_c:', 'F_d:', 'F_d: no such parameter can be varied; is F_c meant?'),
        ('runs: 50', 'runs: -1', 'invalid runs = -1: must be in [1, 1e+09]'),
    ],
)
def test_a_wrong_study_ends_with_one_line_and_leaves_nothing(desk, old, new, said):
    study = desk.study(SHORT.replace(old, new))
    process = desk.sweep(study, '--out', desk.folder / 'out')
    assert process.wait() == 2
    assert process.output == f'sweep: {study}: {said}\n'
    assert not (desk.folder / 'out').exists()


@pytest.mark.parametrize('address', ['nowhere://127.0.0.1:1', 'tcp://127.0.0.1:1'])
def test_where_no_scheduler_answers_one_line_says_so_and_nothing_is_left(desk, address):
    process = desk.sweep(desk.study(SHORT), '--out', desk.folder / 'out', '--scheduler', address)
    assert process.wait() == 1
    assert process.output.startswith(f'sweep: no scheduler answers at {address}: ')
    assert process.output.count('\n') == 1
    assert not (desk.folder / 'out').exists()


@pytest.mark.parametrize(
    ('module', 'arguments', 'said'),
    [
        (
            'pyarrow',
            [],
            "sweep: pyarrow is missing: pip install 'impulse_control_ros[analysis]', "
            'or pip install matplotlib pyarrow\n',
        ),
        (
            'matplotlib',
            [],
            'sweep: matplotlib is missing: pip install '
            "'impulse_control_ros[analysis]', or pip install matplotlib pyarrow\n",
        ),
        (
            'distributed',
            ['--scheduler', 'tcp://127.0.0.1:1'],
            'sweep: --scheduler needs dask.distributed: '
            "pip install 'impulse_control_ros[dask]', or pip install distributed\n",
        ),
    ],
)
def test_a_missing_package_is_named_with_the_command_that_installs_it(
    desk, module, arguments, said
):
    code = (
        f'import sys; sys.modules[{module!r}] = None; '
        'from impulse_control_ros.command_line import sweep; sys.exit(sweep())'
    )
    process = desk.start(
        'sweep',
        sys.executable,
        '-c',
        code,
        desk.study(SHORT),
        '--out',
        desk.folder / 'out',
        *arguments,
    )
    assert process.wait() == 1
    assert process.output == said


def test_help_shows_every_option(desk):
    process = desk.sweep('--help')
    assert process.wait() == 0
    for word in ('STUDY.yaml', '--out', '--scheduler'):
        assert word in process.output
