"""
Run scripts/studies/robustness_*.yaml, and write their results into docs/concepts/robustness.md.

``python -m scripts.robustness docs`` runs each study as ``sweep`` does, into the same folder:
finished runs are not repeated.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
import sys

from matplotlib import rc_context
import numpy as np

from impulse_control_ros.command_line import exit_status, Parser, StopRequest
from impulse_control_ros.core.sweep_config import SweepConfig, units
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.atomic_write import replaced
from impulse_control_ros.files.sweep_config_file import identity, read_study
from impulse_control_ros.files.sweep_folder import SweepFolder
from impulse_control_ros.tools.figures import DOCS_DPI, save, STYLE
from impulse_control_ros.tools.sweep import finish
from impulse_control_ros.tools.sweep_summary import Column
from impulse_control_ros.tools.sweep_workers import local_workers
from scripts.robustness.comparison import compared
from scripts.robustness.document import block, renewed
from scripts.robustness.drawing import picture

TUNING = 'robustness_tuning'
PAGE, PICTURES = Path('concepts', 'robustness.md'), 'images'  # in the docs folder


def main(stop: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = Parser(prog='robustness', description=__doc__)
    parser.add_argument(
        'docs', type=Path, help='the folder with concepts/robustness.md and images/'
    )
    parser.add_argument(
        '--studies',
        metavar='FOLDER',
        type=Path,
        default=Path('scripts', 'studies'),
        help='where robustness_*.yaml are (default: %(default)s)',
    )
    add_runs(parser)
    options = parser.parse_args(arguments)
    renew(options.docs, options.studies, options.runs, stop)
    return 0


def add_runs(parser: Parser) -> None:
    """Add the option for the folder of the results of studies."""
    parser.add_argument(
        '--runs',
        metavar='FOLDER',
        type=Path,
        default=Path('runs'),
        help='where the results are, or come (default: %(default)s)',
    )


def renew(docs: Path, studies: Path, runs: Path, stop: StopRequest) -> None:
    """Run what is left of the studies, and write the page and its pictures."""
    path = docs / PAGE
    if not path.is_file():
        raise ParameterError(f'{docs}: must be a folder with {PAGE}')
    page = path.read_text()
    for file in sorted(studies.glob('robustness_*.yaml')):
        name, study = file.stem, read_study(file)
        column = ran(study, runs / name, stop)
        if name == TUNING:
            lines = tuned(study, column)
        else:
            comparison = compared(study, column)
            lines = block(name, comparison)
            with rc_context(STYLE):
                save(
                    picture(comparison, study.extent.duration),
                    docs / PICTURES / f'{name}.png',
                    DOCS_DPI,
                )
        page = renewed(page, name, lines)
    with replaced(path) as made:
        made.write_text(page)


def ran(study: SweepConfig, path: Path, stop: StopRequest) -> Column:
    """Run what is left of a study, and return the columns of its result."""
    folder = SweepFolder(path, identity(study), units(study))
    if not folder.is_concluded():
        with local_workers() as workers, folder.held():
            finish(study, folder, workers, stop)
    return folder.column


def mean_iae(study: SweepConfig, column: Column) -> np.ndarray:
    """Return the mean IAE [m s] over all runs with a K_i, for each."""
    gains = column('K_i')
    return np.array([column('iae')[gains == gain].mean() for gain in study.axes['K_i']])


def tuned(study: SweepConfig, column: Column) -> list[str]:
    """Return the table of the tuning."""
    means = mean_iae(study, column)
    best = study.axes['K_i'][int(np.argmin(means))]
    return [
        '| K_i [N/(m s)] | ' + ' | '.join(f'{gain:g}' for gain in study.axes['K_i']) + ' |',
        '|---' * (len(means) + 1) + '|',
        '| mean IAE [m s] | ' + ' | '.join(f'{mean:.4f}' for mean in means) + ' |',
        '',
        f'The least is at K_i = {best:g} N/(m s).',
    ]


if __name__ == '__main__':
    sys.exit(exit_status('robustness', partial(main, StopRequest(patience=1))))
