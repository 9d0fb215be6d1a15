"""Files that are either whole or not there."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path


def flush(path: Path) -> None:
    """Bring a file or the names in a folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """
    Yield a file beside ``path``, which becomes ``path`` at the end.

    An `OSError` that occurs meanwhile names ``path``.
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
