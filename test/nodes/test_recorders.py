"""Recorders that come late, leave early, or are to record more."""

import os
import signal

from mcap.reader import make_reader
from sensor_msgs.msg import JointState
from stereo_msgs.msg import DisparityImage

from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import (
    assert_replays,
    assert_whole,
    composed,
    messages,
    PACED,
    UNDERDAMPED,
)


def test_recorders_that_come_late_miss_nothing_from_then_on_and_may_leave(graph, client):
    plant = graph.start('plant_simulator', config=UNDERDAMPED, wait_for_recorder=False, **PACED)
    controller = graph.start('controller', config=UNDERDAMPED)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 100, 'states')
    bags = [graph.folder / name for name in ('first', 'second')]
    recorders = [graph.start('recorder', config=UNDERDAMPED, bag=bag) for bag in bags]
    client.reported('plant_simulator', recorders=2)
    joined = len(states)
    client.spin_until(lambda: len(states) > joined + 50, 'states that both have')
    recorders[0].send(signal.SIGTERM)
    assert recorders[0].wait() == 0
    client.reported('plant_simulator', recorders=1)
    left = len(states)
    client.spin_until(lambda: len(states) > left + 50, 'states that one has')
    for process in (plant, recorders[1], controller):
        assert process.interrupt() == 0, process.output
    runs = [read_bag(bag) for bag in bags]
    for run in runs:
        # before it joined the plant did not wait for it
        at = joined - 1
        stamp = states[at].header.stamp.sec * 10**9 + states[at].header.stamp.nanosec
        since = run.states['stamp'] >= stamp
        assert since.any()
        assert (run.states['stamp'][1:] - run.states['stamp'][:-1] == 100_000).all()
        assert int(run.recording_summary['missing']) == 0
        assert {*run.states['stamp'][since][:-1]} <= {*run.commands['stamp']}
    assert runs[0].states['stamp'][-1] < runs[1].states['stamp'][-1]


def topics_of(bag):
    """Return how many messages a bag has of each topic."""
    with (bag / f'{bag.name}_0.mcap').open('rb') as stream:
        summary = make_reader(stream).get_summary()
    counts = summary.statistics.channel_message_counts
    return {channel.topic: counts.get(number, 0) for number, channel in summary.channels.items()}


def test_named_topics_are_recorded_once_and_what_cannot_be_is_named(graph, client):
    (graph.folder / 'stereo_msgs').mkdir()
    (graph.folder / 'stereo_msgs' / '__init__.py').touch()  # hides the installed one
    client.node.create_publisher(DisparityImage, '/odd', 10)
    graph.environment = {
        **graph.environment,
        'PYTHONPATH': os.pathsep.join(
            filter(None, (str(graph.folder), os.environ.get('PYTHONPATH')))
        ),
    }
    process = composed(graph, **{'recorder:topics': ['joint_states', '/rosout', '/odd']})
    process.says("message type 'stereo_msgs/msg/DisparityImage' is not installed")
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: client.node.count_subscribers('/rosout'), 'the recorder')
    client.spin_until(lambda: len(states) > 500, 'states')
    assert process.interrupt() == 0, process.output
    bag = graph.folder / 'bag'
    assert_whole(read_bag(bag))
    counts = topics_of(bag)
    assert counts.keys() == {
        '/joint_states',
        '/joint_commands',
        '/impulse_events',
        '/run_parameters',
        '/rosout',
    }
    assert counts['/joint_states'] == len(read_bag(bag).states)
    assert counts['/rosout'] > 0


def test_a_run_in_a_namespace_and_on_other_topics_is_recorded_as_it_is_called(graph):
    extra = graph.folder / 'extra.yaml'
    extra.write_text(
        '/**/recorder:\n  ros__parameters:\n    topics: []\n'
        f'    bag: {graph.folder / "bag"}\n'
        '/**/plant_simulator:\n  ros__parameters: {duration: 0.05}\n'
    )
    process = graph.start(
        'closed_loop',
        '--ros-args',
        '-r',
        '__ns:=/left',
        '-r',
        'joint_states:=measured',
        '--params-file',
        UNDERDAMPED,
        '--params-file',
        extra,
    )
    assert process.wait() == 0, process.output
    run = read_bag(graph.folder / 'bag')
    assert len(run.states) == 501
    assert_whole(run)
    assert run.parameters['/left/plant_simulator']['F_c'] == 0.0
    assert {topic for topic, *_ in messages(graph.folder / 'bag')} == {
        '/left/measured',
        '/left/joint_commands',
        '/left/impulse_events',
        '/left/run_parameters',
    }
    assert_replays(graph.folder / 'bag')
