"""JointState as CDR, against rosbags' independent serializer."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores

from impulse_control_ros.files.cdr import (
    encode_float64,
    encode_float64_array,
    encode_time,
    FIELDS,
    JointStateLayout,
    layout_in,
)

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = 'sensor_msgs/msg/JointState'
names = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20)
fields = st.sampled_from([FIELDS, ('effort',), ('position', 'velocity'), ()])
seconds, nanoseconds = st.integers(0, 2**31 - 1), st.integers(0, 999_999_999)
numbers = st.lists(st.floats(allow_nan=False), min_size=3, max_size=3)


def joint_state(sec, nanosec, frame_id, joint, values):
    time = STORE.types['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec)
    header = STORE.types['std_msgs/msg/Header'](stamp=time, frame_id=frame_id)
    return STORE.types[JOINT_STATE](
        header=header,
        name=[joint],
        **{field: np.array([values[field]] if field in values else []) for field in FIELDS},
    )


@settings(max_examples=200, deadline=None)
@given(names, names, fields, seconds, nanoseconds, numbers)
def test_another_library_reads_what_we_write_and_we_read_what_it_writes(
    joint, frame_id, filled, sec, nanosec, values
):
    layout = JointStateLayout(joint, frame_id, filled)
    values = values[: len(filled)]
    raw = layout.encode(sec, nanosec, *values)
    read = STORE.deserialize_cdr(raw, JOINT_STATE)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (sec, nanosec)
    assert (read.header.frame_id, list(read.name)) == (frame_id, [joint])
    assert [float(getattr(read, field)[0]) for field in filled] == values
    assert all(len(getattr(read, field)) == 0 for field in FIELDS if field not in filled)
    theirs = STORE.serialize_cdr(
        joint_state(sec, nanosec, frame_id, joint, dict(zip(filled, values, strict=True))),
        JOINT_STATE,
    )
    assert layout.decode(bytes(theirs)) == (sec, nanosec, *values)
    assert layout.decode(raw) == (sec, nanosec, *values)


@settings(max_examples=200, deadline=None)
@given(st.data(), st.lists(names, min_size=1, max_size=4, unique=True), names, fields)
def test_a_joint_is_found_among_others_in_what_another_library_writes(
    data, joints, frame_id, filled
):
    joint = data.draw(st.sampled_from(joints))
    values = {
        field: data.draw(
            st.lists(st.floats(allow_nan=False), min_size=len(joints), max_size=len(joints))
        )
        for field in filled
    }
    message = joint_state(1, 2, frame_id, joint, {})
    message.name = joints
    for field in filled:
        setattr(message, field, np.array(values[field]))
    raw = bytes(STORE.serialize_cdr(message, JOINT_STATE))
    layout = layout_in(raw, joint)
    assert (layout.frame_id, layout.fields) == (frame_id, tuple(filled))
    expected = (1, 2, *(values[field][joints.index(joint)] for field in filled))
    assert layout.decode(raw) == expected
    rows = np.frombuffer(raw, np.uint8)[np.newaxis]
    assert [column[0] for column in layout.decode_rows(rows)] == [True, *expected]
    assert layout_in(raw, joint + 'x' if joint + 'x' not in joints else 'x' * 50) is None


@given(st.binary(max_size=200))
def test_bytes_that_are_no_message_have_no_layout(raw):
    assert layout_in(raw, 'axis') is None


@pytest.mark.parametrize('length', [0, 3, 4, 12, 20, 60, 100])
def test_a_message_of_several_joints_that_is_cut_off_has_no_layout(length):
    whole = JointStateLayout('axis', joints=('lift', 'axis')).encode(1, 2, 0.5, 0.0, 1.0)
    assert layout_in(whole, 'axis').decode(whole) == (1, 2, 0.5, 0.0, 1.0)
    assert layout_in(whole[:length], 'axis') is None


LAYOUT = JointStateLayout('axis')
RAW = LAYOUT.encode(1, 2, 0.5, -0.25, 3.0)
VARIABLE = [*range(4, 12), *range(44, 52), *range(60, 68), *range(76, 84)]
PADDING = [17, 18, 19, 33, 34, 35, 40, 41, 42, 43, 56, 57, 58, 59, 72, 73, 74, 75]


def flipped(at):
    changed = bytearray(RAW)
    changed[at] ^= 0x55
    return bytes(changed)


@pytest.mark.parametrize('at', range(len(RAW)))
def test_each_byte_is_a_value_or_padding_or_checked(at):
    decoded = LAYOUT.decode(flipped(at))
    if at in PADDING:
        assert decoded == (1, 2, 0.5, -0.25, 3.0)
    elif at in VARIABLE:
        assert decoded not in (None, (1, 2, 0.5, -0.25, 3.0))
    else:
        assert decoded is None


@pytest.mark.parametrize('length', range(len(RAW)))
def test_a_truncated_message_is_not_decoded(length):
    assert LAYOUT.decode(RAW[:length]) is None


def test_bytes_behind_the_message_are_ignored():
    assert LAYOUT.decode(RAW + b'\xff' * 8) == (1, 2, 0.5, -0.25, 3.0)


def test_padding_is_written_as_zero():
    assert all(RAW[at] == 0 for at in PADDING)


@pytest.mark.parametrize(
    'other',
    [
        JointStateLayout('elbow'),
        JointStateLayout('axis', 'reset'),
        JointStateLayout('axis', '', ('effort',)),
    ],
)
def test_another_layout_is_not_decoded(other):
    assert LAYOUT.decode(other.encode(1, 2, *[1.0] * len(other.fields))) is None


@given(seconds, nanoseconds, st.floats(allow_nan=False))
def test_clock_and_float64_are_read_by_another_library(sec, nanosec, value):
    clock = STORE.deserialize_cdr(encode_time(sec, nanosec), 'rosgraph_msgs/msg/Clock').clock
    assert (clock.sec, clock.nanosec) == (sec, nanosec)
    assert STORE.deserialize_cdr(encode_float64(value), 'std_msgs/msg/Float64').data == value


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=5))
def test_an_array_of_efforts_is_read_and_written_by_another_library(values):
    raw, kind = encode_float64_array(values), 'std_msgs/msg/Float64MultiArray'
    read = STORE.deserialize_cdr(raw, kind)
    assert (read.data.tolist(), read.layout.dim, read.layout.data_offset) == (values, [], 0)
    assert bytes(STORE.serialize_cdr(read, kind)) == raw
