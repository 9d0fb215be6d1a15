"""
An MCAP file, written in batches of messages.

The records are those of the mcap library; what is ours is the way messages get into chunks. Its
`Writer` makes an object and a dozen calls for each message, which is half the cost of a recorded
10 kHz step; here a message is one struct.pack, and an index one per chunk and channel. Schemas
and channels stand before the chunks, so each chunk is whole by itself; a chunk goes to the
operating system once it is full and time goes on, so that no two overlap in time. What does not
fit on the disk can be cut off again, so that there is room to finish the file.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
import struct
import zlib

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
import zstandard

MAGIC = b'\x89MCAP0\r\n'
CHUNK_SIZE = 512 * 1024
LARGEST_CHUNK = 1024 * 1024  # where time stands still
COMPRESSIONS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    'none': ('', bytes), 'lz4': ('lz4', lz4.frame.compress),
    'zstd': ('zstd', zstandard.ZstdCompressor().compress)}
_MESSAGE = struct.Struct('<BQHIQQ')
_INDEX = struct.Struct('<BQHI')
_AFTER_LENGTH = _MESSAGE.size - 9


def encoded(records: Iterable[McapRecord]) -> bytes:
    """Return the bytes of library records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


class McapFile:
    """
    A new file at ``path``; raises `FileExistsError` when there is one.

    ``counts`` has the number of messages by channel, ``first`` and ``last`` the log times [ns].
    All raise `OSError` for what cannot be written; then `cut_back`.
    """

    def __init__(self, path: Path, library: str, compression: str) -> None:
        self.counts: dict[int, int] = {}
        self.first = self.last = 0
        self._compression, self._compress = COMPRESSIONS[compression]
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._parts: list[bytes] = []
        self._indices: dict[int, list[int]] = {}
        self._size = self._checksum = 0
        self._in_chunks: list[dict[int, int]] = []
        self._checksums: list[int] = []  # of what stands before each chunk
        self._end = 0  # of what is in the file for good
        self._file = path.open('xb', buffering=0)
        try:
            self._put(MAGIC + encoded([Header('ros2', library)]))
        except OSError:
            self._file.close()
            raise

    def _put(self, data: bytes) -> None:
        """Write a part of the data section, whose checksum stands at its end."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest):]
        self._checksum = zlib.crc32(data, self._checksum)
        self._end += len(data)

    def add_schema(self, name: str, text: str) -> int:
        """Register a ros2msg definition; returns its id."""
        schema = Schema(
            id=len(self._schemas) + 1, name=name, encoding='ros2msg', data=text.encode())
        self._put(encoded([schema]))
        self._schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, schema: int, metadata: dict[str, str]) -> int:
        """Register a topic of CDR messages; returns its channel."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding='cdr', schema_id=schema,
            metadata=metadata)
        self._put(encoded([channel]))
        self._channels.append(channel)
        self.counts[channel.id] = 0
        return channel.id

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Store a named record of strings."""
        data = encoded([Metadata(name=name, metadata=values)])
        at = self._end
        self._put(data)
        self._metadata.append(MetadataIndex(offset=at, length=len(data), name=name))

    def write(self, messages: Iterable[tuple[int, int, bytes]]) -> None:
        """Append (publish time [ns], channel, data); the log time is that, but never goes back."""
        last, at, counts = self.last, self._size, self.counts
        append, pack = self._parts.append, _MESSAGE.pack
        for stamp, channel, data in messages:
            size = _MESSAGE.size + len(data)
            if at > CHUNK_SIZE and (stamp > last or at + size > LARGEST_CHUNK):
                self.last = last
                self.end_chunk()
                at, append = 0, self._parts.append
            if stamp > last:
                last = stamp
            counts[channel] = sequence = counts[channel] + 1
            append(pack(Opcode.MESSAGE, _AFTER_LENGTH + len(data), channel, sequence, last, stamp))
            append(data)
            index = self._indices.get(channel)
            if index is None:
                index = self._indices[channel] = []
            index.append(last)
            index.append(at)
            at += size
        self.last, self._size = last, at

    def end_chunk(self) -> None:
        """Hand the chunk and its message indices to the operating system."""
        if not self._parts:
            return
        data = b''.join(self._parts)
        start = min(index[0] for index in self._indices.values())
        chunk = Chunk(compression=self._compression, data=self._compress(data),
                      message_start_time=start, message_end_time=self.last,
                      uncompressed_crc=zlib.crc32(data), uncompressed_size=len(data))
        at, written = self._end, encoded([chunk])
        offsets, behind = {}, []
        index_at = end = at + len(written)
        for channel, index in self._indices.items():
            offsets[channel] = end
            behind += [_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(index), channel,
                                   8 * len(index)), struct.pack(f'<{len(index)}Q', *index)]
            end += _INDEX.size + 8 * len(index)
        before = self._checksum
        self._put(b''.join((written, *behind)))
        self.first = self.first or start
        self._chunks.append(ChunkIndex(
            message_start_time=start, message_end_time=self.last, chunk_start_offset=at,
            chunk_length=len(written), message_index_offsets=offsets,
            message_index_length=end - index_at, compression=self._compression,
            compressed_size=len(chunk.data), uncompressed_size=len(data)))
        self._in_chunks.append(self._waiting())
        self._checksums.append(before)
        self._parts, self._indices, self._size = [], {}, 0

    def _waiting(self) -> dict[int, int]:
        """Return the number of messages by channel that are in no chunk yet."""
        return {channel: len(index) // 2 for channel, index in self._indices.items()}

    def cut_back(self) -> bool:
        """
        Forget the messages that are in no chunk, or without such the last chunk.

        What stands behind in the file goes too. Returns False when there was neither.
        """
        forgotten = self._waiting()
        self._parts, self._indices, self._size = [], {}, 0
        if not forgotten and self._chunks:
            forgotten, self._checksum = self._in_chunks.pop(), self._checksums.pop()
            self._end = self._chunks.pop().chunk_start_offset
            self._metadata = [index for index in self._metadata if index.offset < self._end]
        for channel, count in forgotten.items():
            self.counts[channel] -= count
        self.last = self._chunks[-1].message_end_time if self._chunks else 0
        self.first = self.first if self._chunks else 0
        self._file.truncate(self._end)
        self._file.seek(self._end)
        return bool(forgotten)

    def finish(self) -> None:
        """Write the last chunk and the summary."""
        self.end_chunk()
        data_end = encoded([DataEnd(self._checksum)])
        statistics = Statistics(
            attachment_count=0, channel_count=len(self._channels), channel_message_counts={
                channel: count for channel, count in self.counts.items() if count},
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()), message_start_time=self.first,
            message_end_time=self.last, metadata_count=len(self._metadata),
            schema_count=len(self._schemas))
        start, summary, offsets = self._end + len(data_end), b'', []
        for opcode, records in (
                (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels),
                (Opcode.STATISTICS, [statistics]), (Opcode.CHUNK_INDEX, self._chunks),
                (Opcode.METADATA_INDEX, self._metadata)):
            group = encoded(records)
            if group:
                offsets.append(SummaryOffset(group_opcode=opcode, group_length=len(group),
                                             group_start=start + len(summary)))
            summary += group
        offset_start = start + len(summary)
        summary += encoded(offsets)
        footer = struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offset_start)
        self._put(data_end + summary + encoded([Footer(
            summary_start=start, summary_offset_start=offset_start,
            summary_crc=zlib.crc32(footer, zlib.crc32(summary)))]) + MAGIC)

    def close(self) -> None:
        """Close the file, finished or not."""
        self._file.close()
