"""Command lines that are refused, and left, in one line."""

import argparse
import sys

from impulse_control_ros.errors import UsageError

RUN_HELP = (
    'of a bag with several runs, the one with this id or, for a foreign plant, in this '
    'namespace; the longest one if not given'
)


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line."""

    def error(self, message: str) -> None:  # type: ignore[override]
        """Raise `UsageError`."""
        raise UsageError(f'{message} (see --help)')


def ended(name: str, why: object, status: int) -> int:
    """Say why the executable ``name`` ends; returns ``status``."""
    print(f'{name}: {why}', file=sys.stderr)
    return status
