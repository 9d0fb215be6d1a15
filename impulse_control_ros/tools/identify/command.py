"""
``identify``: the parameters of an axis from records of its motion, and an experiment with it.

What takes time to import is imported on use, so that --help answers at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
import math
from pathlib import Path
import sys
from typing import TYPE_CHECKING

from impulse_control_ros.command_line import add_selection, Parser, selection, StopRequest, warn
from impulse_control_ros.errors import UsageError
from impulse_control_ros.files.atomic_write import replaced
from impulse_control_ros.tools.analyze.command import require_writable

if TYPE_CHECKING:
    from impulse_control_ros.core.identification import Identification, Record
    from impulse_control_ros.tools.identify.gains import Requirement

NAME = 'identify'
EPILOG = """\
The model is m x'' + d x' + F_c sign(x') + offset = u. A record is a bag (a rosbag2 folder or a
file in it), or a table in a CSV or Parquet file. The effort of a bag is that of joint_commands,
or, without them, that of joint_states. An estimate has a 95 % interval; its share is the part of
the effort that only this parameter explains. 'not excited' means that the records do not determine
it. Warnings and the names of written files go to stderr.

Exit status 1: m or d_bar could not be identified; the last lines say which motion would do it."""


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options, or raise `UsageError`."""
    parser = Parser(
        prog=NAME,
        description='Identify mass, damping and friction of an axis from records of its motion.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'records', metavar='RECORD', nargs='+', type=Path, help='a bag, or a .csv or .parquet file'
    )
    parser.add_argument(
        '--format',
        choices=('text', 'json'),
        default='text',
        help='of the result on stdout (default: %(default)s)',
    )
    parser.add_argument(
        '--report',
        metavar='FILE.html',
        type=Path,
        help='write one page with plots, which opens offline',
    )
    add_reading(parser)
    add_requirement(parser)
    add_selection(parser)
    options = parser.parse_args(arguments)
    require_options(options)
    return options


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the options that describe the records."""
    group = parser.add_argument_group('records')
    group.add_argument(
        '--columns',
        metavar='time=T,position=X,effort=U[,velocity=V]',
        type=columns_of,
        help='columns of a table (default: those of these names)',
    )
    group.add_argument(
        '--effort-scale',
        metavar='N',
        type=float,
        default=1.0,
        help='newtons per unit of the effort, e.g. of a current (default: %(default)g)',
    )
    group.add_argument(
        '--effort-held',
        choices=('after', 'before', 'sampled'),
        help='whether an effort acts over the sample after its time or the one before it, or is a '
        'sample of a continuous signal (default: as the motion shows)',
    )
    group.add_argument(
        '--no-offset',
        action='store_true',
        help='the axis has no constant force, such as gravity: motion in one direction then '
        'determines F_c',
    )
    for name, what in (('from', 'begin'), ('to', 'end')):
        group.add_argument(
            f'--{name}',
            metavar='S',
            type=float,
            dest=what,
            default=0.0 if name == 'from' else math.inf,
            help=f'{what} of the part to use, in seconds from the first sample',
        )


def add_requirement(parser: argparse.ArgumentParser) -> None:
    """Add the options that ask for an experiment."""
    group = parser.add_argument_group('experiment')
    group.add_argument(
        '--write',
        metavar='FILE.yaml',
        type=Path,
        help='write an experiment: the identified axis, and a controller for it',
    )
    group.add_argument(
        '--travel',
        metavar='M',
        type=float,
        help='the step of the set-point that the requirement is for',
    )
    what = group.add_mutually_exclusive_group()
    what.add_argument('--settling-time', metavar='S', type=float, help='settle within this time')
    what.add_argument('--stiffness', metavar='N/M', type=float, help='the gain K')
    group.add_argument(
        '--effort-limit', metavar='N', type=float, help='largest effort of the drive'
    )


def columns_of(text: str) -> dict[str, str]:
    """Parse NAME=COLUMN,...; raises `ArgumentTypeError`."""
    pairs = [item.partition('=') for item in text.split(',')]
    columns = {name: column for name, _, column in pairs}
    known = ('time', 'position', 'effort', 'velocity')
    if not all(column for *_, column in pairs) or not {*columns} <= {*known}:
        raise argparse.ArgumentTypeError(
            f'{text!r}: must be time=COLUMN,position=COLUMN,effort=COLUMN[,velocity=COLUMN]'
        )
    if missing := [name for name in known[:3] if name not in columns]:
        raise argparse.ArgumentTypeError(f'{text!r}: no column for {", ".join(missing)}')
    return columns


def require_options(options: argparse.Namespace) -> None:
    """Raise `UsageError` for options that contradict each other, or values out of bounds."""
    if len(set(options.records)) < len(options.records):
        raise UsageError('a record is given twice')
    if not (math.isfinite(options.effort_scale) and options.effort_scale):
        raise UsageError(f'--effort-scale {options.effort_scale:g}: must be finite and not 0')
    if not 0.0 <= options.begin < options.end:
        raise UsageError(
            f'--from {options.begin:g}, --to {options.end:g}: must be 0 <= from < to [s]'
        )
    values = {
        name: getattr(options, name.replace('-', '_'))
        for name in ('travel', 'settling-time', 'stiffness', 'effort-limit')
    }
    for name, value in values.items():
        if value is not None and not 0.0 < value < math.inf:
            raise UsageError(f'--{name} {value:g}: must be > 0 and finite')
    require_writable('report', options.report, ('.html',), 'plotly')
    path = options.write
    if path is None:
        if given := [name for name, value in values.items() if value is not None]:
            raise UsageError(f'--{given[0]}: must stand with --write')
        return
    if options.travel is None or (options.settling_time is None and options.stiffness is None):
        raise UsageError('--write: needs --travel, and --settling-time or --stiffness')
    require_writable('write', path, ('.yaml', '.yml'), 'yaml')


def main(_: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Print the identified parameters and write the requested files; returns the exit status."""
    options = parsed(arguments)
    from impulse_control_ros.core.identify import identify
    from impulse_control_ros.tools.identify.table import FORMATS

    show = FORMATS[options.format]
    records = records_of(options)
    fit = partial(identify, effort_held=options.effort_held, has_offset=not options.no_offset)
    found = fit(records)
    for text in found.warnings:
        warn(NAME, text)
    if options.report:
        write_report(options.report, found, records, fit)
    if not found.is_identified or not options.write:
        print(show(found, None), flush=True)
        for text in () if found.is_identified else found.advice:
            print(f'{NAME}: {text}', file=sys.stderr)
        return 0 if found.is_identified else 1
    from impulse_control_ros.tools.identify.experiment import experiment_for, text_of

    try:
        experiment = experiment_for(found, records, requirement_of(options))
    except UsageError:
        print(show(found, None), flush=True)
        raise
    for finding in experiment.findings:
        warn(NAME, finding.text)
    print(show(found, experiment), flush=True)
    with replaced(options.write) as made:
        made.write_text(text_of(experiment, found, options.records), encoding='utf-8')
    print(f'{NAME}: wrote {options.write}', file=sys.stderr)
    return 0


def write_report(
    path: Path,
    found: Identification,
    records: list[Record],
    fit: Callable[[Sequence[Record]], Identification],
) -> None:
    """Write the page."""
    from impulse_control_ros.tools.identify.report import report
    from impulse_control_ros.tools.identify.validation import validated

    content = report(found, records, validated(records, found, fit))
    with replaced(path) as made:
        made.write_text(content, encoding='utf-8')
    print(f'{NAME}: wrote {path}', file=sys.stderr)


def records_of(options: argparse.Namespace) -> list[Record]:
    """Read the records, and print the notes on them."""
    from impulse_control_ros.files.record_files import read_record, Reading

    reading = Reading(
        columns=options.columns,
        selection=selection(options),
        as_is=options.effort_held is not None,
        effort_scale=options.effort_scale,
        begin=options.begin,
        end=options.end,
    )
    records = []
    for path in options.records:
        record, notes = read_record(path, reading)
        for note in notes:
            warn(NAME, f'{path}: {note}')
        records.append(record)
    return records


def requirement_of(options: argparse.Namespace) -> Requirement:
    """Return the requirement for the controller."""
    from impulse_control_ros.tools.identify.gains import Requirement

    return Requirement(
        travel=options.travel,
        settling_time=options.settling_time,
        stiffness=options.stiffness,
        effort_limit=options.effort_limit or 0.0,
    )
