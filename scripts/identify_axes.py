"""
Identify random axes over real nodes, and control them by what is written: a table of all.

Each axis is moved by ``excite`` in ``closed_loop``; ``identify`` reads the bag and writes an
experiment, whose controller then runs in ``closed_loop`` on the true axis. An axis passes if it
settles within 1.2 of the predicted time, ends within two encoder steps or the predicted floor, and
has no impulse at rest.

    python -m scripts.identify_axes FOLDER [COUNT [SEED]]
"""

from collections.abc import Mapping
from dataclasses import dataclass
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
from typing import Any

import numpy as np

from impulse_control_ros.core.metrics import settling_time
from impulse_control_ros.core.parameter import build
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.experiment import PlantParameters
from impulse_control_ros.files.recording import read_bag

BIN = Path(sys.executable).parent
TRAVEL, SPEED, STEP = 0.2, 0.5, 0.1  # m, m/s, m: half the travel, the limit, the controlled move
PACE = {'x_0': 0.0, 'real_time_factor': 1.0}  # of the motion: set-points come in time
LATE = 1.2  # times the predicted settling time
HEAD = (
    *('axis', 'm [kg]', 'm found', 'd [N s/m]', 'd_bar found', 'F_c [N]', 'F_c found'),
    *('step [m]', 'velocity', 'predicted [s]', 'settled [s]', 'band [m]', 'final error [m]'),
    *('impulses/s at rest', 'passes'),
)


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A true axis, the gains that move it for identification, and the requirement, by name."""

    plant: Mapping[str, Any]
    moving: Mapping[str, Any]
    settling_time: float
    effort_limit: float


def drawn(seed: int) -> Axis:
    """Return a random axis."""
    random = np.random.default_rng(seed)
    m, speed = 10.0 ** random.uniform(-1.3, 0.7), random.uniform(8.0, 20.0)
    d_bar = m * random.uniform(1.0, 8.0)
    velocity = str(random.choice(['ideal', 'difference', 'none']))
    K, friction = m * speed**2, m * random.uniform(0.0, 5.0)
    return Axis(
        plant={
            'm': m,
            'F_c': friction,
            'time_step': float(random.choice([2e-4, 5e-4, 1e-3])),
            'damping.kind': str(random.choice(['noise', 'sinusoidal'])),
            'damping.lower': d_bar * random.uniform(0.2, 0.7),
            'damping.upper': d_bar,
            'damping.bandwidth': random.uniform(0.5, 3.0),
            'damping.seed': seed,
            'sensor.resolution': 10.0 ** random.uniform(-5.3, -4.0),
            'sensor.velocity': velocity,
            'sensor.velocity_noise': random.uniform(0.0, 5e-3) if velocity == 'ideal' else 0.0,
        },
        moving={
            'K': K,
            'D': m * speed,
            'velocity_source': 'measured' if velocity == 'ideal' else 'estimated',
        },
        settling_time=random.uniform(4.0, 8.0) / speed,
        effort_limit=3.0 * (STEP * K + friction),
    )


def studied(axis: Axis, folder: Path, environment: Mapping[str, str]) -> dict[str, Any]:
    """Return what is found of an axis, and how its controller does; raises `RuntimeError`."""
    folder.mkdir(parents=True)
    moving = {**axis.moving, 'impulses': False, 'time_step': axis.plant['time_step']}
    write(folder / 'moving.yaml', plant_simulator={**PACE, **axis.plant}, controller=moving)
    loop = start('closed_loop', folder, environment, 'moving.yaml', 'recorder:bag:=moved')
    try:
        run('excite', folder, environment, '--travel', -TRAVEL, TRAVEL, '--max-speed', SPEED)
    finally:
        loop.send_signal(signal.SIGINT)
        loop.wait()
    said = run(
        *('identify', folder, environment, 'moved', '--format', 'json'),
        *('--write', 'axis.yaml', '--travel', STEP, '--settling-time', axis.settling_time),
        *('--effort-limit', axis.effort_limit),
    )
    found = json.loads(said)
    ends = max(3.0 * found['design']['settling_time'], 0.5)
    true = build(PlantParameters, {**axis.plant, 'x_0': STEP, 'duration': ends})
    write(folder / 'true.yaml', plant_simulator=true.flat())
    loop = start(
        'closed_loop', folder, environment, 'axis.yaml', 'recorder:bag:=held', 'true.yaml'
    )
    if loop.wait():
        raise RuntimeError(f'closed_loop: {(folder / "closed_loop.log").read_text()}')
    return found | {'response': response(folder / 'held', found['design'])}


def response(bag: Path, design: Mapping[str, Any]) -> dict[str, float]:
    """Return how a recorded response settles and rests."""
    recording = read_bag(bag)
    rest = 1.5 * design['settling_time']
    late = np.count_nonzero(
        recording.impulses['stamp'] > recording.states['stamp'][0] + rest * SECOND
    )
    return {
        'settled': settling_time(recording.time, recording.position, design['band']),
        'final_error': float(recording.position[-1]),
        'impulses_at_rest': late / (recording.time[-1] - rest),
    }


def passes(axis: Axis, found: Mapping[str, Any]) -> bool:
    """Return whether a response is as predicted."""
    design, seen = found['design'], found['response']
    largest = max(2.0 * axis.plant['sensor.resolution'], design['band'])
    return (
        seen['settled'] <= LATE * design['settling_time']
        and abs(seen['final_error']) <= largest
        and not seen['impulses_at_rest']
    )


# -- processes ------------------------------------------------------------------------------


def write(path: Path, **nodes: Mapping[str, Any]) -> None:
    """Write a parameter file; JSON is YAML."""
    path.write_text(
        json.dumps({f'/**/{node}': {'ros__parameters': values} for node, values in nodes.items()})
    )


def start(
    name: str, folder: Path, environment: Mapping[str, str], config: str, bag: str, *more: str
) -> subprocess.Popen[bytes]:
    """Start an executable with parameter files and the rule for its bag."""
    files = [item for path in (config, *more) for item in ('--params-file', path)]
    with (folder / f'{name}.log').open('ab') as log:
        return subprocess.Popen(  # noqa: S603 (our own executable)
            [str(BIN / name), '--ros-args', *files, '-p', bag],
            cwd=folder,
            env=dict(environment),
            stdout=log,
            stderr=log,
        )


def run(name: str, folder: Path, environment: Mapping[str, str], *arguments: object) -> str:
    """Run an executable; returns its output, or raises `RuntimeError` with its last line."""
    done = subprocess.run(  # noqa: S603 (our own executable)
        [str(BIN / name), *map(str, arguments)],
        cwd=folder,
        env=dict(environment),
        capture_output=True,
        text=True,
        check=False,
    )
    (folder / f'{name}.log').write_text(done.stdout + done.stderr)
    if done.returncode:
        raise RuntimeError(f'{name}: {(done.stderr.splitlines() or ["no word"])[-1]}')
    return done.stdout


# -- the table ------------------------------------------------------------------------------


def row(number: int, axis: Axis, found: Mapping[str, Any]) -> list[str]:
    """Return the cells of an axis."""
    design, seen, plant = found['design'], found['response'], axis.plant
    low, high = found['parameters']['m']['interval']
    friction = found['parameters']['F_c']['value']
    return [
        str(number),
        f'{plant["m"]:.4g}',
        f'{found["parameters"]["m"]["value"]:.4g} ({low:.4g} to {high:.4g})',
        f'{plant["damping.lower"]:.3g} to {plant["damping.upper"]:.3g}',
        f'{found["d_bar"]:.3g}',
        f'{plant["F_c"]:.3g}',
        '-' if friction is None else f'{friction:.3g}',
        f'{plant["sensor.resolution"]:.2g}',
        plant['sensor.velocity'],
        f'{design["settling_time"]:.3g}',
        f'{seen["settled"]:.3g}',
        f'{design["band"]:.2g}',
        f'{seen["final_error"]:.2g}',
        f'{seen["impulses_at_rest"]:.3g}',
        'yes' if passes(axis, found) else 'no',
    ]


def main(folder: Path, count: int = 20, first: int = 1) -> None:
    """Print a table in Markdown, line by line."""
    print('| ' + ' | '.join(HEAD) + ' |\n|' + '---|' * len(HEAD), flush=True)
    for seed in range(first, first + count):
        axis = drawn(seed)
        try:
            cells = row(seed, axis, studied(axis, folder / str(seed), os.environ))
        except RuntimeError as error:
            cells = [str(seed), f'{axis.plant["m"]:.4g}', str(error)]
        print('| ' + ' | '.join(cells) + ' |', flush=True)


if __name__ == '__main__':
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
