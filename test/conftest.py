"""Fixtures: a ROS domain with processes, a node that talks to them, and two recorded runs."""

from collections.abc import Iterator
import os
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
import pytest

from test.client import Client
from test.processes import BIN, busy_loops, CONFIG, Graph, Process, ROOT, wait_for

__all__ = ['BIN', 'CONFIG', 'ROOT', 'Client', 'Graph', 'Process', 'busy_loops', 'wait_for']

settings.register_profile('quick', derandomize=True, max_examples=40, deadline=None)
settings.register_profile(
    'thorough', max_examples=2000, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile('quick')
if 'IMPULSE_SOAK' not in os.environ:
    # hypothesis also draws the literals of the modules loaded so far, which differ from run to run
    assert hasattr(providers, '_get_local_constants')
    providers._get_local_constants = lambda: providers._local_constants


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    made = Graph(tmp_path)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def client(graph: Graph) -> Iterator[Client]:
    made = Client(graph)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(scope='session')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """
    Return a folder with two bags of real runs.

    ``underdamped`` is of closed_loop; ``left`` of three processes in the namespace /left, with
    varying damping and all topics.
    """
    folder = tmp_path_factory.mktemp('recorded')
    graph = Graph(folder)
    try:
        composed = graph.start(
            'closed_loop',
            config=CONFIG / 'underdamped.yaml',
            **{'recorder:bag': folder / 'underdamped'},
        )
        plant, controller, recorder = (
            graph.start(
                name,
                '--ros-args',
                '-r',
                '__ns:=/left',
                config=CONFIG / 'time_varying.yaml',
                **parameters,
            )
            for name, parameters in (
                ('plant_simulator', {'wait_for_recorder': True}),
                ('controller', {}),
                (
                    'recorder',
                    {
                        'bag': folder / 'left',
                        'topics': [
                            'setpoint',
                            'damping',
                            'recorder_progress',
                            '/clock',
                            '/diagnostics',
                        ],
                    },
                ),
            )
        )
        for process in (composed, plant):
            assert process.wait() == 0, process.output
        for process in (recorder, controller):
            assert process.interrupt() == 0, process.output
    finally:
        graph.close()
    return folder
