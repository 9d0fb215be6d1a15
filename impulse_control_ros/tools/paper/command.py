"""
``paper_figures``: Figs. 1 to 5 of the paper and its claims, from our own runs.

What takes time to import is imported on use, so that --help answers at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from impulse_control_ros.command_line import Parser, StopRequest
from impulse_control_ros.errors import UsageError
from impulse_control_ros.files.atomic_write import replaced

if TYPE_CHECKING:
    from impulse_control_ros.tools.paper.claim import Claim
    from impulse_control_ros.tools.paper.runs import Runs

NAME = 'paper_figures'
PAGE, PICTURES = Path('concepts', 'paper.md'), 'images'  # in the folder of --docs


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Return the options."""
    parser = Parser(
        prog=NAME,
        description='Draw Figs. 1 to 5 of the paper from our own runs, '
        'as PNG and PDF, and print what becomes of its claims.',
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        '--out',
        metavar='FOLDER',
        type=Path,
        default=Path('figures'),
        help='folder for the figures (default: %(default)s)',
    )
    where.add_argument(
        '--docs',
        metavar='FOLDER',
        type=Path,
        help='instead, update concepts/paper.md and its pictures in FOLDER',
    )
    return parser.parse_args(arguments)


def made(folder: Path) -> Path:
    """Make the folder, with those above it, and return it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'--out {folder}: {error.strerror}') from None
    return folder


def write_figures(folder: Path, runs: Runs, claims: Sequence[Claim], docs: bool = False) -> None:
    """Write every figure: as PNG and PDF with its caption, or for the ``docs`` as PNG alone."""
    from matplotlib import rc_context

    from impulse_control_ros.tools.figures import DOCS_DPI, PRINT_DPI, save, STYLE
    from impulse_control_ros.tools.paper.document import caption
    from impulse_control_ros.tools.paper.drawing import draw, DRAWN

    suffixes, dpi = (('png',), DOCS_DPI) if docs else (('png', 'pdf'), PRINT_DPI)
    with rc_context(STYLE):
        for figure in DRAWN:
            drawn = draw(figure, runs, '' if docs else caption(figure, claims))
            for suffix in suffixes:
                save(drawn, folder / f'fig{figure}.{suffix}', dpi)


def write_docs(folder: Path, runs: Runs, claims: Sequence[Claim]) -> None:
    """Update concepts/paper.md and its pictures, whose captions it has."""
    from impulse_control_ros.tools.paper.document import renewed

    page = folder / PAGE
    with replaced(page) as path:
        path.write_text(renewed(page.read_text(), claims))
    write_figures(folder / PICTURES, runs, claims, docs=True)


def main(_: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Print the claims and draw the figures; returns the exit status."""
    options = parsed(arguments)
    if find_spec('matplotlib') is None:
        raise UsageError("matplotlib is missing: pip install 'impulse_control_ros[analysis]'")
    if options.docs is not None and not (options.docs / PAGE).is_file():
        raise UsageError(f'--docs {options.docs}: there is no {PAGE} to update')
    folder = options.docs or made(options.out)
    from impulse_control_ros.tools.paper.claims import all_claims
    from impulse_control_ros.tools.paper.document import plain
    from impulse_control_ros.tools.paper.runs import paper_runs

    runs = paper_runs()
    claims = all_claims(runs)
    print(plain(claims))
    try:
        (write_docs if options.docs else write_figures)(folder, runs, claims)
    except OSError as error:
        raise UsageError(f'{error.filename2 or error.filename}: {error.strerror}') from None
    print(f'\nFigures 1 to 5 are in {folder}')
    return 0
