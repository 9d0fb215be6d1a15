"""The controller on an axis that knows nothing of us: MuJoCo, in a process of its own."""

from pathlib import Path
import signal

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
import yaml

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.files.topics import SERIES_DEPTH
from impulse_control_ros.nodes.recorder import EARLY
from impulse_control_ros.tools.analyze.run import Run
from test.command_lines import status_of
from test.nodes.runs import assert_replays, replayed
from test.processes import ROOT

EXAMPLE = ROOT / 'examples' / 'mujoco_axis'
CONFIG = EXAMPLE / 'axis.yaml'
GIVEN = yaml.safe_load(CONFIG.read_text())['/**/controller']['ros__parameters']
LIMIT, DEADBAND = GIVEN['effort_limit'], GIVEN['position_deadband']


class Plant:
    """The example as it runs, with its recorder and a controller that is active at once."""

    def __init__(self, graph, client, **controller):
        self._graph, self._client = graph, client
        self.bag = graph.folder / 'bag'
        self._raw = []
        # decoding what comes a thousand times a second would be a load beside it
        client.node.create_subscription(
            JointState, '/joint_states', self._raw.append, 1000, raw=True
        )
        self.recorder = graph.start('recorder', config=CONFIG, bag=self.bag)
        # a busy machine may stop the axis for longer than the 0.1 s of the example
        controller = {'state_timeout': 30.0} | controller
        self.controller = graph.start('controller', config=CONFIG, lifecycle=True, **controller)
        self.axis = graph.start('python', EXAMPLE / 'axis.py')
        client.spin_until(lambda: len(self._raw) > 300, 'states')
        # the axis waits for nobody
        client.spin_until(lambda: client.count_of('recorder', 'received'), 'recorded states')
        client.recorded(commands=2)  # the axis and the recorder
        client.activate()

    def position(self, back=1):
        """Return the position so many states ago."""
        state = deserialize_message(self._raw[-back], JointState)
        return state.position[state.name.index('axis')]

    def comes_to_rest(self, where):
        """Serve the client until the axis rests where it is to."""

        def at_rest():
            last = self.position()
            return where(last) and abs(last - self.position(200)) < 1e-5

        self._client.spin_until(at_rest, 'an axis at rest')

    def finish(self):
        """End all; return the recording, of which holds what holds of any."""
        self._client.spin_until(lambda: self._client.count_of('recorder', 'written'), 'a bag')
        for process in (self.recorder, self.controller, self.axis):
            assert process.interrupt() == 0, process.output
        recording = read_bag(self.bag)
        assert recording.recording_summary['missing'] == '0'
        assert (np.diff(recording.states['stamp']) == SECOND // 1000).all()
        assert np.isfinite(recording.commands['effort']).all()
        assert np.abs(recording.commands['effort']).max() <= LIMIT
        assert recording.lacks == []
        for rows in (recording.states, recording.commands):  # from the first answer on
            assert recording.controllers[0].stamp in rows['stamp']
        assert set(recording.states['effort']) <= {0.0, *recording.commands['effort']}
        assert_replays(self.bag, '--controller')
        assert replayed(self.bag, '--closed-loop') == 2
        exact = '--position-error', 1e-12, '--velocity-error', 1e-9  # of MuJoCo's solver
        assert status_of('analyze', self.bag, '--check', *exact) == 0
        return recording


def test_impulses_bring_a_foreign_axis_into_the_dead_band_and_the_bag_replays(graph, client):
    # a busy machine loses and repeats commands, for which supervision suspends impulses
    axis = Plant(graph, client, supervision=False)
    axis.comes_to_rest(lambda position: abs(position) <= DEADBAND)
    recording = axis.finish()
    assert len(recording.impulses) > 0
    (span,) = Run(name='bag', path=Path('bag'), recording=recording).responses
    assert recording.states['stamp'][span.start] == recording.commands['stamp'][0]
    assert recording.states['position'][span.start] == pytest.approx(0.5, abs=0.05)


def test_without_impulses_it_sticks_where_the_spring_is_weaker_than_the_friction(graph, client):
    axis = Plant(graph, client, impulses=False)
    axis.comes_to_rest(lambda position: position < 0.4)
    recording = axis.finish()
    assert DEADBAND < abs(recording.states['position'][-1]) <= 1.0 / GIVEN['K']
    assert not len(recording.impulses)


def test_a_run_whose_states_stayed_away_for_a_while_replays_to_the_bit(graph, client):
    # without a dead band there are impulses to the end, whose pauses the memory counts
    # DDS drops a process that is stopped for 20 s, and would have to discover it again
    axis = Plant(graph, client, position_deadband=0.0, state_timeout=5.0)
    client.spin_until(lambda: client.count_of('controller', 'impulses'), 'impulses')
    axis.axis.send(signal.SIGSTOP)
    axis.controller.says('commanding 0 N')
    axis.axis.send(signal.SIGCONT)
    axis.controller.says('states received again')
    recording = axis.finish()
    assert len(recording.withdrawn)
    assert np.isin(recording.withdrawn, recording.states['stamp']).all()


@pytest.mark.soak
def test_a_recorder_keeps_no_more_of_a_plant_without_a_controller_than_it_needs(graph, client):
    recorder = graph.start('recorder', config=CONFIG, bag=graph.folder / 'bag')
    states = client.listen('/joint_states', JointState)
    axis = graph.start('python', EXAMPLE / 'axis.py')
    client.spin_until(lambda: len(states) > EARLY + 2 * SERIES_DEPTH, 'unanswered states')
    heard = states[-1].header.stamp
    controller = graph.start('controller', config=CONFIG)
    recorder.says('recording into')
    for process in (recorder, controller, axis):
        assert process.interrupt() == 0, process.output
    behind = (
        heard.sec * SECOND + heard.nanosec - int(read_bag(graph.folder / 'bag').states['stamp'][0])
    )
    assert behind <= (EARLY + SERIES_DEPTH) * SECOND // 1000  # its queue may be full
