"""``simulate``: the bag that closed_loop would record, computed without ROS."""

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TypeVar

from impulse_control_ros.command_line import ended, Parser, simulated_time, StopRequest
from impulse_control_ros.core.closed_loop import blocks_of
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.protocol import new_id, new_run, NodeHeader, StateHeader
from impulse_control_ros.core.tick import nanoseconds, SECOND, ticks, to_stamp
from impulse_control_ros.errors import BagError, DivergedError
from impulse_control_ros.files.bag import BagWriter, describe_run, require_definitions, Topic
from impulse_control_ros.files.experiment import Experiment, PlantParameters
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.run_messages import RunMessages
from impulse_control_ros.files.topics import (
    DAMPING,
    FLOAT64,
    offered_on,
    RUN_PARAMETERS,
    SERIES,
)

leave = partial(ended, 'simulate')
PLANT, CONTROLLER = '/plant_simulator', '/controller'
DESCRIPTION = 'Make the bag that closed_loop would record of an experiment, without ROS.'
EPILOG = """\
The samples, the messages and their order are those of closed_loop, to the bit. Wall-clock
parameters such as real_time_factor are ignored, and a managed controller is active from the
start. Ctrl-C ends the run; the bag then has everything up to that point. All parameters are in
docs/reference/parameters.md."""
T = TypeVar('T')


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the command line; raises `UsageError`."""
    parser = Parser(
        prog='simulate',
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'configs',
        metavar='CONFIG',
        type=Path,
        nargs='+',
        help='a ROS parameter file; later files override earlier ones',
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='the folder to make')
    parser.add_argument(
        '-p',
        dest='rules',
        metavar='[NODE:]NAME:=VALUE',
        action='append',
        default=[],
        help='a parameter of a node, or of all nodes that have it, '
        'e.g. plant_simulator:F_c:=0.5 or duration:=2.0',
    )
    return parser.parse_intermixed_args(arguments)


def main(stop: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Simulate an experiment into a bag; returns the exit status, 1 if the bag is not whole."""
    options = parse(arguments)
    experiment = load_experiment(*options.configs, rules=options.rules)
    require_end(experiment.plant)
    require_definitions([*SERIES.values(), FLOAT64])
    writer = BagWriter(options.bag, experiment.recorder.compression)
    try:
        return simulate(experiment, writer, stop)
    except BagError as error:
        return leave(error, 1)


def require_end(plant: PlantParameters) -> None:
    """Raise `ParameterError` for a run that depends on the wall clock, or has no end."""
    if not plant.lockstep:
        raise refusal(
            'plant_simulator.lockstep',
            plant.lockstep,
            'True: without it a run depends on the wall clock',
        )
    if not plant.duration:
        raise refusal(
            'plant_simulator.duration',
            plant.duration,
            '> 0 [s], e.g. with -p plant_simulator:duration:=2.0',
        )


def simulate(experiment: Experiment, writer: BagWriter, stop: StopRequest) -> int:
    """Fill and finish the bag, and report the outcome; returns the exit status."""
    plant, began = experiment.plant, monotonic()
    start_ns, count = plant.start_ns(0), ticks(plant.duration, plant.time_step) + 1
    seconds, why = 0.0, ''
    try:
        messages = begin_run(experiment, writer, start_ns)
        samples = blocks_of(plant, experiment.gains, count, start_ns)
        with simulated_time(plant.duration) as bar:
            for block in ahead(messages.block(*some) for some in samples):
                writer.write_block(block)
                seconds = (int(block.stamp[-1]) - start_ns) / SECOND
                bar.update(seconds - bar.n)
                if stop.requested or writer.full:
                    break
    except DivergedError as error:
        why = str(error)
    finally:
        wall = monotonic() - began
        writer.close(
            {'missing': '0', 'repeated': '0', 'foreign': '0', 'wall_seconds': f'{wall:.6f}'}
        )
    if writer.full:
        why = f'{writer.folder}: {writer.full.strerror}'
    elif stop.requested and not why and count > ticks(seconds, plant.time_step) + 1:
        why = f'interrupted at {seconds:g} s'
    if why:
        return leave(f'{why}; the bag is finished with its first {writer.count} messages', 1)
    print(f'{writer.folder}: {writer.count} messages, {seconds:g} s simulated in {wall:.2f} s')
    return 0


def begin_run(experiment: Experiment, writer: BagWriter, start_ns: int) -> RunMessages:
    """Write the topics and the parameters, which precede the samples of a run."""
    # closed_loop makes the plant wait for its recorder
    plant = replace(experiment.plant, wait_for_recorder=True)
    header = StateHeader(new_run(), 0, new_id(CONTROLLER))
    types = dict(SERIES)
    if {DAMPING, f'/{DAMPING}'} & set(experiment.recorder.topics):
        types[DAMPING] = FLOAT64
    topics = [
        Topic(name=f'/{name}', type=kind, qos=(offered_on(name),)) for name, kind in types.items()
    ]
    describe_run(writer, header.run, topics)
    channels = {name: writer.add_topic(topic) for name, topic in zip(types, topics, strict=True)}
    writer.write(
        (
            start_ns,
            channels[RUN_PARAMETERS],
            encode_parameter_event(
                *to_stamp(start_ns),
                NodeHeader(header.run, node).frame_id,
                parameters.flat(),
                {},
            ),
        )
        for node, parameters in ((PLANT, plant), (header.controller, experiment.gains))
    )
    return RunMessages(
        header,
        plant.joint_name,
        channels,
        start_ns,
        nanoseconds(plant.time_step, 'time_step'),
        plant.damping_every,
    )


def ahead(items: Iterator[T]) -> Iterator[T]:
    """Yield ``items``, while a thread prepares the next one."""
    with ThreadPoolExecutor(1) as worker:
        pending = worker.submit(next, items, None)
        while (item := pending.result()) is not None:
            pending = worker.submit(next, items, None)
            yield item
