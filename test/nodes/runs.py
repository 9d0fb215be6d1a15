"""Runs of the nodes as processes, and what is to be true of their bags."""

from collections.abc import Iterator
from pathlib import Path

from mcap.reader import make_reader
import numpy as np
from sensor_msgs.msg import JointState
import yaml

from impulse_control_ros.core.protocol import name_of, parse_state
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from test.command_lines import status_of
from test.processes import as_yaml, CONFIG

NODES = ('plant_simulator', 'controller', 'recorder')
UNDERDAMPED = CONFIG / 'underdamped.yaml'
START, STEP = SECOND, 100_000  # ns
PACED = {'duration': 0.0, 'real_time_factor': 0.05}  # 500 samples a second, without an end


def stamp_of(message):
    """Return the stamp of a message [ns]."""
    return message.header.stamp.sec * SECOND + message.header.stamp.nanosec


def start_as(graph, name, node, **parameters):
    """Start a node under another ``name``, with what UNDERDAMPED has for it."""
    content = yaml.safe_load(UNDERDAMPED.read_text())
    values = content.get(f'/**/{node}', {'ros__parameters': {}})
    config = graph.folder / f'{name}.yaml'
    config.write_text(yaml.safe_dump({f'/**/{name}': values}))
    return graph.start(node, '--ros-args', '-r', f'__node:={name}', config=config, **parameters)


class Run:
    """
    Plant, controller and recorder as three processes, whose run is paced and has no end.

    ``options`` are parameters by node. It is returned once so many samples have ``begun``.
    """

    def __init__(self, graph, client, begun=20, **options):
        self.graph, self.client = graph, client
        self.bag = graph.folder / 'bag'
        self._options = {
            'plant_simulator': {**PACED, 'wait_for_recorder': True},
            'recorder': {'bag': self.bag},
        }
        for node, parameters in options.items():
            self._options[node] = self._options.get(node, {}) | parameters
        self.states = client.listen('/joint_states', JointState)
        self.plant, self.controller, self.recorder = map(self.start, NODES)
        self.reach(begun)

    def start(self, node, name='', **parameters):
        """Start a node, under another ``name`` if that is given."""
        given = self._options.get(node, {}) | parameters
        if name:
            return start_as(self.graph, name, node, **given)
        return self.graph.start(node, config=UNDERDAMPED, **given)

    @property
    def stamp(self):
        """The stamp of the last state that was heard [ns]."""
        return stamp_of(self.states[-1]) if self.states else START

    @property
    def active(self):
        """The id of the controller that the last state names."""
        return parse_state(self.states[-1].header.frame_id).controller if self.states else ''

    def reach(self, samples):
        """Serve the client until it has heard so many samples more."""
        until = self.stamp + samples * STEP
        self.client.spin_until(lambda: self.stamp >= until, f'{until} ns')

    def answered_by(self, name, but=''):
        """Serve the client until a controller of that name is active, ``but`` one."""
        self.client.spin_until(
            lambda: self.active != but and name_of(self.active) == name,
            f'{name} as the active controller',
        )

    def is_repeated(self):
        """Serve the client until the plant publishes a state again."""
        before = len(self.states)

        def again():
            new = [stamp_of(one) for one in self.states[before:]]
            return len(set(new)) < len(new)

        self.client.spin_until(again, 'a state that comes again')

    def finish(self):
        """End all with Ctrl-C, in an order that loses nothing; returns the recording."""
        for process in (self.plant, self.recorder, self.controller):
            assert process.interrupt() == 0, process.output
            assert 'Traceback' not in process.output
        return read_bag(self.bag)


def composed(graph, config=UNDERDAMPED, arguments=(), **parameters):
    """Start closed_loop, paced and without an end if ``parameters`` say no other."""
    given = {f'plant_simulator:{name}': value for name, value in PACED.items()}
    return graph.start(
        'closed_loop',
        *arguments,
        config=config,
        **{**given, 'recorder:bag': graph.folder / 'bag', **parameters},
    )


def three_processes(graph, order, config, bag, **plant):
    """Run an experiment up to its end by three processes that start in this order."""
    options = {
        'plant_simulator': {'wait_for_recorder': True, **plant},
        'controller': {},
        'recorder': {'bag': bag},
    }
    started = {name: graph.start(name, config=config, **options[name]) for name in order}
    assert started['plant_simulator'].wait() == 0, started['plant_simulator'].output
    for name in ('recorder', 'controller'):
        assert started[name].interrupt() == 0, started[name].output
    for process in started.values():
        assert 'Traceback' not in process.output
    return started


# -- bags -----------------------------------------------------------------------------------


def assert_whole(run, start=START):
    """Assert that the bag has each sample once, from ``start`` [ns] on."""
    stamps = start + np.arange(len(run.states)) * STEP
    assert len(stamps) > 1
    assert np.array_equal(run.states['stamp'], stamps)
    # the last state of a run that is ended may be left without an answer
    assert np.array_equal(run.commands['stamp'], stamps[: len(run.commands)])
    assert len(stamps) - len(run.commands) in (0, 1)
    assert run.recording_summary['missing'] == '0'


def assert_simulated(run, config=UNDERDAMPED, **plant):
    """Assert that a run is that of simulate(), to the last bit, as far as it goes."""
    rules = [f'plant_simulator:{name}:={as_yaml(value)}' for name, value in plant.items()]
    made = load_experiment(config, rules=rules)
    count = len(run.states)
    alone = simulate(made.plant, made.gains, (count - 1) * STEP / SECOND)
    answered = len(run.commands)
    events = alone.events[alone.events['tick'] < answered]
    assert count > 1
    assert count - answered in (0, 1)
    assert np.array_equal(run.impulses['stamp'], run.states['stamp'][events['tick']])
    assert np.array_equal(run.impulses['guard'], events['guard'])
    for recorded, simulated in (
        (run.states['position'], alone.measured_position),
        (run.states['velocity'], alone.measured_velocity),
        (run.states['effort'][1:], alone.applied),
        (run.commands['effort'], alone.effort[:answered]),
        (run.impulses['area'], events['area']),
    ):
        assert recorded.tobytes() == simulated.tobytes()


def replayed(bag, how):
    """Return the exit status of ``replay``."""
    return status_of('replay', bag, how)


def assert_replays(bag, how='--closed-loop'):
    """Assert that ``replay`` makes every message of a bag again, and that it obeys the laws."""
    assert replayed(bag, how) == 0
    assert status_of('analyze', bag, '--check') == 0


def messages(bag: Path) -> Iterator[tuple[str, int, int, bytes]]:
    """Yield (topic, log time, publish time, message) of a bag, as they stand in it."""
    with (bag / f'{bag.name}_0.mcap').open('rb') as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            yield channel.topic, message.log_time, message.publish_time, message.data
