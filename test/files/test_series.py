"""Bags of another recorder: rosbags writes them here, with wall times as rosbag2 does."""

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType, ParameterValue
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.recording import BagError, read
from impulse_control_ros.files.timeline import stamp_of
from impulse_control_ros.tools.analyze.command import status
from test.files.test_bag import STEP
from test.tools.bags import entries, experiment

WALL, LAG = 1_790_000_000 * 10**9, 2
TOPICS = ('/joint_states', '/impulse_events', '/joint_commands', '/damping')
TYPES = get_typestore(Stores.ROS2_JAZZY)


def changed(name, value):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    event = ParameterEvent(node='/controller')
    event.changed_parameters = [Parameter(name=name, value=value)]
    return serialize_message(event)


@pytest.fixture
def run():
    made = experiment('time_varying')
    return simulate(made.plant_simulator, made.controller, 0.3)


@pytest.fixture
def bag(tmp_path, run):
    """Return a bag in which every 50th state comes twice, and states come late, out of order."""
    messages = []
    for at, (_, topic, raw) in enumerate(entries(run)):
        again = topic == 1 and at % 50 == 0
        messages += [(WALL + 1000 * at + LAG * lag, TOPICS[topic - 1], raw)
                     for lag in range(1 + again)]
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(
            topic, 'std_msgs/msg/Float64' if topic == '/damping' else 'sensor_msgs/msg/JointState',
            typestore=TYPES) for topic in TOPICS}
        events = writer.add_connection('/parameter_events', 'rcl_interfaces/msg/ParameterEvent',
                                       typestore=TYPES)
        for time, topic, raw in reversed(messages):
            writer.write(connections[topic], time, raw)
        half, _, raw = next(item for item in messages[len(messages) // 2:] if item[1] == TOPICS[0])
        writer.write(events, half + 1, changed('x_r', 0.1))
    (tmp_path / 'changed_after').write_bytes(raw)
    return tmp_path / 'bag'


def test_the_messages_of_another_recorder_stand_at_their_stamps_each_once(bag, run):
    recording = read(bag)
    assert (np.diff(recording.states['stamp']) == STEP).all()
    assert (recording.states['position'] == run.position).all()
    assert (recording.commands['effort'] == run.effort).all()
    assert len(recording.impulses) == len(run.events)


def test_what_has_no_stamp_belongs_to_the_state_that_was_sent_before_it(bag, run):
    recording = read(bag)
    ticks = (recording.damping['stamp'] - recording.states['stamp'][0]) // STEP
    assert (ticks == np.arange(10, len(run.time), 10)).all()
    assert (recording.damping['damping'] == run.damping[ticks - 1]).all()
    change, = recording.changes
    assert change.values == {'x_r': 0.1}
    assert change.stamp == stamp_of((bag.parent / 'changed_after').read_bytes())


def test_the_bag_of_another_recorder_is_analysed_with_a_warning(bag, capsys):
    assert status([str(bag)]) == 0
    said = capsys.readouterr()
    assert 'impulses  ' in said.out
    assert 'no node tells its set-point x_r: 0 m is taken' in said.err


def test_a_bag_of_another_joint_is_refused_by_name(tmp_path):
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/joint_states', 'sensor_msgs/msg/JointState',
                                           typestore=TYPES)
        writer.write(connection, WALL, b'\0\1\0\0' + bytes(60))
    with pytest.raises(BagError, match="no joint_states of joint 'axis' among its topics"):
        read(tmp_path / 'bag')
