"""The controller on an axis that knows nothing of us: MuJoCo, in a process of its own."""

from pathlib import Path
import signal
import time

import numpy as np
import pytest
from sensor_msgs.msg import JointState
import yaml

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.recording import read
from impulse_control_ros.nodes.standby import SETTLE
from impulse_control_ros.nodes.topics import SERIES_QOS, WINDOW
from impulse_control_ros.tools.analyze.run import Run
from test.conftest import ROOT, wait_for

EXAMPLE = ROOT / 'examples' / 'mujoco_axis'
GIVEN = yaml.safe_load((EXAMPLE / 'axis.yaml').read_text())['/**/controller']['ros__parameters']
LIMIT, DEADBAND = GIVEN['effort_limit'], GIVEN['position_deadband']


def started(graph, client, *more):
    """Return the bag, recorder, controller and axis of the example, recorded from its start."""
    bag = graph.folder / 'bag'
    options = ('--ros-args', '--params-file', EXAMPLE / 'axis.yaml', '-p')
    recorder = graph.start('recorder', *options, f'bag:={bag}')
    controller = graph.start('controller', *options, 'managed:=true', *more)
    axis = graph.start('python', EXAMPLE / 'axis.py')
    recorder.says('recording into')
    client.spin_for(SETTLE)  # the axis waits for no one: let all discover each other
    client.activate()
    return bag, recorder, controller, axis


@pytest.fixture
def run(graph, client):
    """Return a function that runs the example until it rests where it is ``settled``."""
    def made(settled, *more):
        bag, recorder, controller, axis = started(graph, client, *more)

        def at_rest():
            # of the bag as far as it is written: one more subscriber is a load
            positions = read(bag).states['position'][-500:]
            return len(positions) == 500 and np.ptp(positions) < 1e-5 and settled(positions[-1])
        wait_for(at_rest, 'an axis at rest', lambda: time.sleep(1.0))
        for process in (recorder, controller, axis):
            assert process.interrupt() == 0, process.output
        assert 'answering /mujoco_axis' in controller.output
        assert 'of the axis' not in controller.output  # findings on what it does not know
        return graph, bag
    return made


def assert_sound(graph, bag):
    """Assert what holds of any run, whatever the wall clock did to it."""
    recording = read(bag)
    assert recording.receipt['missing'] == '0'
    assert (np.diff(recording.states['stamp']) == SECOND // 1000).all()
    assert np.isfinite(recording.commands['effort']).all()
    assert np.abs(recording.commands['effort']).max() <= LIMIT
    # the first commands may have come before the recorder was there
    late = recording.states['effort'][len(recording.states) // 2:]
    assert set(late) <= {0.0, *recording.commands['effort']}
    replayed = graph.start('replay', bag, '--controller')
    assert replayed.wait() == 0, replayed.output
    assert 'every message is the same, to the bit' in replayed.output
    refused = graph.start('replay', bag, '--closed-loop')
    assert refused.wait() == 2
    assert 'no node of it has the parameters of a plant' in refused.output
    return recording


def test_impulses_bring_a_foreign_axis_into_the_dead_band_and_the_bag_replays(run):
    recording = assert_sound(*run(lambda position: abs(position) <= DEADBAND))
    assert len(recording.impulses) > 0
    span, = Run(name='bag', path=Path('bag'), recording=recording).responses
    assert recording.states['stamp'][span.start] == recording.commands['stamp'][0]
    assert recording.states['position'][span.start] == 0.5


def test_without_impulses_it_sticks_where_the_spring_is_weaker_than_the_friction(run):
    graph, bag = run(lambda position: position < 0.4, '-p', 'impulses:=false')
    recording = assert_sound(graph, bag)
    assert DEADBAND < abs(recording.states['position'][-1]) <= 1.0 / GIVEN['K']
    assert not len(recording.impulses)
    shown = graph.start('analyze', bag)
    assert shown.wait() == 0, shown.output
    assert shown.output.splitlines()[3].split()[-1] == 'never'


def test_a_run_whose_states_stayed_away_for_a_while_replays_to_the_bit(graph, client):
    # without a dead band there are impulses to the end, whose pauses the memory counts
    bag, recorder, controller, axis = started(graph, client, '-p', 'position_deadband:=0.0')
    wait_for(lambda: len(read(bag).impulses), 'impulses', lambda: time.sleep(1.0))
    axis.send(signal.SIGSTOP)
    controller.says('0 N is commanded')
    axis.send(signal.SIGCONT)
    controller.says('states are back')
    for process in (recorder, controller, axis):
        assert process.interrupt() == 0, process.output
    recording = assert_sound(graph, bag)
    assert len(recording.withdrawn)
    assert np.isin(recording.withdrawn, recording.commands['stamp']).all()


def test_a_recorder_keeps_no_more_of_a_plant_without_a_controller_than_it_needs(graph, client):
    bag = graph.folder / 'bag'
    options = ('--ros-args', '--params-file', EXAMPLE / 'axis.yaml')
    recorder = graph.start('recorder', *options, '-p', f'bag:={bag}')
    states = client.listen('/joint_states', JointState)
    axis = graph.start('python', EXAMPLE / 'axis.py')
    client.spin_until(lambda: len(states) > 6 * WINDOW, 'states that nobody answers')
    heard = states[-1].header.stamp
    controller = graph.start('controller', *options)
    recorder.says('recording into')
    for process in (recorder, controller, axis):
        assert process.interrupt() == 0, process.output
    behind = heard.sec * SECOND + heard.nanosec - int(read(bag).states['stamp'][0])
    assert behind <= (WINDOW + SERIES_QOS.depth) * SECOND // 1000  # its queue may be full
