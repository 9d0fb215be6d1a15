"""
Measure the lockstep against the floors of the middleware, in one run.

    python benchmarks/lockstep.py [--json] [--rounds N] [--seconds N] [--long N]

The floors exchange the same raw messages as the nodes and do no control work, see floors.py:
composed_floor publishes and takes on one thread; two_process_floor are two processes with reliable
readers, on the default transport and any core; best_effort_floor has the readers, the transport
and the placement of our nodes. Cases are interleaved; each figure is the median of the rounds, in
steps (state out, command back) per second of wall time. Peak RSS is the operating system's figure
for the process.
"""

import argparse
from collections.abc import Callable
from functools import partial
import json
import os
from pathlib import Path
import re
import signal
from statistics import median
import subprocess
import sys
import tempfile

BIN = Path(sys.executable).parent
CONFIG = Path(__file__).parent.parent / 'config' / 'underdamped.yaml'
FLOORS_SCRIPT = Path(__file__).with_name('floors.py')
PROCESSES, SIMULATE = 0.1, 3.0  # simulated time by that of the composed cases
STEPS_PER_SECOND = 10_000
CORES = sorted(os.sched_getaffinity(0))
PLACES = {'plant_simulator': CORES[0], 'controller': CORES[-1], 'recorder': -1}
RUN_OVER = re.compile(r'([\d.]+) s(?: simulated)? in ([\d.]+) s')
Measured = tuple[float, dict[str, float]]


class Child:
    """A process, its output, and once it has ended its peak RSS [MB] and time on a core [s]."""

    def __init__(self, *command: object) -> None:
        self._out = tempfile.TemporaryFile('w+')  # noqa: SIM115 (read once the child has ended)
        self._popen = subprocess.Popen(
            [str(word) for word in command],
            stdout=self._out,
            stderr=self._out,
            start_new_session=True,
        )
        self.peak = self.core_time = 0.0

    def wait(self) -> str:
        """Return what it said."""
        _, status, usage = os.wait4(self._popen.pid, 0)
        self._popen.returncode = os.waitstatus_to_exitcode(status)
        self.peak = usage.ru_maxrss / 1024
        self.core_time = usage.ru_utime + usage.ru_stime
        self._out.seek(0)
        said = self._out.read()
        if self._popen.returncode:
            sys.exit(f'{self._popen.args} failed:\n{said}')
        return said

    def interrupt(self) -> str:
        """End it with Ctrl-C."""
        self._popen.send_signal(signal.SIGINT)
        return self.wait()


def steps_per_second(said: str) -> float:
    """Return the rate from the last words of a run."""
    simulated, wall = map(float, RUN_OVER.search(said).groups())
    return simulated * STEPS_PER_SECOND / wall


def node(name: str, *options: str, **parameters: object) -> Child:
    """Start one of our executables on the benchmark's experiment."""
    given = (word for key, value in parameters.items() for word in ('-p', f'{key}:={value}'))
    return Child(BIN / name, *options, '--ros-args', '--params-file', CONFIG, *given)


def composed(folder: Path, seconds: float, recorded: bool) -> Measured:
    """Measure closed_loop."""
    options, parameters = (
        ([], {'recorder:bag': folder / 'bag'}) if recorded else (['--no-recorder'], {})
    )
    child = node('closed_loop', *options, **{'plant_simulator:duration': seconds}, **parameters)
    return steps_per_second(child.wait()), {'closed_loop': child.peak}


def processes(folder: Path, seconds: float, recorded: bool) -> Measured:
    """Measure plant and controller, and a recorder beside them, as processes."""
    parameters = {
        'plant_simulator': {
            'duration': PROCESSES * seconds,
            'wait_for_recorder': str(recorded).lower(),
        },
        'controller': {},
    }
    if recorded:
        parameters['recorder'] = {'bag': folder / 'bag'}
    children = {
        name: node(name, cpu_core=PLACES[name], **given) for name, given in parameters.items()
    }
    rate = steps_per_second(children['plant_simulator'].wait())
    for name in list(children)[1:]:
        children[name].interrupt()
    return rate, {name: child.peak for name, child in children.items()}


def simulate(folder: Path, seconds: float) -> Measured:
    """Measure the command that makes the same bag without ROS."""
    child = Child(
        BIN / 'simulate',
        CONFIG,
        folder / 'bag',
        '-p',
        f'plant_simulator:duration:={SIMULATE * seconds}',
    )
    return steps_per_second(child.wait()), {'simulate': child.peak}


def composed_floor(_: Path, seconds: float) -> Measured:
    """Measure publish and take on one thread."""
    child = Child(sys.executable, FLOORS_SCRIPT, 'composed', int(seconds * STEPS_PER_SECOND))
    return float(child.wait()), {'floor': child.peak}


def process_floor(seconds: float, as_ours: bool) -> Measured:
    """Measure two processes that send each message back, in the way of our nodes or not."""

    def start(role: str, like: str) -> Child:
        ours = ('--best-effort', '--udp', '--core', PLACES[like]) if as_ours else ()
        return Child(
            sys.executable, FLOORS_SCRIPT, role, int(PROCESSES * seconds * STEPS_PER_SECOND), *ours
        )

    echo, ping = start('echo', 'controller'), start('ping', 'plant_simulator')
    rate = float(ping.wait())
    echo.interrupt()
    return rate, {'ping': ping.peak, 'echo': echo.peak}


CASES: dict[str, Callable[[Path, float], Measured]] = {
    'composed_floor': composed_floor,
    'composed': partial(composed, recorded=False),
    'composed_recorded': partial(composed, recorded=True),
    'simulate': simulate,
    'two_process_floor': lambda _, seconds: process_floor(seconds, as_ours=False),
    'best_effort_floor': lambda _, seconds: process_floor(seconds, as_ours=True),
    'two_process': partial(processes, recorded=False),
    'three_process': partial(processes, recorded=True),
}
COMPARED = {
    'composed': ('composed_floor',),
    'composed_recorded': ('composed_floor',),
    'simulate': ('composed_recorded',),
    'two_process': ('two_process_floor', 'best_effort_floor'),
    'three_process': ('two_process_floor', 'best_effort_floor'),
}


def memory_growth(long: float) -> dict[str, float]:
    """Return the peak RSS [MB] of two recorded runs, of ``long`` [s] and of a sixth of it."""
    peaks = {}
    for seconds in (long / 6, long):
        with tempfile.TemporaryDirectory() as folder:
            _, peak = composed(Path(folder), seconds, recorded=True)
        peaks[f'{seconds:g}_s'] = peak['closed_loop']
    return peaks


def measure(rounds: int, seconds: float) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Return the median rate [steps/s], and the peak RSS [MB] of each process, of every case."""
    rates: dict[str, list[float]] = {name: [] for name in CASES}
    peaks: dict[str, dict[str, float]] = {}
    for _ in range(rounds):
        for name, case in CASES.items():
            with tempfile.TemporaryDirectory() as folder:
                rate, peaks[name] = case(Path(folder), seconds)
            rates[name].append(rate)
    return {name: median(values) for name, values in rates.items()}, peaks


def report(
    rates: dict[str, float], peaks: dict[str, dict[str, float]], growth: dict[str, float]
) -> None:
    """Print the table."""
    print(f'{"case":<20}{"steps/s":>10}{"x real time":>13}  {"ratio to":<48}peak RSS [MB]')
    for name, rate in rates.items():
        ratios = ', '.join(
            f'{other} {rate / rates[other]:.2f}' for other in COMPARED.get(name, ())
        )
        memory = ', '.join(f'{part} {size:.0f}' for part, size in peaks[name].items())
        print(f'{name:<20}{rate:>10.0f}{rate / STEPS_PER_SECOND:>13.2f}  {ratios:<48}{memory}')
    print(
        'recorded runs, peak RSS [MB]: '
        + ', '.join(f'{seconds.replace("_", " ")}: {size:.0f}' for seconds, size in growth.items())
    )


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--rounds', type=int, default=9)
    parser.add_argument(
        '--seconds', type=float, default=20.0, help='simulated time of the composed cases [s]'
    )
    parser.add_argument(
        '--long',
        type=float,
        default=60.0,
        help='simulated time of the run whose memory is measured [s]',
    )
    options = parser.parse_args()
    os.environ.setdefault('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rates, peaks = measure(options.rounds, options.seconds)
    growth = memory_growth(options.long)
    if options.json:
        print(json.dumps(rates | {'peak_rss_mb': peaks, 'growth_rss_mb': growth}, indent=2))
    else:
        report(rates, peaks, growth)


if __name__ == '__main__':
    main()
