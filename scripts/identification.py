"""
Measure how honest `identify` is: python -m scripts.identification [RECORDS] [FIRST_SEED].

Prints the tables of docs/concepts/identification.md that come from simulated records.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
import sys

import numpy as np

from impulse_control_ros.core.closed_loop import ClosedLoop, empty_trace
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.identification import Record
from impulse_control_ros.core.identify import identify
from impulse_control_ros.core.nonidealities import Disturbance, Sensor
from impulse_control_ros.core.plant import Plant

TARGETS = (0.5, -0.3, 0.2, -0.5, 0.4)  # m
NAMES = ('m', 'd', 'F_c', 'offset')


@dataclass(frozen=True, kw_only=True)
class Moves:
    """
    The record of an axis that moves from set-point to set-point.

    ``greatest`` [N s/m] is the greatest damping while the axis moves.
    """

    record: Record
    greatest: float


def moves(plant: Plant, gains: ControlGains, targets: Sequence[float], duration: float) -> Moves:
    """Move ``plant`` to each of ``targets`` [m] in turn, for ``duration`` [s] each."""
    loop, count = ClosedLoop(plant, gains), round(duration / plant.time_step)
    traces = []
    for target in targets:
        loop.change(plant, replace(gains, x_r=target))
        traces.append(empty_trace(count, ideal=False))
        loop.fill(traces[-1])
    joined = {
        name: np.concatenate([getattr(trace, name) for trace in traces])
        for name in ('measured_position', 'measured_velocity', 'effort', 'velocity', 'damping')
    }
    record = Record(
        time=np.arange(len(targets) * count) * plant.time_step,
        position=joined['measured_position'],
        velocity=joined['measured_velocity'],
        effort=joined['effort'],
    )
    # the damping of a trace acted over the sample that led to its state
    moving = np.abs(joined['velocity'][1:]) > 1e-3 * np.abs(joined['velocity']).max()
    return Moves(record=record, greatest=float(joined['damping'][1:][moving].max()))


def random_axis(seed: int) -> tuple[Moves, dict[str, float]]:
    """Return eight moves of an axis drawn at random, with constant damping, and its truth."""
    rng = np.random.default_rng(seed)
    m, stroke = 10.0 ** rng.uniform(-1.3, 0.7), 10.0 ** rng.uniform(-2.0, 0.0)
    frequency = 2.0 * math.pi * rng.uniform(1.0, 3.0)
    K, total = m * frequency**2, 2.0 * rng.uniform(0.4, 1.0) * m * frequency
    d = total * rng.uniform(0.2, 0.8)
    F_c = K * stroke * rng.uniform(0.02, 0.15)
    offset = F_c * rng.uniform(-1.0, 1.0)
    step = stroke * 10.0 ** rng.uniform(-4.0, -2.7)
    plant = Plant(
        m=m,
        F_c=F_c,
        x_0=0.0,
        time_step=1e-3,
        damping=Damping(value=d),
        sensor=Sensor(
            resolution=step, position_noise=step * rng.uniform(), velocity='none', seed=seed
        ),
        disturbance=Disturbance(force=-offset),
    )
    gains = ControlGains(
        m=m, K=K, D=total - d, impulses=False, time_step=1e-3, velocity_bandwidth=30.0
    )
    targets = stroke * rng.permutation([1.0, -0.6, 0.8, -0.3, 0.5, -1.0, 0.2, -0.8])
    truth = {'m': m, 'd': d, 'F_c': F_c, 'offset': offset}
    return moves(plant, gains, targets.tolist(), rng.uniform(0.5, 1.0)), truth


def varying_axis(seed: int, kind: str) -> Moves:
    """Return five moves of Table I's axis with F_c = 0.3 N and d(t) in [0.15, 1.5] N s/m."""
    bandwidth = 5.0 if kind == 'noise' else np.random.default_rng(seed).uniform(0.3, 3.0)
    plant = Plant(
        x_0=0.0,
        F_c=0.3,
        sensor=Sensor(resolution=1.534e-4, velocity_noise=1e-2),
        damping=Damping(kind=kind, seed=seed, bandwidth=bandwidth),
    )
    return moves(plant, ControlGains(impulses=False), TARGETS, 1.0)


def interval_hits(seeds: Sequence[int]) -> np.ndarray:
    """Return whether the interval of each of m, d, F_c, offset covers the truth: (n, 4)."""
    hits = []
    for seed in seeds:
        moved, truth = random_axis(seed)
        found = identify(moved.record).parameters
        hits.append(
            [
                found[name].interval[0] <= truth[name] <= found[name].interval[1]
                if math.isfinite(found[name].interval[0])
                else math.nan
                for name in NAMES
            ]
        )
    return np.array(hits, float)


def bound_ratios(seeds: Sequence[int], kind: str) -> np.ndarray:
    """Return d_bar over the greatest damping, nan where d_bar is refused: shape (n,)."""
    ratios = []
    for seed in seeds:
        moved = varying_axis(seed, kind)
        ratios.append(identify(moved.record).d_bar / moved.greatest)
    return np.array(ratios)


def main(arguments: Sequence[str]) -> None:
    """Print the tables."""
    count, first = (int(given) for given in (*arguments, '200', '0')[:2])
    hits = interval_hits(range(first, first + count))
    print(f'| {count} random axes | ' + ' | '.join(NAMES) + ' |')
    print('|---|' + '---|' * len(NAMES))
    for text, row in (
        ('95 % interval covers', np.nanmean(hits, axis=0)),
        ('has an interval', np.mean(np.isfinite(hits), axis=0)),
    ):
        print(f'| {text} | ' + ' | '.join(f'{value:.1%}' for value in row) + ' |')
    print('\n| d(t), F_c = 0.3 N | records | d_bar refused | covers | ratio, median (range) |')
    print('|---|---|---|---|---|')
    for kind in ('noise', 'sinusoidal'):
        ratios = bound_ratios(range(first, first + max(count * 3 // 10, 1)), kind)
        known = ratios[np.isfinite(ratios)]
        print(
            f'| {kind} | {len(ratios)} | {len(ratios) - len(known)} | {np.mean(known >= 1.0):.0%} '
            f'| {np.median(known):.2f} ({known.min():.2f} to {known.max():.2f}) |'
        )


if __name__ == '__main__':
    main(sys.argv[1:])
