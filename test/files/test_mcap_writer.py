"""Messages on their way into chunks: the arrays against a loop over the messages."""

from io import BytesIO
from pathlib import Path

from hypothesis import given, settings, strategies as st
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, Message
from mcap.stream_reader import get_chunk_data_stream, StreamReader
import pytest

from impulse_control_ros.files import mcap_chunk, mcap_writer
from impulse_control_ros.files.mcap_chunk import block_of
from impulse_control_ros.files.mcap_writer import McapFile

CHANNELS = 4
SMALL, LARGEST = 400, 800  # bytes of a chunk in these tests
HEADER = 31


def chunk_by_chunk(messages):
    """Return the chunks as lists of (channel, sequence, log time, publish time, data)."""
    chunks, size, last, counts = [[]], 0, 0, dict.fromkeys(range(1, CHANNELS + 1), 0)
    for stamp, channel, data in messages:
        whole = HEADER + len(data)
        if size > SMALL and (stamp > last or size + whole > LARGEST):
            chunks.append([])
            size = 0
        last, size = max(last, stamp), size + whole
        counts[channel] += 1
        chunks[-1].append((channel, counts[channel], last, stamp, data))
    return [chunk for chunk in chunks if chunk]


def chunks_in(path):
    with path.open('rb') as stream:
        for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
            if isinstance(record, Chunk):
                content, size = get_chunk_data_stream(record, validate_crc=True)
                yield list(messages_in(content.read(size)))


def messages_in(content):
    at = 0
    while at < len(content):
        size = int.from_bytes(content[at + 1 : at + 9], 'little')
        message = Message.read(ReadDataStream(BytesIO(content[at + 9 : at + 9 + size])), size)
        yield (
            message.channel_id,
            message.sequence,
            message.log_time,
            message.publish_time,
            message.data,
        )
        at += 9 + size


def begun(folder):
    file = McapFile(folder / 'run.mcap', 'test', 'none')
    for number in range(CHANNELS):
        file.add_channel(f'/{number}', 'std_msgs/msg/Float64', 'float64 data', {})
    return file


@settings(max_examples=150, deadline=None)
@given(
    messages=st.lists(
        st.tuples(st.integers(0, 20), st.integers(1, CHANNELS), st.integers(0, 1000)), max_size=60
    ),
    parts=st.lists(st.tuples(st.integers(1, 30), st.booleans()), min_size=60, max_size=60),
)
def test_chunks_are_the_same_however_the_messages_come(tmp_path_factory, messages, parts):
    messages = [
        (stamp, channel, bytes([k % 256]) * size)
        for k, (stamp, channel, size) in enumerate(messages)
    ]
    with pytest.MonkeyPatch.context() as patch:
        for module in (mcap_chunk, mcap_writer):
            patch.setattr(module, 'CHUNK_SIZE', SMALL)
        patch.setattr(mcap_chunk, 'LARGEST_CHUNK', LARGEST)
        folder = Path(tmp_path_factory.mktemp('chunks'))
        file, done = begun(folder), 0
        for size, in_block in parts:
            some = messages[done : done + size]
            done += len(some)
            if in_block and some:
                file.write_block(block_of(*zip(*some, strict=True)))
            else:
                file.write(iter(some))
            assert file.count == done
        file.finish()
        file.close()
    expected = chunk_by_chunk(messages)
    assert list(chunks_in(folder / 'run.mcap')) == expected
    assert sum(file.counts.values()) == len(messages)


def test_nothing_is_written_of_no_messages(tmp_path):
    file = begun(tmp_path)
    file.write([])
    file.finish()
    file.close()
    assert list(chunks_in(tmp_path / 'run.mcap')) == []


def test_what_is_kept_is_forgotten_with_its_counts(tmp_path):
    file = begun(tmp_path)
    file.write([(5, 1, b'first')])
    file.end_chunk()
    file.write([(7, 2, b'kept')])
    assert file.count == 2
    assert file.cut_back()
    assert (file.count, file.last) == (1, 5)
    assert file.cut_back()
    assert (file.count, file.last, file.counts[1]) == (0, 0, 0)
    assert not file.cut_back()
    file.close()
