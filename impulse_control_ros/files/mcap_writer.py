"""
Write an MCAP file in blocks of messages.

The records come from the mcap library. Its `Writer` needs an object and a dozen calls per message
and writes 150,000 messages/s; arrays of the headers and indexes of a whole chunk reach 1,000,000.
Schemas and channels precede the chunks, so each chunk can be read by itself. A chunk is written
once it is full and the time advances, so no two chunks overlap in time. If the disk is full, the
end of the file can be cut off again and the file finished.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
import struct
from typing import NamedTuple
import zlib

import lz4.frame
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
import zstandard

from impulse_control_ros.files.mcap_chunk import (
    Block,
    block_of,
    CHUNK_SIZE,
    first_chunk,
    Indexes,
    joined,
    records_of,
)

MAGIC = b'\x89MCAP0\r\n'
_INDEX = struct.Struct('<BQHI')
COMPRESSIONS: dict[str, tuple[str, Callable[[memoryview], bytes]]] = {
    'none': ('', bytes),
    'lz4': ('lz4', lz4.frame.compress),
    # level 3, the default, takes 50 % longer and saves 1 %
    'zstd': ('zstd', zstandard.ZstdCompressor(level=1).compress),
}


class _Written(NamedTuple):
    """A ``chunk`` in the file, its message counts by channel, and the checksum before it."""

    chunk: records.ChunkIndex
    counts: dict[int, int]
    checksum: int


def encoded(items: Iterable[records.McapRecord]) -> bytes:
    """Return the bytes of library records."""
    builder = RecordBuilder()
    for item in items:
        item.write(builder)
    return bytes(builder.end())


class McapFile:
    """
    A new file at ``path``; raises `FileExistsError` if it exists.

    ``counts`` has the number of messages in its chunks by channel. All methods raise `OSError` if
    a write fails; call `cut_back` then.
    """

    def __init__(self, path: Path, library: str, compression: str) -> None:
        self.counts: dict[int, int] = {}
        self._compression, self._compress = COMPRESSIONS[compression]
        self._schemas: dict[str, records.Schema] = {}
        self._channels: list[records.Channel] = []
        self._chunks: list[_Written] = []
        self._metadata: list[records.MetadataIndex] = []
        self._pending: list[Block] = []  # not yet in a chunk
        self._checksum = 0
        self._end = 0  # of the data that stays in the file
        self._file = path.open('xb', buffering=0)
        try:
            self._put(MAGIC + encoded([records.Header('ros2', library)]))
        except OSError:
            self._file.close()
            raise

    @property
    def count(self) -> int:
        """The number of messages."""
        return sum(self.counts.values()) + sum(len(block.start) for block in self._pending)

    @property
    def first(self) -> int:
        """The log time [ns] of the first message in a chunk, 0 if none."""
        return self._chunks[0].chunk.message_start_time if self._chunks else 0

    @property
    def last(self) -> int:
        """The log time [ns] of the last message in a chunk, 0 if none."""
        return self._chunks[-1].chunk.message_end_time if self._chunks else 0

    def _put(self, data: bytes) -> None:
        """Write a part of the data section, which ends with its checksum."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._checksum = zlib.crc32(data, self._checksum)
        self._end += len(data)

    def add_channel(self, topic: str, kind: str, definition: str, metadata: dict[str, str]) -> int:
        """Register a topic of CDR messages with its ros2msg definition; return its channel."""
        if kind not in self._schemas:
            schema = records.Schema(len(self._schemas) + 1, definition.encode(), 'ros2msg', kind)
            self._put(encoded([schema]))
            self._schemas[kind] = schema
        channel = records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding='cdr',
            schema_id=self._schemas[kind].id,
            metadata=metadata,
        )
        self._put(encoded([channel]))
        self._channels.append(channel)
        self.counts[channel.id] = 0
        return channel.id

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Store a named record of strings."""
        data = encoded([records.Metadata(name=name, metadata=values)])
        at = self._end
        self._put(data)
        self._metadata.append(records.MetadataIndex(offset=at, length=len(data), name=name))

    def write(self, messages: Iterable[tuple[int, int, bytes]]) -> None:
        """Append (publish time = log time [ns], channel, data); log times never decrease."""
        columns = tuple(zip(*messages, strict=True))
        if columns:
            self.write_block(block_of(*columns))

    def write_block(self, block: Block) -> None:
        """Append a block of messages; their headers are filled in place."""
        self._pending.append(block)
        if sum(len(block.content) for block in self._pending) > CHUNK_SIZE:
            self._write_chunks()

    def end_chunk(self) -> None:
        """Write all pending messages as chunks to the operating system."""
        self._write_chunks(everything=True)

    def _write_chunks(self, everything: bool = False) -> None:
        """Write the full chunks of the pending messages; with ``everything``, all messages."""
        if not self._pending:
            return
        block = joined(self._pending)
        while len(block.start):
            count = first_chunk(block, self.last)
            if count == len(block.start) and not everything:
                break
            chunk, block = block.split(count)
            self._put_chunk(*records_of(chunk, self.last, self.counts))
        self._pending = [block] if len(block.start) else []

    def _put_chunk(self, data: memoryview, indexes: Indexes) -> None:
        """Write records of messages as a chunk, then the ``indexes`` of its channels."""
        first = min(int(index['log_time'][0]) for index in indexes.values())
        last = max(int(index['log_time'][-1]) for index in indexes.values())
        chunk = records.Chunk(
            compression=self._compression,
            data=self._compress(data),
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        at, checksum, parts = self._end, self._checksum, [encoded([chunk])]
        end = indexes_at = at + len(parts[0])
        offsets = {}
        for channel, index in indexes.items():
            offsets[channel] = end
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + index.nbytes, channel, index.nbytes)
            parts.append(head + index.tobytes())
            end += len(parts[-1])
        self._put(b''.join(parts))
        entry = records.ChunkIndex(
            message_start_time=first,
            message_end_time=last,
            chunk_start_offset=at,
            chunk_length=len(parts[0]),
            message_index_offsets=offsets,
            message_index_length=end - indexes_at,
            compression=self._compression,
            compressed_size=len(chunk.data),
            uncompressed_size=len(data),
        )
        counts = {channel: len(index) for channel, index in indexes.items()}
        self._chunks.append(_Written(entry, counts, checksum))
        for channel, count in counts.items():
            self.counts[channel] += count

    def cut_back(self) -> bool:
        """
        Discard the messages that are in no chunk or, if there are none, the last chunk.

        The file is truncated there. Returns False if there was nothing to discard.
        """
        forgotten = bool(self._pending or self._chunks)
        if not self._pending and self._chunks:
            chunk, counts, self._checksum = self._chunks.pop()
            for channel, count in counts.items():
                self.counts[channel] -= count
            self._end = chunk.chunk_start_offset
            self._metadata = [one for one in self._metadata if one.offset < self._end]
        self._pending = []
        self._file.truncate(self._end)
        self._file.seek(self._end)
        return forgotten

    def finish(self) -> None:
        """Write the last chunk and the summary."""
        self.end_chunk()
        data_end = encoded([records.DataEnd(self._checksum)])
        statistics = records.Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={one: count for one, count in self.counts.items() if count},
            chunk_count=len(self._chunks),
            message_count=self.count,
            message_start_time=self.first,
            message_end_time=self.last,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        start, summary, offsets = self._end + len(data_end), b'', []
        groups: dict[Opcode, Sequence[records.McapRecord]] = {
            Opcode.SCHEMA: [*self._schemas.values()],
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: [written.chunk for written in self._chunks],
            Opcode.METADATA_INDEX: self._metadata,
        }
        for opcode, items in groups.items():
            if group := encoded(items):
                offsets.append(records.SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        summary += encoded(offsets)
        footer = records.Footer(start, offset_start, summary_crc=0)
        footer.summary_crc = zlib.crc32(summary + encoded([footer])[:-4])
        self._put(data_end + summary + encoded([footer]) + MAGIC)

    def close(self) -> None:
        """Close the file, finished or not."""
        self._file.close()
