"""
Measure what an open dashboard costs a run.

    python benchmarks/dashboard.py [--json] [--rounds N] [--seconds N]

A composed run at full speed, recorded, and one in real time with and without the dashboard beside
it, its page open in headless Chromium. The cases are interleaved. Figures are medians of the
rounds: steps per second of wall time and of the run's own time on a core, both at full speed, and
samples that were late in real time. On a machine that is busy otherwise, only the second tells the
cost to the run: server and browser then take their share of the cores as any program does.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
import json
import os
from pathlib import Path
import re
from statistics import median
import sys
import tempfile
import time
import urllib.request

from lockstep import BIN, Child, node, STEPS_PER_SECOND, steps_per_second

sys.path.insert(0, str(Path(__file__).parent.parent))
from test.chromium import open_chromium  # noqa: E402

MISSED = re.compile(r'(\d+) missed deadlines')
PORT = 8091


@contextmanager
def dashboard(folder: Path) -> Iterator[None]:
    """Serve the page, and have it open in a browser."""
    address = f'http://127.0.0.1:{PORT}/'
    child = Child(BIN / 'dashboard', '--no-browser', '--port', PORT)
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    while True:
        try:
            opener.open(address).close()
            break
        except OSError:
            time.sleep(0.1)
    browser = open_chromium(folder / 'profile', with_logs=False)
    browser.get(address)
    try:
        yield
        if not browser.execute_script('return Number(document.body.dataset.time) > 1'):
            sys.exit('the page has not shown the run')
    finally:
        browser.quit()
        child.interrupt()


def run(with_page: bool, seconds: float, real_time_factor: float) -> tuple[float, float, int]:
    """Return the steps per second of wall and of core time, and the missed deadlines, of a run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with dashboard(folder) if with_page else nullcontext():
            child = node(
                'closed_loop',
                **{
                    'plant_simulator:duration': seconds,
                    'plant_simulator:real_time_factor': real_time_factor,
                    'recorder:bag': folder / 'bag',
                },
            )
            said = child.wait()
    steps = seconds * STEPS_PER_SECOND
    return steps_per_second(said), steps / child.core_time, int(MISSED.search(said)[1])


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--seconds', type=float, default=20.0, help='simulated time [s]')
    options = parser.parse_args()
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    found: dict[str, list[float]] = {}
    for _ in range(options.rounds):
        for page in (False, True):
            wall, core, _ = run(page, 2.0 * options.seconds, 0.0)
            *_, missed = run(page, options.seconds, 1.0)
            figures = {'steps_per_second': wall, 'steps_per_core_second': core, 'missed': missed}
            for name, value in figures.items():
                found.setdefault(f'{name}_{"open" if page else "without"}', []).append(value)
            print('open' if page else 'without', figures, file=sys.stderr)
    result = {name: median(values) for name, values in found.items()}
    for name in ('steps_per_second', 'steps_per_core_second'):
        result[f'{name}_ratio'] = result[f'{name}_open'] / result[f'{name}_without']
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        for name, value in result.items():
            print(f'{name:<32}{value:>12.5g}')


if __name__ == '__main__':
    main()
