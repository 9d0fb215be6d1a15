"""Whole runs of real processes, compared bit by bit with the offline simulation."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.experiment import Experiment, read_experiment
from impulse_control_ros.files.recording import read, Recording
from test.conftest import busy_loops, CONFIG, Graph

NODES = ('plant_simulator', 'controller', 'recorder')


def assert_recording_is_the_simulation(bag: Path, config: Path) -> None:
    experiment = read_experiment(config)
    plant = experiment.plant_simulator
    run = simulate(plant, experiment.controller, plant.duration)
    recording = read(bag)
    stamps = 1_000_000_000 + np.arange(len(run.time)) * 100_000
    assert len(run.events) > 0 or not experiment.controller.impulses
    assert np.array_equal(recording.states['stamp'], stamps)
    assert np.array_equal(recording.commands['stamp'], stamps)
    assert np.array_equal(recording.impulses['stamp'], stamps[run.events['tick']])
    assert np.array_equal(recording.impulses['guard'], run.events['guard'])
    for recorded, simulated in (
            (recording.states['position'], run.measured_position),
            (recording.states['velocity'], run.measured_velocity),
            (recording.states['effort'][1:], run.applied),
            (recording.commands['effort'], run.effort),
            (recording.impulses['area'], run.events['area'])):
        assert recorded.tobytes() == simulated.tobytes()
    assert recording.receipt['missing'] == '0'
    for name in NODES:
        assert recorded_parameters(recording, name).items() >= set_parameters(experiment, name)


def recorded_parameters(recording: Recording, node: str) -> dict[str, object]:
    return {name: str(value) for name, value in recording.parameters[f'/{node}'].items()}


def set_parameters(experiment: Experiment, node: str) -> set[tuple[str, str]]:
    values = getattr(experiment, node).flat()
    return {(name, str(list(value) if isinstance(value, tuple) else value))
            for name, value in values.items() if name != 'bag'}


def run_three_processes(graph: Graph, order: tuple[str, ...], config: Path) -> Path:
    bag = graph.folder / 'bag'
    started = {}
    for name in order:
        arguments = ('--ros-args', '-p', f'bag:={bag}') if name == 'recorder' else ()
        started[name] = graph.start(name, *arguments, config=config)
    assert started['plant_simulator'].wait() == 0
    assert 'the run is over at 3.000000000 s' in started['plant_simulator'].output
    assert started['recorder'].interrupt() == 0
    assert '0 missing' in started['recorder'].output
    assert started['controller'].interrupt() == 0
    for process in started.values():
        assert 'Traceback' not in process.output
    return bag


@pytest.mark.parametrize('order', list(itertools.permutations(NODES)), ids='-'.join)
def test_three_processes_in_any_order_are_the_simulation_to_the_last_bit(graph, order):
    config = CONFIG / 'underdamped.yaml'
    assert_recording_is_the_simulation(run_three_processes(graph, order, config), config)


def test_load_beside_the_three_processes_changes_no_bit(graph):
    config = CONFIG / 'time_varying.yaml'
    with busy_loops(2):
        bag = run_three_processes(graph, NODES, config)
    assert_recording_is_the_simulation(bag, config)


@pytest.mark.parametrize('name', ['pd_only_lower', 'pd_only_upper', 'underdamped', 'time_varying',
                                  'coulomb', 'encoder'])
def test_the_composed_process_is_the_simulation_to_the_last_bit(graph, name):
    config, bag = CONFIG / f'{name}.yaml', graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '-p', f'recorder:bag:={bag}',
                          config=config)
    assert process.wait() == 0, process.output
    assert_recording_is_the_simulation(bag, config)


def test_the_composed_process_runs_without_a_recorder(graph):
    process = graph.start('closed_loop', '--no-recorder', config=CONFIG / 'underdamped.yaml')
    assert process.wait() == 0
    assert process.output.count('the run is over') == 1
    assert 'recording' not in process.output
