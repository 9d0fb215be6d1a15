"""Whole runs of real processes, compared bit by bit with the offline simulation."""

from importlib.util import find_spec
import itertools
import re

import pytest

from impulse_control_ros.files.experiment import NODES as PARAMETERS
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import (
    assert_replays,
    assert_simulated,
    assert_whole,
    composed,
    messages,
    NODES,
    START,
    STEP,
    three_processes,
    UNDERDAMPED,
)
from test.processes import busy_loops, CONFIG

TIME_VARYING = CONFIG / 'time_varying.yaml'
ORDERS = list(itertools.permutations(NODES))
DRAWN = re.compile(rb'run:[0-9a-f]{8}|#[0-9a-f]{4}')


@pytest.mark.parametrize(
    ('order', 'duration'),
    [
        (ORDERS[0], 2.0),
        *((order, 0.05) for order in ORDERS[3:6:2]),
        *(pytest.param(order, 2.0, marks=pytest.mark.soak) for order in ORDERS[1:]),
    ],
    ids=str,
)
def test_three_processes_in_any_order_are_the_simulation_to_the_last_bit(graph, order, duration):
    bag = graph.folder / 'bag'
    started = three_processes(graph, order, UNDERDAMPED, bag, duration=duration)
    steps = round(duration / 1e-4)
    totals = started['plant_simulator'].totals
    assert totals['accepted'] == totals['steps'] + 1 == steps + 1
    run = read_bag(bag)
    assert len(run.states) == len(run.commands) == steps + 1
    assert_whole(run)
    assert_simulated(run)
    assert_replays(bag)


def test_load_beside_the_three_processes_changes_no_bit(graph):
    bag = graph.folder / 'bag'
    with busy_loops(2):
        three_processes(graph, NODES, TIME_VARYING, bag, duration=0.2)
    assert_whole(read_bag(bag))
    assert_simulated(read_bag(bag), TIME_VARYING)


@pytest.mark.parametrize('name', ['pd_only_lower', 'pd_only_upper', 'coulomb', 'encoder'])
def test_the_composed_process_is_the_simulation_to_the_last_bit(graph, name):
    config = CONFIG / f'{name}.yaml'
    process = composed(
        graph, config, **{'plant_simulator:duration': 0.3, 'plant_simulator:real_time_factor': 0.0}
    )
    assert process.wait() == 0, process.output
    run = read_bag(graph.folder / 'bag')
    assert len(run.states) == len(run.commands) == 3001
    assert_whole(run)
    assert_simulated(run, config)
    experiment = load_experiment(config)
    assert bool(len(run.impulses)) == experiment.gains.impulses
    for node, given in (
        ('plant_simulator', experiment.plant.flat()),
        ('controller', experiment.gains.flat()),
    ):
        recorded = run.parameters[f'/{node}']
        assert recorded.keys() == given.keys()
        assert PARAMETERS[node].__name__
        assert {name for name, value in given.items() if recorded[name] != listed(value)} <= {
            'duration',
            'wait_for_recorder',
        }


def listed(value):
    """Return a value as a bag tells it."""
    return list(value) if isinstance(value, tuple) else value


def undrawn(bag):
    """Return (topic, stamp, message) of a bag, without what is drawn at each start."""
    return [(topic, stamp, DRAWN.sub(b'', raw)) for topic, _, stamp, raw in messages(bag)]


def in_order(found):
    """Return messages by their stamps: what has none of its own may have come late."""
    return sorted(found, key=lambda one: (one[1], one[0] == '/damping'))


def test_one_process_three_and_none_make_the_same_bag_of_two_files(graph):
    """Also the damping stands behind the state that it was published after."""
    bags = {name: graph.folder / name for name in ('one', 'three', 'none')}
    second = graph.folder / 'second.yaml'
    second.write_text(
        '/**/controller:\n  ros__parameters: {K: 12}\n'
        '/**:\n  ros__parameters: {m: 0.12, F_c: 0.1, use_sim_time: false}\n'
    )
    files = [TIME_VARYING, second]
    process = composed(
        graph,
        files,
        **{
            'plant_simulator:duration': 0.2,
            'plant_simulator:real_time_factor': 0.0,
            'plant_simulator:wait_for_recorder': True,
            'recorder:bag': bags['one'],
        },
    )
    assert process.wait() == 0, process.output
    three_processes(graph, NODES, files, bags['three'], duration=0.2)
    one = undrawn(bags['one'])
    assert [stamp for topic, stamp, _ in one if topic == '/damping'] == [
        START + k * STEP for k in range(10, 2001, 10)
    ]
    assert in_order(undrawn(bags['three'])) == one
    if not find_spec('impulse_control_ros.tools.simulate'):
        pytest.skip('there is no simulate')
    simulated = graph.start('simulate', *files, bags['none'], '-p', 'duration:=0.2')
    assert simulated.wait() == 0, simulated.output
    assert undrawn(bags['none']) == one
    given = read_bag(bags['none']).parameters
    assert [given['/controller'][name] for name in ('m', 'K', 'D')] == [0.12, 12.0, 0.5]
    assert [given['/plant_simulator'][name] for name in ('m', 'F_c')] == [0.12, 0.1]


def test_the_composed_process_runs_without_a_recorder(graph):
    process = graph.start(
        'closed_loop', '--no-recorder', config=UNDERDAMPED, **{'plant_simulator:duration': 0.1}
    )
    assert process.wait() == 0, process.output
    assert process.totals['steps'] == 1000
    assert 'recorder' not in process.output
