"""Atomic writes: a file is either complete or absent."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path


def flush(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """
    Yield a temporary file beside ``path`` that replaces ``path`` at the end.

    Any `OSError` raised meanwhile names ``path``.
    """
    made = path.with_name(f'.{path.name}.new')
    try:
        yield made
        flush(made)
        os.replace(made, path)
        flush(path.parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None
    finally:
        made.unlink(missing_ok=True)
