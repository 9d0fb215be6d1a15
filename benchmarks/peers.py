"""
Measure the paper's Fig. 2 and Fig. 5 with this package and with what a user would pick instead.

    python benchmarks/peers.py [--json] [--only NAME...] [--case fig2|fig5] [--seconds S]
                               [--rounds N] [--budget S]

Each contestant (contestants/NAME.py) runs in a process of its own, built, compiled and warm; the
rounds of all are interleaved, each timed inside its process. Figures are medians of the rounds.
The error is the largest in x at the contestant's own times against the exact solution of the
reading of the jumps that it solves. A peer that is missing or fails is a row that says why.
"""

import argparse
import ast
from importlib import import_module, metadata
import io
import json
import os
from pathlib import Path
import platform
import re
from statistics import median
import subprocess
import sys
import tempfile
import time
import tokenize

FOLDER = Path(__file__).parent / 'contestants'
EXACT = ('ours_events', 'ours_solve', 'ours_strict')  # the reference, so without an error
SINGLE, BATCH = (*EXACT, 'ours_simulate'), ('ours_batch',)
NAMES = (
    *SINGLE,
    'python_loop',
    'scipy_events',
    'drake',
    'pathsim',
    'jax_scan',
    'diffrax',
    'jaxonomy',
    *BATCH,
    'numpy_batch',
)
SHORTEST = 0.02  # s; a round repeats a run until it takes so long, for the clock's sake
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def code_lines(source: str) -> int:
    """Count the lines that hold code: no blank ones, comments or docstrings."""
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type not in LAYOUT
        for line in range(token.start[0], token.end[0] + 1)
    }
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines -= set(range(node.lineno, node.end_lineno + 1))
    return len(lines)


def largest_error(case, reading: str, times, positions) -> float:
    """Return the largest error [m] against the exact solution."""
    import numpy as np

    exact, _ = case.exact(reading).at(np.clip(np.asarray(times, float), 0.0, case.seconds))
    return float(np.max(np.abs(np.asarray(positions, float) - exact)))


def timed(run, repeats: int = 1) -> tuple[float, object]:
    """Return the wall time [s] of a run, and what the last one returned."""
    began = time.perf_counter()
    for _ in range(repeats):
        made = run()
    return (time.perf_counter() - began) / repeats, made


def run_child(name: str, figure: str, seconds: float) -> None:
    """Be a contestant: say what it is, then time a round for each line that comes in."""
    answers, sys.stdout = sys.stdout, sys.stderr  # peers print
    from cases import read_case

    contestant, case = import_module(f'contestants.{name}'), read_case(figure, seconds)
    run = contestant.prepare(case)
    wall, made = timed(run)
    if contestant.KIND != 'interpreted' or wall < 1.0:
        wall, made = timed(run)  # the first run has compiled and filled the caches
    print(
        json.dumps(
            {
                'kind': contestant.KIND,
                'reading': contestant.READING,
                'points': len(made[0]),
                'error': None if name in EXACT else largest_error(case, contestant.READING, *made),
            }
        ),
        file=answers,
        flush=True,
    )
    repeats = max(1, int(SHORTEST / wall))
    for _ in sys.stdin:
        wall, _ = timed(run, repeats)
        print(json.dumps(wall / getattr(contestant, 'RUNS', 1)), file=answers, flush=True)


class Contestant:
    """A contestant's process on one case, and what it has said."""

    def __init__(self, name: str, figure: str, seconds: float) -> None:
        source = (FOLDER / f'{name}.py').read_text()
        self.row: dict[str, object] = {'lines': code_lines(source)}
        self.walls: list[float] = []
        self.spent, self.seconds, self._child = 0.0, seconds, None
        missing = [package for package, version in versions(source).items() if not version]
        if missing:
            self.row['failure'] = f"not installed: {missing[0]} (pip install '.[bench]')"
            return
        self._errors = tempfile.TemporaryFile('w+')  # noqa: SIM115 (read when the child fails)
        self._child = subprocess.Popen(
            [
                sys.executable,
                __file__,
                '--child',
                name,
                '--case',
                figure,
                '--seconds',
                str(seconds),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
        )
        said = self._answer()
        self.row |= said or {}

    def _answer(self) -> object:
        """Return what the child says next; when it has ended, keep its last words."""
        line = self._child.stdout.readline()
        if line:
            return json.loads(line)
        self._child.wait()
        self._errors.seek(0)
        said = re.findall(r'^[\w.]*(?:Error|Exception)\b.*', self._errors.read(), re.MULTILINE)
        self.row['failure'] = f'failed: {said[-1] if said else self._child.returncode}'
        return None

    def measure(self, budget: float) -> None:
        """Do a round, unless the rounds so far have taken ``budget`` seconds."""
        if 'failure' in self.row or self.spent > budget:
            return
        began = time.perf_counter()
        self._child.stdin.write('\n')
        self._child.stdin.flush()
        wall = self._answer()
        self.spent += time.perf_counter() - began
        if wall is not None:
            self.walls.append(wall / self.seconds)

    def finish(self) -> dict[str, object]:
        """End the child and return the row of the table."""
        if self._child:
            self._child.communicate()
            self._errors.close()
        if self.walls:
            self.row |= {
                'wall': median(self.walls),
                'least': min(self.walls),
                'most': max(self.walls),
                'rounds': len(self.walls),
            }
        return self.row


def measured(names: list[str], figure: str, options: argparse.Namespace) -> dict[str, dict]:
    """Measure one case; return the rows by the names of the contestants."""
    contestants = {name: Contestant(name, figure, options.seconds) for name in names}
    for _ in range(options.rounds):
        for contestant in contestants.values():
            contestant.measure(options.budget)
    walls = {name: contestant.walls for name, contestant in contestants.items()}
    rows = {name: contestant.finish() for name, contestant in contestants.items()}
    for name, row in rows.items():
        row['ratios'] = {
            ours: ratio(walls[name], walls[ours])
            for ours in (*SINGLE, *BATCH)
            if walls[name] and walls.get(ours)
        }
    return rows


def ratio(walls: list[float], ours: list[float]) -> float:
    """Return the median of the rounds' ratios: what else runs slows both; a budget ends one."""
    return median(wall / own for wall, own in zip(walls, ours, strict=False))


def versions(source: str) -> dict[str, str | None]:
    """Return the versions of the packages that a contestant names, None for a missing one."""
    named = next(
        ast.literal_eval(node.value)
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign) and node.targets[0].id == 'PACKAGES'
    )
    found: dict[str, str | None] = {}
    for name in named:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = None
    return found


def processor() -> str:
    """Return the name of the CPU."""
    names = [
        line.split(':')[1].strip()
        for line in Path('/proc/cpuinfo').read_text().splitlines()
        if line.startswith('model name')
    ]
    return names[0] if names else platform.machine()


def verdicts(rows: dict[str, dict]) -> dict[str, float]:
    """
    Return how many times longer the fastest peer of each kind takes than ours.

    Like with like: the same reading, and no larger error of ours.
    """
    found = {}
    for kind in ('interpreted', 'compiled', 'batch'):
        for ours in BATCH if kind == 'batch' else SINGLE:
            own = rows.get(ours, {})
            ratios = {
                name: row['ratios'][ours]
                for name, row in rows.items()
                if row.get('kind') == kind
                and name not in BATCH
                and ours in row['ratios']
                and row['reading'] == own['reading']
                and (own['error'] or 0.0) <= 1.001 * row['error']
            }
            if ratios:
                name = min(ratios, key=ratios.get)
                found[f'{name} / {ours}'] = ratios[name]
    return found


def show(figure: str, rows: dict[str, dict]) -> None:
    """Print the table of a case."""
    print(
        f'{figure:<14}{"reading":>9}{"wall [s/s]":>11}{"least":>9}{"most":>9}{"rounds":>7}'
        f'{"error [m]":>10}{"points":>8}{"lines":>6}'
        + ''.join(f'{"x " + ours.removeprefix("ours_"):>11}' for ours in SINGLE)
    )
    for name, row in rows.items():
        if 'failure' in row:
            print(f'{name:<14}{row["failure"]}')
            continue
        error = 'exact' if row['error'] is None else f'{row["error"]:.1e}'
        print(
            f'{name:<14}{row["reading"]:>9}{row["wall"]:>11.1e}{row["least"]:>9.1e}'
            f'{row["most"]:>9.1e}{row["rounds"]:>7}{error:>10}{row["points"]:>8}'
            f'{row["lines"]:>6}'
            + ''.join(
                f'{row["ratios"][ours]:>11.3g}' if ours in row['ratios'] else ' ' * 11
                for ours in SINGLE
            )
        )
    print(*(f'{pair}: {ratio:.3g}' for pair, ratio in verdicts(rows).items()), sep='\n')


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--only', nargs='+', choices=NAMES, default=NAMES, metavar='NAME')
    parser.add_argument('--case', choices=('fig2', 'fig5'))
    parser.add_argument('--seconds', type=float, default=2.0, help='simulated time of a run')
    parser.add_argument('--rounds', type=int, default=7)
    parser.add_argument('--budget', type=float, default=30.0, help='[s] per contestant and case')
    parser.add_argument('--child', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        run_child(options.child, options.case, options.seconds)
        return
    figures = [options.case] if options.case else ['fig2', 'fig5']
    results = {figure: measured(options.only, figure, options) for figure in figures}
    if not options.json:
        for figure, rows in results.items():
            show(figure, rows)
        return
    found = {}
    for name in options.only:
        found |= versions((FOLDER / f'{name}.py').read_text())
    print(
        json.dumps(
            {
                'cases': results,
                'ratios': {figure: verdicts(rows) for figure, rows in results.items()},
                'versions': found,
                'python': platform.python_version(),
                'cpu': processor(),
                'cores': os.cpu_count(),
                'seconds': options.seconds,
            },
            indent=2,
        )
    )


if __name__ == '__main__':
    main()
