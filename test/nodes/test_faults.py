"""Processes that die or stand still in the middle of a run, and what is left of it."""

from contextlib import suppress
import signal

from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
import numpy as np
from rcl_interfaces.msg import ParameterEvent
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState

from impulse_control_ros.core.protocol import parse_state
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import (
    assert_replays,
    assert_simulated,
    assert_whole,
    NODES,
    Run,
    START,
    STEP,
    UNDERDAMPED,
)


def assert_no_state_is_lost(run):
    """Assert what holds after a kill: the bag may lack what the victim had just sent."""
    assert (np.diff(run.states['stamp']) == STEP).all()
    answered = len(np.unique(run.commands['stamp']))
    assert int(run.recording_summary['missing']) in (
        len(run.states) - answered,
        len(run.states) - 1 - answered,
    )


def test_a_controller_that_is_killed_and_started_again_goes_on_with_the_run(graph, client):
    run = Run(graph, client)
    run.reach(50)
    before = run.active
    run.controller.kill()
    run.controller = run.start('controller', d_bar=1.25)
    run.answered_by('/controller', but=before)
    run.reach(50)
    recording = run.finish()
    assert_no_state_is_lost(recording)
    assert_replays(run.bag)
    first, second = recording.controllers
    assert (first.values['d_bar'], second.values['d_bar']) == (1.5, 1.25)
    assert second.anew
    assert first.node_id == before != second.node_id


def test_a_controller_that_stands_by_takes_over_from_one_that_is_killed(graph, client):
    run = Run(graph, client)
    other = run.start('controller', 'other')
    client.spin_until(lambda: client.count_of('other', 'standby'), 'who stands by')
    run.controller.kill()
    run.answered_by('/other')
    run.reach(50)
    run.controller = other
    recording = run.finish()
    assert_no_state_is_lost(recording)
    assert_replays(run.bag)
    assert [change.node for change in recording.controllers] == ['/controller', '/other']


def test_a_plant_that_is_killed_and_started_again_is_another_run_in_another_bag(graph, client):
    run = Run(graph, client)
    run.reach(50)
    first = parse_state(run.states[-1].header.frame_id).run
    run.plant.kill()
    run.plant = run.start('plant_simulator')
    client.spin_until(
        lambda: run.active and parse_state(run.states[-1].header.frame_id).run != first,
        'another run',
    )
    run.reach(50)
    recordings = [run.finish(), read_bag(run.bag.with_name('bag-2'))]
    for recording in recordings:
        assert_whole(recording)
        assert_simulated(recording)
        assert recording.states['is_reset'][0]
    assert recordings[0].run == first != recordings[1].run
    for bag in (run.bag, run.bag.with_name('bag-2')):
        assert_replays(bag)


def whole_messages(bag):
    """Return how many messages the library finds in a file that was cut off."""
    with (bag / f'{bag.name}_0.mcap').open('rb') as stream, suppress(EndOfFile):
        found = 0
        for record in StreamReader(stream).records:
            found += isinstance(record, Message)
    return found


def test_a_killed_recorder_is_released_and_one_that_is_started_again_misses_nothing(graph, client):
    run = Run(graph, client, plant_simulator={'recorder_timeout': 4.0, 'real_time_factor': 0.5})
    run.reach(4000)  # at least one chunk, although the recorder may be WINDOW behind
    run.recorder.kill()
    run.reach(2000)  # more than the plant may be ahead of it
    killed = read_bag(run.bag)
    assert killed.recording_summary == {}
    assert (np.diff(killed.states['stamp']) == STEP).all()
    assert whole_messages(run.bag) >= 2 * len(killed.states) > 1000
    client.reported('plant_simulator', recorders=0)
    run.bag = graph.folder / 'second'
    run.recorder = run.start('recorder', bag=run.bag)
    # the plant's own word: the client may be behind it
    joined = START + STEP * int(client.reported('plant_simulator', recorders=1)['steps'])
    run.reach(1000)
    second = run.finish()
    assert_whole(second, second.states['stamp'][0])
    assert second.states['stamp'][0] <= joined
    assert run.stamp <= second.states['stamp'][-1]
    assert 'mid-run' in ''.join(second.lacks)


def test_each_node_can_be_stopped_and_goes_on_without_a_bit_of_difference(graph, client):
    run = Run(graph, client, plant_simulator={'real_time_factor': 0.2})
    for node in (run.controller, run.recorder):
        node.send(signal.SIGSTOP)
        run.is_repeated()
        node.send(signal.SIGCONT)
        run.reach(200)
    run.plant.send(signal.SIGSTOP)
    client.reported('controller', steps_per_second='0.0')
    run.plant.send(signal.SIGCONT)
    run.reach(200)
    recording = run.finish()
    assert_whole(recording)
    assert_simulated(recording)
    assert client.count_of('controller', 'rejected') == 0


def test_a_full_disk_ends_the_recorder_with_a_finished_bag_and_the_run_goes_on(graph, client):
    run = Run(graph, client, plant_simulator={'real_time_factor': 0.0})
    run.recorder.limit_files(400_000)
    assert run.recorder.wait() == 1
    assert 'File too large' in run.recorder.output
    assert 'Traceback' not in run.recorder.output
    run.reach(1000)
    assert run.plant.interrupt() == run.controller.interrupt() == 0
    recording = read_bag(run.bag)
    assert recording.recording_summary['full'] == 'File too large'
    assert (np.diff(recording.states['stamp']) == STEP).all()
    assert len(recording.states) > 1_000
    with Reader(run.bag) as reader:
        assert reader.message_count == int(recording.recording_summary['messages'])
        assert reader.message_count == sum(1 for _ in reader.messages())


def test_an_endpoint_that_gets_nothing_for_its_quality_of_service_is_reported(graph, client):
    started = [
        graph.start(
            node,
            config=UNDERDAMPED,
            **({'bag': graph.folder / 'bag'} if node == 'recorder' else {}),
        )
        for node in NODES
    ]
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for topic in ('/joint_states', '/joint_commands'):
        client.node.create_subscription(JointState, topic, print, latched)
    client.node.create_publisher(ParameterEvent, '/run_parameters', 10)
    for process, topic in zip(
        started,
        (
            "'joint_states', requesting",
            "'joint_commands', requesting",
            "'run_parameters', offering",
        ),
        strict=True,
    ):
        process.says(f'{topic} incompatible QoS')
        assert 'DURABILITY' in process.output
        assert process.interrupt() == 0
