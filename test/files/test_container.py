"""The MCAP files of real runs, record by record: what the indexes say against what is there."""

from collections import Counter
from io import BytesIO
import itertools
import zlib

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import get_chunk_data_stream
import pytest

MAGIC = b'\x89MCAP0\r\n'
AHEAD = 9  # opcode and length stand before each record
KINDS = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
}


def records_in(content, at, end):
    """Yield (place, record, place behind it) of what stands there, to the last byte."""
    while at < end:
        size = int.from_bytes(content[at + 1 : at + AHEAD], 'little')
        body = content[at + AHEAD : at + AHEAD + size]
        stream = ReadDataStream(BytesIO(body))
        behind = at + AHEAD + size
        yield (
            at,
            (
                Message.read(stream, size)
                if content[at] == Opcode.MESSAGE
                else KINDS[Opcode(content[at])].read(stream)
            ),
            behind,
        )
        at = behind
    assert at == end


def of(kind, records):
    return [record for _, record, _ in records if type(record) is kind]


@pytest.fixture(scope='module', params=['underdamped', 'left'])
def path(request, recorded):
    return recorded / request.param / f'{request.param}_0.mcap'


@pytest.fixture(scope='module')
def content(path):
    return path.read_bytes()


@pytest.fixture(scope='module')
def records(content):
    return list(records_in(content, len(MAGIC), len(content) - len(MAGIC)))


@pytest.fixture(scope='module')
def data(records):
    """Return the records before the summary."""
    return [item for item in records if item[0] < of(Footer, records)[0].summary_start]


@pytest.fixture(scope='module')
def summary(records):
    return [item for item in records if item[0] >= of(Footer, records)[0].summary_start]


@pytest.fixture(scope='module')
def messages(data):
    """Return the messages of each chunk, its checksum verified."""
    found = []
    for chunk in of(Chunk, data):
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        assert chunk.uncompressed_crc
        assert size == chunk.uncompressed_size
        found.append([(at, record) for at, record, _ in records_in(stream.read(size), 0, size)])
    return found


def test_a_file_starts_and_ends_as_one_of_ros_2(content, records, data):
    assert content.startswith(MAGIC)
    assert content.endswith(MAGIC)
    header, footer = records[0][1], records[-1][1]
    assert header.profile == 'ros2'
    assert header.library.startswith('impulse_control_ros ')
    end, last, _ = data[-1]
    assert last == DataEnd(zlib.crc32(content[:end]))
    # the checksum covers the summary, and the footer up to the checksum
    assert footer.summary_crc == zlib.crc32(content[footer.summary_start : -len(MAGIC) - 4])


def test_a_chunk_index_says_what_its_chunk_is(data, summary, messages):
    behind = {at: (record, end) for at, record, end in data}
    indexes = of(ChunkIndex, summary)
    assert [index.chunk_start_offset for index in indexes] == [
        at for at, record, _ in data if type(record) is Chunk
    ]
    for index, inside in zip(indexes, messages, strict=True):
        chunk, end = behind[index.chunk_start_offset]
        times = [message.log_time for _, message in inside]
        assert index.chunk_length == end - index.chunk_start_offset
        assert (
            (index.message_start_time, index.message_end_time)
            == (min(times), max(times))
            == (chunk.message_start_time, chunk.message_end_time)
        )
        assert (index.compression, index.compressed_size, index.uncompressed_size) == (
            chunk.compression,
            len(chunk.data),
            chunk.uncompressed_size,
        )


def test_message_indexes_lead_to_every_message_and_to_nothing_else(data, summary, messages):
    behind = {at: (record, end) for at, record, end in data}
    for index, inside in zip(of(ChunkIndex, summary), messages, strict=True):
        start = at = behind[index.chunk_start_offset][1]
        listed = []
        for channel, offset in index.message_index_offsets.items():
            assert offset == at
            record, at = behind[offset]
            assert record.channel_id == channel
            assert record.records == sorted(record.records)
            listed += [(place, time, channel) for time, place in record.records]
        assert at - start == index.message_index_length
        assert sorted(listed) == [
            (place, message.log_time, message.channel_id) for place, message in inside
        ]
    linked = sum(len(index.message_index_offsets) for index in of(ChunkIndex, summary))
    assert linked == len(of(MessageIndex, data))


def test_log_times_never_go_back_and_each_channel_is_numbered(messages):
    inside = [message for chunk in messages for _, message in chunk]
    assert all(before.log_time <= after.log_time for before, after in itertools.pairwise(inside))
    numbered = Counter()
    for message in inside:
        numbered[message.channel_id] += 1
        assert message.sequence == numbered[message.channel_id]


def test_the_statistics_are_those_of_a_count(data, summary, messages):
    inside = [message for chunk in messages for _, message in chunk]
    (statistics,) = of(Statistics, summary)
    assert statistics == Statistics(
        message_count=len(inside),
        schema_count=len(of(Schema, data)),
        channel_count=len(of(Channel, data)),
        attachment_count=0,
        metadata_count=len(of(Metadata, data)),
        chunk_count=len(of(Chunk, data)),
        message_start_time=min(message.log_time for message in inside),
        message_end_time=max(message.log_time for message in inside),
        channel_message_counts=Counter(message.channel_id for message in inside),
    )


def test_the_metadata_index_leads_to_each_record_of_metadata(data, summary):
    assert [
        (index.offset, index.offset + index.length, index.name)
        for index in of(MetadataIndex, summary)
    ] == [(at, end, record.name) for at, record, end in data if type(record) is Metadata]


def test_summary_offsets_lead_to_the_whole_summary_by_kind(content, records, summary):
    footer, at = records[-1][1], records[-1][1].summary_start
    for group in of(SummaryOffset, summary):
        assert group.group_start == at
        at += group.group_length
        assert {content[place] for place, _, _ in records_in(content, group.group_start, at)} == {
            group.group_opcode
        }
    assert at == footer.summary_offset_start


def test_schemas_and_channels_stand_before_their_messages_and_in_the_summary(data, summary):
    known = set()
    for _, record, _ in data:
        if type(record) is Schema:
            assert record.id not in known
            known.add(record.id)
        elif type(record) is Channel:
            assert record.schema_id in known
    for kind in (Schema, Channel):
        assert of(kind, data) == of(kind, summary)
    channels = {record.id: at for at, record, _ in data if type(record) is Channel}
    for at, record, _ in data:
        if type(record) is MessageIndex:
            assert channels[record.channel_id] < at


def test_the_mcap_reader_finds_the_same_by_the_index_and_without(path, messages):
    inside = [message for chunk in messages for _, message in chunk]
    with path.open('rb') as stream:
        by_index = [
            message
            for _, _, message in make_reader(stream, validate_crcs=True).iter_messages(
                log_time_order=True
            )
        ]
    assert by_index == inside
