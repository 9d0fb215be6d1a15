"""
Run scripts/studies/supervision.yaml with three seeds, and print the table of its laws.

``python -m scripts.supervised_axes`` also prints the supervised runs that settle last or overshoot
most. Overshoot is the largest error of the opposite sign over x_0. Impulses at rest are those of
the last two seconds: a run of four seconds is the beginning of one of six.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
import sys

import numpy as np

from impulse_control_ros.command_line import exit_status, Parser, StopRequest
from impulse_control_ros.core.metric_catalogue import settling
from impulse_control_ros.files.sweep_config_file import read_study
from impulse_control_ros.tools.sweep_summary import quantiles, shown
from scripts.robustness.__main__ import add_runs, ran

STUDY = Path('scripts', 'studies', 'supervision.yaml')
SEEDS = (1, 2, 3)
# where each law is along controller.impulses, supervision and learn_mass, as one
LAWS = {'PD': 0, 'impulses': 4, 'supervised, mass not learnt': 6, 'supervised': 7}
LAST = 2.0  # s, at rest
SHOWN = 10
DRAWN = ('plant_simulator.m', 'damping.value', 'F_c', 'x_0', 'actuator.delay')
FIGURES = ('settling', 'overshoot', 'at rest', 'diverged')


def main(stop: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = Parser(prog='supervised_axes', description=__doc__)
    add_runs(parser)
    runs = parser.parse_args(arguments).runs
    of_seeds = [results(runs, seed, stop) for seed in SEEDS]
    print('\n'.join(table(of_seeds)))
    for seed, one in zip(SEEDS, of_seeds, strict=True):
        print('\n'.join(['', f'seed {seed}', *worst(one)]))
    return 0


def results(runs: Path, seed: int, stop: StopRequest) -> dict[str, np.ndarray]:
    """Return figures and draws of the runs of a ``seed``, each of shape (8, runs)."""
    study = read_study(STUDY)
    extent = replace(study.extent, seed=seed)
    early = replace(extent, duration=extent.duration - LAST)
    column, before = (
        ran(replace(study, extent=one), runs / f'supervision_{seed}_{one.duration:g}s', stop)
        for one in (extent, early)
    )
    drawn = {name: column(name) for name in (*DRAWN, 'sensor.velocity_noise')}
    figures = {
        'settling': column(settling(study.tolerances[0])),
        'overshoot': shown(column, 'overshoot') / drawn['x_0'],
        'at rest': (column('impulses') - before('impulses')) / LAST,
        'diverged': ~(shown(column, 'final_error') < 100.0),
    }
    return {name: values.reshape(8, -1) for name, values in (figures | drawn).items()}


def table(of_seeds: Sequence[dict[str, np.ndarray]]) -> list[str]:
    """Return a table of the laws; a range is that of the seeds."""
    heads = (
        *('law', 'never within 1 cm', 'median settling time [s]'),
        *('overshoot / x_0: 95 %', 'worst', 'impulses/s at rest', 'diverge'),
    )
    lines = ['| ' + ' | '.join(heads) + ' |', '|---' * len(heads) + '|']
    for law, place in LAWS.items():
        rows = np.array(
            [row(*(one[name][place] for name in FIGURES)) for one in of_seeds], dtype=float
        )
        cells = [span(values) for values in rows.T]
        lines.append(f'| {law} | ' + ' | '.join(cells) + ' |')
    return lines


def row(
    settled: np.ndarray, overshoot: np.ndarray, at_rest: np.ndarray, diverged: np.ndarray
) -> list[float]:
    """Return the cells of a law and a seed."""
    tail, most = quantiles(overshoot, (0.95, 1.0))
    return [
        100.0 * np.isnan(settled).mean(),
        quantiles(settled, (0.5,))[0],
        tail,
        most,
        np.mean(at_rest[~diverged]),
        diverged.sum(),
    ]


def span(values: np.ndarray) -> str:
    """Return the range of some values in words, nan as ``inf``."""
    low, high = (f'{value:.3g}' for value in (values.min(), values.max()))
    return low if low == high else f'{low} to {high}'


def worst(one: dict[str, np.ndarray]) -> list[str]:
    """Return a line for each of the supervised runs that settle last or overshoot most."""
    ours = {name: values[LAWS['supervised']] for name, values in one.items()}
    late = np.where(np.isnan(ours['settling']), np.inf, ours['settling'])
    places = [*np.argsort(-late)[:SHOWN], *np.argsort(-ours['overshoot'])[:SHOWN]]
    return [
        f'{i:4d}: '
        + ', '.join(f'{name} {ours[name][i]:.3g}' for name in ours if name != 'diverged')
        for i in places
    ]


if __name__ == '__main__':
    sys.exit(exit_status('supervised_axes', partial(main, StopRequest(patience=1))))
