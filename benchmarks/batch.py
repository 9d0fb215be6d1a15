"""
Measure simulate() and simulate_batch() against a plain Python loop, in one run.

    python benchmarks/batch.py [--json] [--rounds N] [--runs N] [--large N]

Table I at a time step of 1e-4, runs of 1 s, warm. A run-step is one step of one run; figures are
ns of CPU time per run-step, which other programs change less than the wall time: the median of the
rounds, in which the cases are interleaved. The floor is what a Python loop costs at the least: the
law and the exact step with everything hoisted, no friction, constant damping, nothing recorded.
Cases without supervision are the law of the paper; the last column compares the supervised ones
with them. The last part runs --large runs, and shows wall time and the operating system's peak RSS
against the number of run-steps.
"""

import argparse
from collections.abc import Callable
import json
import math
import resource
from statistics import median
import time

import numba
import numpy as np

from impulse_control_ros.core.batch import damping_seeds, simulate_batch
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate

SECONDS, STEPS = 1.0, 10_000
REPEATS = 20
CORES = numba.config.NUMBA_NUM_THREADS
PLANTS = {
    'plain': Plant(F_c=0.0),
    'friction': Plant(F_c=1.0),
    'noise': Plant(F_c=0.0, damping=Damping(kind='noise')),
    'friction_noise': Plant(F_c=1.0, damping=Damping(kind='noise')),
}
MARK = '_supervised'
PAPER, SUPERVISED = ControlGains(supervision=False), ControlGains()


def python_loop() -> float:
    """Close the loop of Table I in plain Python; return the final position [m]."""
    m, K, D, d_bar, d, step = 0.1, 10.0, 0.5, 1.5, 0.15, 1e-4
    decay = math.exp(-d * step / m)
    gain = (1.0 - decay) / d
    slide, push = m * gain, (step - m * gain) / d
    x, v, side, direction = 0.5, 0.0, 1.0, 1.0
    for _ in range(STEPS):
        u = -K * x - D * v
        if x * side < 0.0 and abs(v) > 1e-6:
            u -= 1.2 * m * v / step
            side, direction = -side, -direction
        elif v * direction <= 0.0 and abs(x) > 1e-6:
            u -= x * d_bar / (2.0 * step)
            direction = -side
        x, v = x + slide * v + push * u, decay * v + gain * u
    return x


def rows(runs: int) -> dict[str, np.ndarray]:
    """Vary the start and the noise."""
    return {'x_0': np.linspace(0.1, 0.5, runs), 'damping.seed': damping_seeds(1, runs)}


def scalar(axis: Plant, gains: ControlGains) -> Callable[[], object]:
    """Measure runs one after another, each recorded."""

    def measure() -> None:
        for _ in range(REPEATS):
            simulate(axis, gains, SECONDS)

    return measure


def batch(axis: Plant, gains: ControlGains, runs: int, threads: int) -> Callable[[], object]:
    """Measure a batch on so many threads."""

    def measure() -> None:
        numba.set_num_threads(threads)
        simulate_batch(axis, gains, SECONDS, rows(runs))

    return measure


def cases(runs: int) -> dict[str, tuple[Callable[[], object], float]]:
    """Return what is measured, and its run-steps."""
    made: dict[str, tuple[Callable[[], object], float]] = {'python_loop': (python_loop, STEPS)}
    for name, axis in PLANTS.items():
        for gains, mark in ((PAPER, ''), (SUPERVISED, MARK)):
            made[f'scalar_{name}{mark}'] = scalar(axis, gains), REPEATS * STEPS
            made[f'batch_1_{name}{mark}'] = batch(axis, gains, runs, 1), runs * STEPS
            made[f'batch_all_{name}{mark}'] = batch(axis, gains, runs, CORES), runs * STEPS
    return made


def timed(measure: Callable[[], object]) -> float:
    """Return the CPU time [s] of all threads, which other programs change little."""
    began = time.process_time()
    measure()
    return time.process_time() - began


def growth(large: int) -> list[dict[str, float]]:
    """Run ever more run-steps with friction and noise on all cores."""
    numba.set_num_threads(CORES)
    found = []
    for runs, seconds in ((large // 100, 1.0), (large // 10, 1.0), (large, 0.1), (large, 1.0)):
        began = time.perf_counter()
        simulate_batch(PLANTS['friction_noise'], PAPER, seconds, rows(runs))
        wall = time.perf_counter() - began
        found.append(
            {
                'runs': runs,
                'steps': round(seconds * STEPS),
                'wall_s': wall,
                'ns': wall * CORES / (runs * seconds * STEPS) * 1e9,
                'peak_rss_mb': resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            }
        )
    return found


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--rounds', type=int, default=9)
    parser.add_argument('--runs', type=int, default=1024)
    parser.add_argument('--large', type=int, default=100_000)
    options = parser.parse_args()
    chosen = cases(options.runs)
    for measure, _ in chosen.values():
        measure()  # compile, and warm the caches
    times: dict[str, list[float]] = {name: [] for name in chosen}
    for _ in range(options.rounds):
        for name, (measure, _) in chosen.items():
            times[name].append(timed(measure))
    result = {
        name: median(times[name]) / run_steps * 1e9 for name, (_, run_steps) in chosen.items()
    }
    large = growth(options.large)
    if options.json:
        print(json.dumps({'ns': result, 'growth': large, 'cores': CORES}, indent=2))
        return
    print(f'{"case":<36}{"ns per run-step":>17}{"x python loop":>15}{"x paper":>9}')
    for name, ns in result.items():
        paper = f'{ns / result[name.removesuffix(MARK)]:9.2f}' if name.endswith(MARK) else ''
        print(f'{name:<36}{ns:>17.2f}{result["python_loop"] / ns:>15.1f}{paper}')
    print(f'{"runs":>8}{"steps":>8}{"wall [s]":>10}{"ns":>8}{"peak RSS [MB]":>15}')
    for line in large:
        print(
            f'{line["runs"]:>8}{line["steps"]:>8}{line["wall_s"]:>10.2f}{line["ns"]:>8.2f}'
            f'{line["peak_rss_mb"]:>15.0f}'
        )


if __name__ == '__main__':
    main()
