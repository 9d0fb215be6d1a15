"""Bytes that nobody meant: refused by name or read as what they are, and nothing else."""

from io import BytesIO
from pathlib import Path
import struct

from hypothesis import given, settings, strategies as st
from mcap.writer import CompressionType, Writer
import numpy as np
import pytest

from impulse_control_ros.errors import BagError
from impulse_control_ros.files.cdr import FIELDS, JointStateLayout, layout_in, read_header
from impulse_control_ros.files.definition import message_definition
from impulse_control_ros.files.parameter_event import (
    encode_parameter_event,
    TYPE as PARAMETER_EVENT,
)
from impulse_control_ros.files.recording import read_bag, Recording
from test.files.test_bag import AUTHOR, entries, finished, RUN, START

LAYOUTS = [
    JointStateLayout('axis'),
    JointStateLayout('axis', f'run:{RUN}.1 {AUTHOR}'),
    JointStateLayout('axis', '', ('effort',)),
    JointStateLayout('', 'x', ()),
]
bits = st.integers(0, 2**64 - 1).map(lambda word: struct.unpack('<d', struct.pack('<Q', word))[0])


@st.composite
def mutated(draw, original):
    """Flip, cut out, double or overwrite some bytes, at places anywhere in ``original``."""
    content = bytearray(original)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(content) - 1)))
        kind = draw(st.sampled_from(['flip', 'cut', 'double', 'write', 'end']))
        length = draw(st.integers(1, 40))
        if kind == 'flip' and content:
            content[at] ^= draw(st.integers(1, 255))
        elif kind == 'cut':
            del content[at : at + length]
        elif kind == 'double':
            content[at:at] = content[at : at + length]
        elif kind == 'end':
            del content[at:]
        else:
            content[at : at + length] = draw(st.binary(min_size=length, max_size=length))
    return bytes(content)


@pytest.mark.parametrize('layout', LAYOUTS)
@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_any_bytes_are_a_message_of_the_layout_or_none(layout, data):
    valid = layout.encode(1, 2, *[0.5] * len(layout.fields))
    raw = data.draw(st.one_of(st.binary(max_size=200), mutated(valid)))
    decoded = layout.decode(raw)
    assert decoded is None or len(decoded) == 2 + len(layout.fields)
    stamp, frame_id = read_header(raw)
    assert isinstance(stamp, int)
    assert isinstance(frame_id, bytes)
    found = layout_in(raw)
    assert found is None or found.decode(raw)
    rows = np.frombuffer(raw, np.uint8).reshape(1, -1)
    good, *values = layout.decode_rows(rows)
    assert bool(good[0]) == (decoded is not None)
    if decoded is not None:
        assert struct.pack(
            '<2q3d', *map(int, decoded[:2]), *(*decoded[2:], 0.0, 0.0, 0.0)[:3]
        ) == (
            struct.pack(
                '<2q3d',
                *(int(value[0]) for value in values[:2]),
                *(*(value[0] for value in values[2:]), 0.0, 0.0, 0.0)[:3],
            )
        )


@settings(max_examples=300, deadline=None)
@given(
    sec=st.integers(0, 2**32 - 1),
    nanosec=st.integers(0, 2**32 - 1),
    values=st.lists(bits, min_size=3, max_size=3),
)
def test_every_message_comes_back_to_the_last_bit(sec, nanosec, values):
    raw = LAYOUTS[0].encode(sec, nanosec, *values)
    assert LAYOUTS[0].encode(*LAYOUTS[0].decode(raw)) == raw
    assert LAYOUTS[0].fields == FIELDS


def unchecked(chunked):
    """Return a bag of another writer, without a checksum that would tell of a wrong byte."""
    stream = BytesIO()
    writer = Writer(
        stream,
        chunk_size=1024,
        use_chunking=chunked,
        enable_crcs=False,
        compression=CompressionType.NONE,
    )
    writer.start('ros2')
    schema = writer.register_schema('sensor_msgs/msg/JointState', 'ros2msg', b'')
    channels = {
        number: writer.register_channel(name, 'cdr', schema)
        for number, name in ((1, '/joint_states'), (2, '/impulse_events'), (3, '/joint_commands'))
    }
    channels[4] = writer.register_channel(
        '/run_parameters',
        'cdr',
        writer.register_schema(
            PARAMETER_EVENT, 'ros2msg', message_definition(PARAMETER_EVENT).encode()
        ),
    )
    told = [
        (
            START + at,
            4,
            encode_parameter_event(
                1,
                at,
                f'run:{RUN} {AUTHOR}',
                {'K': K, 'joint_name': 'axis', 'x': ['a', 'b']},
                changed,
            ),
        )
        for at, K, changed in ((0, 10.0, {}), (1500, 12.0, {'K': 12.0}))
    ]
    for stamp, number, raw in (*told, *entries(20)):
        writer.add_message(channels[number], stamp, raw, stamp)
    writer.finish()
    return stream.getvalue()


@pytest.fixture(scope='module', params=['none', 'zstd', 'chunks', 'plain'])
def bag(request, tmp_path_factory):
    if request.param in ('chunks', 'plain'):
        return unchecked(request.param == 'chunks')
    folder = tmp_path_factory.mktemp('bags') / 'run'
    return (finished(folder, 60, request.param) / 'run_0.mcap').read_bytes()


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_a_bag_with_wrong_bytes_is_refused_by_name_or_read(bag, tmp_path_factory, data):
    path = Path(tmp_path_factory.mktemp('mutated'), 'run_0.mcap')
    path.write_bytes(data.draw(mutated(bag)))
    said = None
    try:
        assert isinstance(read_bag(path), Recording)
    except BagError as error:
        said = str(error)
    finally:
        path.unlink()
        path.parent.rmdir()
    assert said is None or ('run_0.mcap' in said and '\n' not in said)
