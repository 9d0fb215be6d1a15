"""Files that are either whole or not there."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a name beside ``path`` to write to, which becomes ``path`` at the end."""
    made = path.with_name(f'.{path.name}.new')
    try:
        yield made
        os.replace(made, path)
    finally:
        made.unlink(missing_ok=True)
