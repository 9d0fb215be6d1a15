"""``export_bag``: a bag as one table, for pandas, a spreadsheet or what reads Parquet."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from impulse_control_ros.command_line import add_selection, Parser, selection, StopRequest, warn
from impulse_control_ros.errors import BagError, MissingPackageError, UsageError

EPILOG = """\
The table has a row for each sample: time, stamp_ns, position, velocity, effort (applied), command,
impulse_area, guard, damping, is_reset (a run or an episode starts here). Units and meaning are in
docs/reference/commands.md. A Parquet file also has the parameters, which pandas shows as
DataFrame.attrs. An existing file is replaced."""
SUFFIXES = ('.parquet', '.csv')


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = Parser(
        prog='export_bag',
        description='Write a bag as one table.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'bag', metavar='BAG', type=Path, help='a rosbag2 folder, or one of its files'
    )
    parser.add_argument(
        'file', metavar='FILE.parquet|FILE.csv', type=Path, help='the ending says which'
    )
    add_selection(parser)
    return parser.parse_args(arguments)


def main(_: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Write the table; returns the exit status."""
    options = parse(arguments)
    bag, file = options.bag, options.file
    if file.suffix not in SUFFIXES:
        raise UsageError(f'{file}: must end in {" or ".join(SUFFIXES)}')
    if file.is_dir() or not file.parent.is_dir():
        raise UsageError(f'{file}: must be a file in a folder that exists')
    try:
        import pyarrow  # noqa: F401 (it may be missing)

        from impulse_control_ros.files.export import to_csv, to_parquet
        from impulse_control_ros.files.recording import read_bag
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            f"{error.name} is missing: pip install 'impulse_control_ros[analysis]', or "
            'pip install pyarrow'
        ) from None
    run = read_bag(bag, **selection(options))
    if not len(run.states):
        raise BagError(f'bag {str(bag)!r} has no samples')
    rows = (to_csv if file.suffix == '.csv' else to_parquet)(run, file)
    if run.lacks:
        warn('export_bag', f'{bag}: incomplete: {"; ".join(run.lacks)}')
    if run.unread is not None:
        warn('export_bag', f'{bag} was cut off; {run.unread} bytes at its end cannot be read')
    print(f'export_bag: {file} has {rows} rows')
    return 0
