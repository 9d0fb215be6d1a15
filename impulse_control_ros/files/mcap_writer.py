"""
An MCAP file, written in blocks of messages.

The records are those of the mcap library; what is ours is the way messages get into chunks. Its
`Writer` makes an object and a dozen calls for each message, which is half the cost of a recorded
10 kHz step; here the headers and the indexes of a whole block are made as arrays. Schemas and
channels stand before the chunks, so each chunk is whole by itself; a chunk goes to the operating
system once it is full and time goes on, so that no two overlap in time. What does not fit on the
disk can be cut off again, so that there is room to finish the file.
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

from impulse_control_ros.files.mcap_chunk import Block, OpenChunk

MAGIC = b'\x89MCAP0\r\n'
COMPRESSIONS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    'none': ('', bytes),
    'lz4': ('lz4', lz4.frame.compress),
    # level 3, the default, takes half as long again for 1 % less
    'zstd': ('zstd', zstandard.ZstdCompressor(level=1).compress),
}
_INDEX = struct.Struct('<BQHI')


def encoded(records: Iterable[McapRecord]) -> bytes:
    """Return the bytes of library records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


class McapFile:
    """
    A new file at ``path``; raises `FileExistsError` when there is one.

    ``first`` and ``last`` are log times [ns]. All raise `OSError` for what cannot be written;
    then `cut_back`.
    """

    def __init__(self, path: Path, library: str, compression: str) -> None:
        self.first = 0
        self._compression, self._compress = COMPRESSIONS[compression]
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._open = OpenChunk()
        self._in_chunks: list[dict[int, int]] = []  # messages by channel
        self._checksums: list[int] = []  # of what stands before each chunk
        self._checksum = 0
        self._end = 0  # of what is in the file for good
        self._file = path.open('xb', buffering=0)
        try:
            self._put(MAGIC + encoded([Header('ros2', library)]))
        except OSError:
            self._file.close()
            raise

    @property
    def counts(self) -> dict[int, int]:
        """The number of messages by channel, but for those that `write` still keeps."""
        return self._open.counts

    @property
    def count(self) -> int:
        """The number of messages."""
        return self._open.count

    @property
    def last(self) -> int:
        """The log time of the last message [ns]."""
        return self._open.last

    def _put(self, data: bytes) -> None:
        """Write a part of the data section, whose checksum stands at its end."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]
        self._checksum = zlib.crc32(data, self._checksum)
        self._end += len(data)

    def add_schema(self, name: str, text: str) -> int:
        """Register a ros2msg definition; returns its id."""
        schema = Schema(
            id=len(self._schemas) + 1, name=name, encoding='ros2msg', data=text.encode()
        )
        self._put(encoded([schema]))
        self._schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, schema: int, metadata: dict[str, str]) -> int:
        """Register a topic of CDR messages; returns its channel."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding='cdr',
            schema_id=schema,
            metadata=metadata,
        )
        self._put(encoded([channel]))
        self._channels.append(channel)
        self._open.counts[channel.id] = 0
        return channel.id

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Store a named record of strings."""
        data = encoded([Metadata(name=name, metadata=values)])
        at = self._end
        self._put(data)
        self._metadata.append(MetadataIndex(offset=at, length=len(data), name=name))

    def write(self, messages: Iterable[tuple[int, int, bytes]]) -> None:
        """Append (publish time [ns], channel, data); the log time is that, but never goes back."""
        if self._open.keep(messages):
            self._fill(self._open.add_kept())

    def write_block(self, block: Block) -> None:
        """Do `write` for a block of messages, whose headers are filled in place."""
        self._fill(self._open.add_kept())
        self._fill(self._open.add(block))

    def end_chunk(self) -> None:
        """Hand what was written to the operating system."""
        self._fill(self._open.add_kept())
        if self._open.parts:
            self._put_chunk()

    def _fill(self, chunks: Iterable[None]) -> None:
        for _ in chunks:
            self._put_chunk()

    def _put_chunk(self) -> None:
        """Write the open chunk and its message indexes, and begin another one."""
        done = self._open
        data = b''.join(done.parts)
        chunk = Chunk(
            compression=self._compression,
            data=self._compress(data),
            message_start_time=done.begins,
            message_end_time=done.last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        at, written = self._end, encoded([chunk])
        offsets, behind = {}, []
        index_at = end = at + len(written)
        for channel, index in done.indices.items():
            size = sum(map(len, index))
            offsets[channel] = end
            behind += [_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size), *index]
            end += _INDEX.size + size
        before = self._checksum
        self._put(b''.join((written, *behind)))
        self.first = self.first or done.begins
        self._chunks.append(
            ChunkIndex(
                message_start_time=done.begins,
                message_end_time=done.last,
                chunk_start_offset=at,
                chunk_length=len(written),
                message_index_offsets=offsets,
                message_index_length=end - index_at,
                compression=self._compression,
                compressed_size=len(chunk.data),
                uncompressed_size=len(data),
            )
        )
        self._in_chunks.append(done.held)
        self._checksums.append(before)
        done.clear()

    def cut_back(self) -> bool:
        """
        Forget the messages that are in no chunk, or without such the last chunk.

        What stands behind in the file goes too. Returns False when there was neither.
        """
        forgotten = self._open.forget()
        if not forgotten and self._chunks:
            forgotten, self._checksum = True, self._checksums.pop()
            for channel, count in self._in_chunks.pop().items():
                self.counts[channel] -= count
            self._end = self._chunks.pop().chunk_start_offset
            self._metadata = [index for index in self._metadata if index.offset < self._end]
        self._open.last = self._chunks[-1].message_end_time if self._chunks else 0
        self.first = self.first if self._chunks else 0
        self._file.truncate(self._end)
        self._file.seek(self._end)
        return forgotten

    def finish(self) -> None:
        """Write the last chunk and the summary."""
        self.end_chunk()
        data_end = encoded([DataEnd(self._checksum)])
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={
                channel: count for channel, count in self.counts.items() if count
            },
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()),
            message_start_time=self.first,
            message_end_time=self.last,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        start, summary, offsets = self._end + len(data_end), b'', []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata),
        ):
            group = encoded(records)
            if group:
                offsets.append(
                    SummaryOffset(
                        group_opcode=opcode,
                        group_length=len(group),
                        group_start=start + len(summary),
                    )
                )
            summary += group
        offset_start = start + len(summary)
        summary += encoded(offsets)
        footer = struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offset_start)
        self._put(
            data_end
            + summary
            + encoded(
                [
                    Footer(
                        summary_start=start,
                        summary_offset_start=offset_start,
                        summary_crc=zlib.crc32(footer, zlib.crc32(summary)),
                    )
                ]
            )
            + MAGIC
        )

    def close(self) -> None:
        """Close the file, finished or not."""
        self._file.close()
