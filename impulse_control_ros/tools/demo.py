"""
``make demo``: the underdamped axis with PD alone and with impulses, recorded and compared.

It ends with the report that ``analyze --report`` makes of both, and names the dashboard.

Each run is one process that needs no other and must hear no other: it is not discovered.
"""

from datetime import datetime
from importlib.util import find_spec
import os
from pathlib import Path
import signal
import subprocess
import sys

from impulse_control_ros.core.metrics import overshoot, peak, settling_time
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.atomic_write import replaced
from impulse_control_ros.files.recording import read_bag, Recording
from impulse_control_ros.tools.analyze.run import Run
from impulse_control_ros.tools.analyze.table import responses_of

CASES = ('pd_only_lower', 'underdamped')
LIVE = '--dashboard --no-recorder --ros-args --params-file config/axis.yaml'


def executable(name: str) -> str:
    """Return the path of an installed executable."""
    return os.path.relpath(Path(sys.executable).with_name(name))


def closed_loop(config: Path, bag: Path) -> int:
    """Run one experiment through the installed executable; returns its exit status."""
    return subprocess.run(
        [
            executable('closed_loop'),
            '--ros-args',
            '--params-file',
            str(config),
            '-p',
            f'recorder:bag:={bag}',
            '--log-level',
            'warn',
        ],
        env=os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'},
        check=False,
    ).returncode


def rows(run: Recording) -> list[tuple[str, str]]:
    """Return (what, value with unit) of a recorded run."""
    states, recording_summary = run.states, run.recording_summary
    time = (states['stamp'] - states['stamp'][0]) / SECOND
    controller = next(values for values in run.parameters.values() if 'x_r' in values)
    error = states['position'] - controller['x_r']
    wall = float(recording_summary['wall_seconds'])
    return [
        ('settling time to 1e-2 m', f'{settling_time(time, error, 1e-2):.4f} s'),
        ('settling time to 1e-3 m', f'{settling_time(time, error, 1e-3):.4f} s'),
        ('overshoot', f'{overshoot(error):.2e} m'),
        ('peak velocity', f'{peak(states["velocity"]):.3f} m/s'),
        ('impulses', str(len(run.impulses))),
        ('peak effort', f'{peak(run.commands["effort"]):.4g} N'),
        ('messages recorded', recording_summary['messages']),
        ('messages missing', recording_summary['missing']),
        ('simulated per wall second', f'{time[-1] / wall:.2f}'),
    ]


def table(titles: list[str], columns: list[list[tuple[str, str]]]) -> str:
    """Return the runs side by side."""
    lines = [('', *titles)]
    lines += [
        (cells[0][0], *(value for _, value in cells)) for cells in zip(*columns, strict=True)
    ]
    return '\n'.join(
        f'{name:<26}' + ''.join(f'{value:>16}' for value in values) for name, *values in lines
    )


def write_report(path: Path, runs: list[Run]) -> None:
    """Write the report of the runs."""
    from impulse_control_ros.tools.analyze.report import report

    with replaced(path) as made:
        made.write_text(report(runs, [one for run in runs for one in responses_of(run, False)]))


def main() -> int:
    """Run both cases and print the table; returns the exit status."""
    folder = Path('runs', f'{datetime.now():%Y_%m_%d-%H_%M_%S}')
    bags = {case: folder / case for case in CASES}
    interrupts: list[int] = []
    # the run takes Ctrl-C itself, and finishes its bag
    signal.signal(signal.SIGINT, lambda number, _: interrupts.append(number))
    for case, bag in bags.items():
        print(f'{case}: recording {bag}', flush=True)
        status = closed_loop(Path('config', f'{case}.yaml'), bag)
        if interrupts:
            print(f'demo: interrupted; what was recorded is under {folder}', file=sys.stderr)
        if status or interrupts:
            return status or 1
    try:
        runs = [Run(name=case, path=bag, recording=read_bag(bag)) for case, bag in bags.items()]
    except BagError as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1
    columns = [rows(run.recording) for run in runs]
    print('\n' + table(['PD only', 'with impulses'], columns))
    if find_spec('plotly') is None:
        print('\nno report of the runs: it needs plotly (pip install plotly)')
    else:
        write_report(folder / 'report.html', runs)
        print(f'\nreport of both runs, for any browser: {folder / "report.html"}')
    print(f'dashboard, to watch and tune an axis: {executable("closed_loop")} {LIVE}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
