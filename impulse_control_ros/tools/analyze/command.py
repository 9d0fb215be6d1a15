"""
``analyze``: metrics of recorded runs, and on request a report and a figure.

What takes time to import is imported on use, so that --help answers at once.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from math import inf, isfinite
import os
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from impulse_control_ros.command_line import add_selection, Parser, selection, StopRequest, warn
from impulse_control_ros.errors import DivergedError, UsageError
from impulse_control_ros.files.atomic_write import replaced

if TYPE_CHECKING:
    from impulse_control_ros.files.recording import Recording
    from impulse_control_ros.tools.analyze.run import Run

NAME = 'analyze'
EPILOG = """\
A figure of merit is measured over one response: from the last change of the set-point x_r (or the
last reset, or the start) to the end of the bag; with --all over each one, BAG:1, BAG:2 and so on.
Settling times count from there; 'from' and 'to' count from the first state. The error is x - x_r,
with the x_r that the bag tells for each sample; the overshoot is on the side opposite of where the
response begins. The effort is that of the command that answers each state; its impulsive part is
what it has beside the feedback -K e - D v from the sample of an impulse on. Work is the sum of the
effort that acted from each state to the next times the way, exact, as it is held over the sample.
Stuck is v = 0 with e != 0 in two samples or more. Units are SI. All names are
in docs/reference/metrics.md.

With --check each line is one check: its samples, how many of them violate it, and the first of
those with its stamp, value, expected value and tolerance. Checked are the equation of motion (3)
with the parameters of the plant, and the control law and its guards with those of the controller.
Exit status 1: one is violated. 2: the control law of a run could not be checked.

A bag that was cut off, as by kill -9, is analysed up to its last whole chunk, with a warning. So
is one that lacks anything of its run: a first response that begins in mid-run is no whole one."""


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options, or raise `UsageError`."""
    parser = Parser(
        prog=NAME,
        description='Print figures of merit of recorded runs.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'bags',
        metavar='BAG',
        nargs='+',
        type=Path,
        help='a rosbag2 folder, or a file in it: MCAP or sqlite3',
    )
    parser.add_argument(
        '--all',
        action='store_true',
        dest='every',
        help='each response of a bag, not its last one alone',
    )
    parser.add_argument(
        '--set-point-change',
        metavar='N',
        type=int,
        help='the response N, as --all numbers them, in place of the last one',
    )
    parser.add_argument(
        '--set-point',
        metavar='M',
        type=float,
        help='the set-point x_r of the whole run, in place of what the bag tells',
    )
    parser.add_argument(
        '--check',
        action='store_true',
        help='check whether the run is one of the axis (3) with the control law, '
        'in place of the figures',
    )
    for name, unit in (('position', 'M'), ('velocity', 'M/S')):
        parser.add_argument(
            f'--{name}-error',
            metavar=unit,
            type=float,
            help=f'with --check: largest error of the measured {name} of an axis that is not ours',
        )
    add_selection(parser)
    parser.add_argument(
        '--format',
        choices=('text', 'json', 'csv'),
        default='text',
        help='of the table on stdout (default: %(default)s)',
    )
    parser.add_argument(
        '--report',
        metavar='FILE.html',
        type=Path,
        help='write one page with plots to zoom in, which opens offline',
    )
    parser.add_argument(
        '--figure', metavar='FILE.pdf|.png', type=Path, help='write a figure for print'
    )
    options = parser.parse_args(arguments)
    require_check_options(options)
    if options.every and options.set_point_change is not None:
        raise UsageError('--set-point-change: must stand without --all')
    if options.set_point is not None and not isfinite(options.set_point):
        raise UsageError(f'--set-point {options.set_point}: must be finite')
    for name, suffixes, package in (
        ('report', ('.html',), 'plotly'),
        ('figure', ('.pdf', '.png'), 'matplotlib'),
    ):
        require_writable(name, getattr(options, name), suffixes, package)
    return options


def require_check_options(options: argparse.Namespace) -> None:
    """Raise `UsageError` for options that do not go with --check, or not without it."""
    errors = options.position_error, options.velocity_error
    if options.check and (
        options.every
        or options.report
        or options.figure
        or (options.set_point, options.set_point_change) != (None, None)
    ):
        raise UsageError(
            '--check: must stand without --all, --set-point, --set-point-change, --report and '
            '--figure'
        )
    if errors == (None, None):
        return
    if not options.check or None in errors:
        raise UsageError('--position-error, --velocity-error: must be given both, with --check')
    if not all(0.0 <= error < inf for error in errors):
        raise UsageError(f'--position-error, --velocity-error: {errors}: must be finite, >= 0')


def require_writable(
    name: str, path: Path | None, suffixes: tuple[str, ...], package: str
) -> None:
    """Raise `UsageError` where a file of that name cannot be, or its package is missing."""
    if path is None:
        return
    if path.suffix not in suffixes:
        raise UsageError(f'--{name} {path}: must end in {" or ".join(suffixes)}')
    if path.is_dir() or not path.parent.is_dir():
        raise UsageError(
            f'--{name} {path}: '
            + ('this is a folder' if path.is_dir() else 'its folder does not exist')
        )
    if find_spec(package) is None:
        raise UsageError(
            f"--{name} needs {package}: pip install 'impulse_control_ros[analysis]'"
            f', or pip install {package}'
        )


def runs_of(options: argparse.Namespace) -> Iterator[Run]:
    """
    Read the bags, and of each what is selected.

    Warns of what is not in them, and raises `UsageError` for what is none.
    """
    import numpy as np

    from impulse_control_ros.files.recording import read_bag
    from impulse_control_ros.tools.analyze.run import Run

    bags = options.bags
    if len(set(bags)) < len(bags):
        raise UsageError(f'{Counter(bags).most_common(1)[0][0]} is given twice')
    names = Counter(bag.resolve().name for bag in bags)
    for bag in bags:
        recording = with_positions(bag, read_bag(bag, **selection(options)))
        short = bag.resolve().name
        run = Run(
            name=printable(short if names[short] == 1 else str(bag)),
            path=bag,
            recording=recording,
            x_r=options.set_point,
        )
        if recording.unread is not None:
            warn_of_cut(run)
        if len(recording.states) < 2 or not np.ptp(recording.states['stamp']):
            raise UsageError(
                f'{bag}: there are {len(recording.states)} states in it; 2 with '
                'different stamps are needed'
            )
        missing = int(recording.recording_summary.get('missing', 0))
        if recording.lacks:
            warn(NAME, f'{bag}: incomplete: {"; ".join(recording.lacks)}')
        elif missing:
            warn(
                NAME,
                f'{bag}: the recorder counted {missing} missing messages; impulses may be among '
                'them',
            )
        if run.x_r is None and not recording.settings:
            warn(NAME, f'{bag}: no node tells its set-point x_r: 0 m is taken')
        shown = 1 if options.every else options.set_point_change or len(run.responses)
        if recording.begins_in_mid_run and shown == 1 and not options.check:
            warn(
                NAME,
                f'{bag}: settling times count from the first state, although the run began before'
                + '; --set-point-change selects another response' * (len(run.responses) > 1),
            )
        yield run


def printable(name: str) -> str:
    """Return a file name as it is shown: it may be no UTF-8, which no font has."""
    return os.fsencode(name).decode(errors='replace')


def with_positions(bag: Path, recording: Recording) -> Recording:
    """Return a recording without the states that no controller answers; warns of them."""
    import numpy as np

    states, bound = recording.states, DivergedError.bound
    good = (np.abs(states['position']) < bound) & ~(np.abs(states['velocity']) >= bound)
    if good.all():
        return recording
    warn(
        NAME,
        f'{bag}: {np.count_nonzero(~good)} states are left out: their position is not finite, or '
        f'position or velocity is beyond {bound:g}',
    )
    return replace(recording, states=states[good])


def warn_of_cut(run: Run) -> None:
    """Say how much of a bag was read."""
    count = len(run.states)
    seconds = f' ({run.time[-1]:g} s)' if count else ''
    warn(
        NAME,
        f'{run.path} was cut off: {count} samples{seconds} are read, up to the last whole '
        f'chunk; {run.recording.unread} bytes behind it cannot be',
    )


def main(_: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Print the table and write the files that are asked for; returns the exit status."""
    options = parsed(arguments)
    if options.check:
        return check(options)
    from impulse_control_ros.tools.analyze.table import FORMATS, Response, responses_of

    runs: list[Run] = []
    responses: list[Response] = []
    for run in runs_of(options):
        responses += responses_of(run, options.every, options.set_point_change)
        if options.report or options.figure:
            runs.append(run)
    print(FORMATS[options.format](responses), flush=True)
    if options.report:
        from impulse_control_ros.tools.analyze.report import report

        write(options.report, report(runs, responses).encode())
    if options.figure:
        from impulse_control_ros.tools.analyze.drawing import figure

        write(options.figure, figure(runs, options.figure.suffix[1:]))
    return 0


def check(options: argparse.Namespace) -> int:
    """Print the checks of the runs; returns the exit status."""
    from impulse_control_ros.core.check_motion import Errors
    from impulse_control_ros.tools.analyze.check import checked, FORMATS

    errors = options.position_error, options.velocity_error
    every = [checked(run, None if None in errors else Errors(*errors)) for run in runs_of(options)]
    print(FORMATS[options.format](every), flush=True)
    gaps = [f'{one.run.path}: {one.gap}' for one in every if one.gap]
    for gap in gaps:
        warn(NAME, gap)
    if any(one.violations for run in every for one in run.checks):
        return 1
    return 2 if gaps else 0


def write(path: Path, content: bytes) -> None:
    """Write a file as a whole, and say so beside the result."""
    with replaced(path) as made:
        made.write_bytes(content)
    print(f'{NAME}: wrote {path}', file=sys.stderr)
