"""Our CDR and rclpy's, and what happens where they differ."""

import math

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from impulse_control_ros.core.protocol import parse_state
from impulse_control_ros.errors import MiddlewareError, UnreadableError
from impulse_control_ros.files.cdr import FIELDS, JointStateLayout
from impulse_control_ros.nodes import joint_state_io
from impulse_control_ros.nodes.joint_state_io import JointStateReader, verified_layout


@pytest.mark.parametrize('joint', ['axis', 'a', 'elbow_7', 'gelenk_ä'])
@pytest.mark.parametrize('frame_id', ['', 'run:0123abcd.0 /controller#4567', 'position_zero'])
@pytest.mark.parametrize('fields', [FIELDS, ('effort',)])
def test_rclpy_reads_what_we_write_and_we_read_what_rclpy_writes(joint, frame_id, fields):
    layout = verified_layout(joint, frame_id, fields)
    assert isinstance(layout, JointStateLayout)
    message = JointState(name=[joint], **{field: [2.5] for field in fields})
    message.header.frame_id, message.header.stamp.sec = frame_id, 7
    raw = bytes(serialize_message(message))
    assert layout.decode(raw) == (7, 0, *[2.5] * len(fields))


def test_a_layout_that_rclpy_does_not_share_is_refused(monkeypatch):
    monkeypatch.setattr(joint_state_io, 'decode_any', lambda *_: ('', 0, 0))
    with pytest.raises(MiddlewareError, match='rmw_fastrtps_cpp'):
        verified_layout('axis', '')


def of(fields, frame_id='run:0123abcd.0', joints=('axis',)):
    message = JointState(name=list(joints), **fields)
    message.header.frame_id, message.header.stamp.sec = frame_id, 3
    return bytes(serialize_message(message))


ROWS = {
    'usual': (of({'position': [1.0], 'velocity': [2.0], 'effort': [3.0]}), (1.0, 2.0)),
    'no velocity': (of({'position': [1.0]}), (1.0, math.nan)),
    'velocity nan': (of({'position': [1.0], 'velocity': [math.nan]}), (1.0, math.nan)),
    'of two joints': (
        of({'position': [9.0, 1.0], 'velocity': [9.0, 2.0]}, joints=('elbow', 'axis')),
        (1.0, 2.0),
    ),
}


@pytest.mark.parametrize('kind', ROWS)
def test_a_reader_reads_a_message_the_same_at_first_and_again(kind):
    raw, values = ROWS[kind]
    reader = JointStateReader('axis', parse_state, ('position',), ('velocity',))
    for _ in range(3):
        header, found = reader.read(raw)
        assert header.run == '0123abcd'
        assert found[:2] == (3, 0)
        assert np.array_equal(found[2:], values, equal_nan=True)


@pytest.mark.parametrize('kind', ['usual', 'velocity nan', 'of two joints'])
def test_a_message_like_the_last_one_is_read_by_its_layout(kind, monkeypatch):
    raw, _ = ROWS[kind]
    reader = JointStateReader('axis', parse_state, ('position',), ('velocity',))
    before = reader.read(raw)
    monkeypatch.setattr(joint_state_io, 'decode_any', None)
    assert repr(reader.read(raw)) == repr(before)


def test_a_reader_tells_messages_of_one_frame_id_apart_by_their_layout():
    reader = JointStateReader('axis', parse_state, ('position',), ('velocity',))
    for raw, values in [*ROWS.values(), *reversed(ROWS.values())]:
        assert np.array_equal(reader.read(raw)[1][2:], values, equal_nan=True)


@pytest.mark.parametrize(
    ('raw', 'why'),
    [
        (b'', 'cannot be decoded'),
        (of({'velocity': [1.0]}), "no position of joint 'axis'"),
        (of({'position': [1.0]}, joints=('elbow',)), "no joint 'axis'"),
    ],
    ids=['bytes', 'position', 'joint'],
)  # rclpy's padding is never the same
def test_a_reader_says_what_a_message_lacks(raw, why):
    reader = JointStateReader('axis', parse_state, ('position',), ('velocity',))
    with pytest.raises(UnreadableError, match=why):
        reader.read(raw)
