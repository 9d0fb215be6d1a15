"""Command lines that are refused in one line."""

import argparse


class UsageError(Exception):
    """What cannot be done, in one line."""


class Parser(argparse.ArgumentParser):
    """A parser that refuses in one line."""

    def error(self, message: str) -> None:  # type: ignore[override]
        """Raise `UsageError`."""
        raise UsageError(f'{message} (see --help)')
