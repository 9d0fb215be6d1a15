"""
Measure how fast a bag is read and analysed, against the mcap library's own iterator.

    python benchmarks/reading.py [--json] [--rounds N] [--samples N] [--large N]

The bag is a 10 kHz run of config/time_varying.yaml, simulated and written by the package's own
writer with zstd: a state and a command for each sample. `mcap_iterator` is what any reader on that
library costs at the least: it looks at no message. `read` gives the arrays. Figures are messages
per second, medians of the rounds, in which the two are interleaved. The last part lets the command
``analyze`` make its table of ever longer bags: wall time, time of the cores, and peak RSS.
"""

import argparse
from collections.abc import Callable, Iterator
from itertools import islice
import json
import os
from pathlib import Path
from statistics import median
import subprocess
import sys
import tempfile
import time

from mcap.reader import make_reader

from impulse_control_ros.core.protocol import CommandHeader, NodeHeader, StateHeader
from impulse_control_ros.core.simulate import Run, simulate
from impulse_control_ros.core.tick import SECOND, stamp
from impulse_control_ros.files.bag import BagWriter, storage_path, Topic
from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.parameter_event import (
    encode_parameter_event,
    TYPE as PARAMETER_EVENT,
)
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag

CONFIG = Path(__file__).parent.parent / 'config' / 'time_varying.yaml'
TYPE, STEP = 'sensor_msgs/msg/JointState', 100_000
RUN, CONTROLLER = '0123abcd', '/controller#4567'
FIRST = JointStateLayout('axis', StateHeader(RUN).frame_id)
STATE = JointStateLayout('axis', StateHeader(RUN, 0, CONTROLLER).frame_id)
COMMAND = JointStateLayout('axis', CommandHeader(RUN, 0, CONTROLLER).frame_id, ('effort',))


def messages(run: Run) -> Iterator[tuple[int, int, bytes]]:
    """Yield the series of a run."""
    for k in range(len(run.time)):
        at = stamp(k, SECOND, STEP)
        ns = SECOND + k * STEP
        yield (
            ns,
            1,
            (STATE if k else FIRST).encode(
                *at, run.position[k], run.velocity[k], run.effort[max(k - 1, 0)]
            ),
        )
        yield ns, 2, COMMAND.encode(*at, run.effort[k])


def written(folder: Path, samples: int) -> Path:
    """Write a bag of so many samples, and return it."""
    experiment = load_experiment(CONFIG)
    writer = BagWriter(folder / str(samples), 'zstd')
    for name in ('/joint_states', '/joint_commands'):
        writer.add_topic(Topic(name=name, type=TYPE, qos=()))
    writer.add_topic(Topic(name='/run_parameters', type=PARAMETER_EVENT, qos=()))
    writer.write(
        (
            SECOND,
            3,
            encode_parameter_event(
                *divmod(SECOND, SECOND), NodeHeader(RUN, node).frame_id, parameters.flat(), {}
            ),
        )
        for node, parameters in (
            ('/plant_simulator', experiment.plant),
            (CONTROLLER, experiment.gains),
        )
    )
    series = messages(simulate(experiment.plant, experiment.gains, (samples - 1) * STEP / SECOND))
    while part := list(islice(series, 10_000)):  # what is given at once is held at once
        writer.write(part)
    writer.close()
    return writer.folder


def iterate(bag: Path) -> int:
    """Count the messages with the library."""
    with storage_path(bag).open('rb') as stream:
        return sum(1 for _ in make_reader(stream).iter_messages())


def count(bag: Path) -> int:
    """Count the messages that `read` gives."""
    recording = read_bag(bag)
    return len(recording.states) + len(recording.commands)


def rate(measure: Callable[[Path], int], bag: Path) -> float:
    """Return messages per second."""
    began = time.perf_counter()
    number = measure(bag)
    return number / (time.perf_counter() - began)


def analyzed(bag: Path) -> dict[str, float]:
    """Return wall time, time of the cores and peak RSS of the command on a bag."""
    began = time.perf_counter()
    process = subprocess.Popen(
        [Path(sys.executable).with_name('analyze'), bag], stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f'analyze ends with {process.returncode}')
    return {
        'messages': 2 * int(bag.name),
        'wall_s': time.perf_counter() - began,
        'cpu_s': usage.ru_utime + usage.ru_stime,
        'peak_rss_mb': usage.ru_maxrss / 1024,
    }


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--samples', type=int, default=100_000)
    parser.add_argument('--large', type=int, default=6_000_000)
    options = parser.parse_args()
    cases = {'mcap_iterator': iterate, 'read': count}
    with tempfile.TemporaryDirectory() as name:
        bag = written(Path(name), options.samples)
        count(bag)  # compile
        rates: dict[str, list[float]] = {case: [] for case in cases}
        for _ in range(options.rounds):
            for case, measure in cases.items():
                rates[case].append(rate(measure, bag))
        growth = [
            analyzed(written(Path(name), size))
            for size in (options.large // 100, options.large // 10, options.large)
        ]
    result = {case: median(values) for case, values in rates.items()}
    if options.json:
        print(json.dumps({'messages_per_s': result, 'growth': growth}, indent=2))
        return
    print(f'{"case":<16}{"messages/s":>14}{"x iterator":>12}')
    for case, value in result.items():
        print(f'{case:<16}{value:>14.0f}{value / result["mcap_iterator"]:>12.1f}')
    print(f'{"messages":>12}{"analyze [s]":>14}{"of a core [s]":>15}{"peak RSS [MB]":>15}')
    for line in growth:
        print(
            f'{line["messages"]:>12}{line["wall_s"]:>14.2f}{line["cpu_s"]:>15.2f}'
            f'{line["peak_rss_mb"]:>15.0f}'
        )


if __name__ == '__main__':
    main()
