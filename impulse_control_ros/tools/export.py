"""``export_bag``: a bag as one table, for pandas, a spreadsheet or what reads Parquet."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
import sys

from impulse_control_ros.tools.arguments import ended, RUN_HELP

leave = partial(ended, 'export_bag')
EPILOG = """\
The table has a row for each sample: time, stamp_ns, position, velocity, effort (applied), command,
impulse_area, guard, damping, is_reset (a run starts, or is reset); docs/bags.md explains them. A
Parquet file has the parameters too, which pandas shows as DataFrame.attrs. A file of that name is
replaced."""
SUFFIXES = ('.parquet', '.csv')


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog='export_bag',
        description='Write a bag as one table.',
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='folder or .mcap file')
    parser.add_argument(
        'file', metavar='FILE.parquet|FILE.csv', type=Path, help='the ending says which'
    )
    parser.add_argument('--run', metavar='RUN', default='', help=RUN_HELP)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Be the whole of the executable; returns the exit status.

    0: done; 2: bad arguments or bag; 1: anything else; said in one line.
    """
    options = parse(arguments)
    bag, file = options.bag, options.file
    if file.suffix not in SUFFIXES:
        return leave(f'{file}: must end in {" or ".join(SUFFIXES)}', 2)
    if file.is_dir() or not file.parent.is_dir():
        return leave(f'{file}: must be a file in a folder that exists', 2)
    try:
        import pyarrow  # noqa: F401 (it may be missing)

        from impulse_control_ros.errors import BagError
        from impulse_control_ros.files.export import to_csv, to_parquet
        from impulse_control_ros.files.recording import read_bag
    except ModuleNotFoundError as error:
        return leave(
            f"{error.name} is missing: pip install 'impulse_control_ros[analysis]', or "
            'pip install pyarrow',
            1,
        )
    try:
        run = read_bag(bag, options.run)
        if not len(run.states):
            return leave(f'bag {str(bag)!r} has no samples', 2)
        rows = (to_csv if file.suffix == '.csv' else to_parquet)(run, file)
    except BagError as error:
        return leave(error, 2)
    except OSError as error:
        return leave(f'{file}: {error.strerror or error}', 1)
    if run.unread is not None:
        print(
            f'export_bag: warning: {bag} was cut off; {run.unread} bytes at its end cannot be '
            'read',
            file=sys.stderr,
        )
    print(f'export_bag: {file} has {rows} rows')
    return 0
