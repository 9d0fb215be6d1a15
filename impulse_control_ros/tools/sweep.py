"""
``sweep``: run what is left of a study, and show its result.

What a study needs is imported late, so that --help and a bad command line answer at once.
"""

import argparse
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from impulse_control_ros.command_line import Parser, StopRequest
from impulse_control_ros.errors import MissingPackageError, SweepError

if TYPE_CHECKING:
    from impulse_control_ros.core.sweep_config import SweepConfig
    from impulse_control_ros.files.sweep_folder import SweepFolder
    from impulse_control_ros.tools.sweep_workers import Workers

EPILOG = """\
The folder gets runs.parquet, a row for each run, and pictures. The same command resumes an
interrupted sweep, and shows the summary of a finished one again. The study file is described in
docs/reference/studies.md."""


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = Parser(
        prog='sweep',
        description='Run a Monte Carlo or grid study of the closed loop.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('study', metavar='STUDY.yaml', type=Path, help='the study')
    parser.add_argument(
        '--out', metavar='FOLDER', type=Path, help='folder of the result; runs/STUDY if not given'
    )
    parser.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='a Dask scheduler, e.g. tcp://10.0.0.1:8786; without: all cores here',
    )
    return parser.parse_args(arguments)


def main(stop: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """
    Run the missing chunks of a study and show its result; returns the exit status.

    Raises `ParameterError` for a study or folder, `SweepError` for a sweep that cannot continue.
    """
    options = parse(arguments)
    try:
        from impulse_control_ros.core.sweep_config import units
        from impulse_control_ros.files.sweep_config_file import identity, read_study
        from impulse_control_ros.files.sweep_folder import SweepFolder
        from impulse_control_ros.tools.sweep_pictures import save_pictures
        from impulse_control_ros.tools.sweep_summary import summary
    except ModuleNotFoundError as error:
        missing = str(error.name).split('.')[0]
        raise MissingPackageError(
            f"{missing} is missing: pip install 'impulse_control_ros[analysis]', or "
            'pip install matplotlib pyarrow'
        ) from None
    study = read_study(options.study)
    folder = SweepFolder(
        options.out or Path('runs', options.study.stem), identity(study), units(study)
    )
    rate = ''
    if folder.is_concluded():
        print(f'sweep: {folder.result} is finished')
    else:
        with workers_at(options.scheduler) as workers, folder.held():
            rate = finish(study, folder, workers, stop)
    folder.remove_parts()
    print('\n' + summary(study, folder.column) + rate)
    for path in save_pictures(study, folder.column, folder.path, options.study.stem):
        print(path)
    return 0


def workers_at(scheduler: str | None) -> 'AbstractContextManager[Workers]':
    """Return the workers of a cluster, or those here."""
    from impulse_control_ros.tools.sweep_workers import dask_workers, local_workers

    return dask_workers(scheduler) if scheduler else local_workers()


def finish(
    study: 'SweepConfig', folder: 'SweepFolder', workers: 'Workers', stop: StopRequest
) -> str:
    """Run the chunks that are not there; conclude if all are, and say how fast it was."""
    from tqdm import tqdm

    from impulse_control_ros.tools.sweep_workers import computed

    there = folder.finished()
    todo = [number for number in range(study.chunks) if number not in there]
    done = study.rows - sum(len(study.rows_of(number)) for number in todo)
    began = perf_counter()
    print(
        f'sweep: {study.rows} runs of {study.extent.duration:g} s ({study.steps} steps) in '
        f'{study.chunks} chunks, {len(there)} of them finished, on {workers.name}',
        flush=True,
    )
    tqdm.monitor_interval = 0  # no thread beside ours
    with tqdm(total=study.rows, initial=done, unit='run', disable=None) as bar:
        for number, columns in computed(workers, study, todo, stop):
            folder.save(number, columns)
            bar.update(len(study.rows_of(number)))
    wall = perf_counter() - began
    if stop.requested:
        raise SweepError(
            f'interrupted with {len(folder.finished())} of {study.chunks} chunks '
            'finished; the same command goes on from there'
        )
    folder.conclude(study.chunks)
    return speed(study, study.rows - done, wall, max(workers.slots(), 1)) if todo else ''


def speed(study: 'SweepConfig', runs: int, wall: float, cores: int) -> str:
    """Say how fast ``runs`` were done in ``wall`` seconds."""
    per_step = wall * cores / (runs * study.steps) * 1e9
    return (
        f'{runs} runs in {wall:.1f} s: {runs / wall:.0f} runs/s, {per_step:.1f} ns of wall '
        f'time per run-step and core on {cores} cores\n'
    )
