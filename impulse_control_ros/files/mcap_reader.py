"""
Read the messages of an MCAP file as arrays: the library parses chunks, a kernel walks each.

An object per message costs microseconds, and a minute of a 10 kHz run has 1.2 million messages.
The file is read record by record, so chunks, indexes and a summary are optional.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
import os
from pathlib import Path
import struct
from typing import Any, IO, NamedTuple
import zlib

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
import numpy as np
from zstandard import ZstdDecompressor, ZstdError

from impulse_control_ros.core.jit import kernel
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.mcap_chunk import AHEAD, MESSAGE as HEADER, ROOM
from impulse_control_ros.files.mcap_writer import MAGIC

BROKEN = (
    McapError,
    OSError,
    ValueError,
    RuntimeError,
    LookupError,
    MemoryError,
    OverflowError,
    struct.error,
    ZstdError,
)
HEAD = struct.Struct('<BQ')  # opcode and length
ZSTD = b'\x28\xb5\x2f\xfd'  # begins a zstd frame; CDR begins with a zero
COMPRESSIONS = ('', 'lz4', 'zstd')
SCHEMA, CHANNEL, MESSAGE = int(Opcode.SCHEMA), int(Opcode.CHANNEL), int(Opcode.MESSAGE)
KINDS: dict[int, Any] = {
    SCHEMA: Schema,
    CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.CHUNK: Chunk,
}


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn exceptions of the MCAP library and its codecs into a `BagError` that names the file."""
    try:
        yield
    except BROKEN as error:
        raise BagError(f'{path}: {str(error) or type(error).__name__}') from error


class Column(NamedTuple):
    """
    Messages of one ``topic`` in a chunk, in the order of the file.

    ``time`` is the log time and ``stamp`` the publish time [ns], shape (n,). ``same_size`` yields
    their bytes.
    """

    topic: str
    time: np.ndarray
    stamp: np.ndarray
    content: np.ndarray
    start: np.ndarray
    size: np.ndarray

    def same_size(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (indices of messages, their bytes of shape (k, size)) for each size."""
        for size in np.unique(self.size):
            which = np.flatnonzero(self.size == size)
            yield which, rows_at(self.content, self.start[which], int(size))


class Cut(NamedTuple):
    """The end of an unfinished file; ``unread`` counts the bytes after the last whole record."""

    unread: int


class Note(NamedTuple):
    """A sentence about something that a bag lacks."""

    text: str


Item = Column | Metadata | Schema | Channel | Cut | Note


def columns(path: Path) -> Iterator[Item]:
    """
    Yield the contents of an MCAP file; an unfinished file ends with a `Cut`.

    Raises `BagError` if a finished file is damaged.
    """
    with naming(path), path.open('rb') as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(len(MAGIC), size - len(MAGIC)))
        finished = stream.read() == MAGIC
        read_to = stream.seek(len(MAGIC))
        topics: dict[int, str] = {}
        loose = bytearray()  # messages in no chunk
        try:
            for opcode, record in records_in(stream, size - len(MAGIC) * finished):
                if opcode == MESSAGE:
                    loose += record
                else:
                    yield from columns_of(bytes(loose), topics)
                    loose.clear()
                    yield from items_of(opcode, record, topics)
                read_to += len(record)
        except NotImplementedError as error:
            raise BagError(f'{path}: {error}') from error
        except BROKEN as error:
            if finished:
                reason = str(error) or type(error).__name__
                raise ValueError(f'it is damaged: {reason}') from error
        if not finished:
            yield from columns_of(bytes(loose), topics)
            yield Cut(size - read_to)


def records_in(stream: IO[bytes], end: int) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, record); raises ValueError for a broken record and for a wrong checksum."""
    at, checksum = stream.tell(), zlib.crc32(MAGIC)
    while at < end:
        record = stream.read(AHEAD)
        opcode, length = HEAD.unpack(record)
        if length > end - at - AHEAD:
            raise ValueError(f'a record is broken at byte {at} of {end}')
        record += stream.read(length)
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            if opcode == Opcode.FOOTER:
                checksum = zlib.crc32(record[:-4], checksum)
            # 0 means no checksum
            if int.from_bytes(record[-4:], 'little') not in (0, checksum):
                raise ValueError(f'the checksum at byte {at} is another')
            checksum = 0
        else:
            checksum = zlib.crc32(record, checksum)
        yield opcode, record
        at += len(record)


def items_of(opcode: int, record: bytes, topics: dict[int, str]) -> Iterator[Item]:
    """Yield the contents of a record that the reader uses; a channel is added to ``topics``."""
    if opcode not in KINDS:
        return
    item = KINDS[opcode].read(ReadDataStream(BytesIO(record[AHEAD:])))
    if isinstance(item, Chunk):
        if item.compression not in COMPRESSIONS:
            raise NotImplementedError(
                f'chunks compressed with {item.compression!r} cannot be read; '
                f'known are {", ".join(COMPRESSIONS[1:])}'
            )
        content, length = get_chunk_data_stream(item, validate_crc=True)
        yield from columns_of(content.read(length), topics)
        return
    if isinstance(item, Channel):
        topics[item.id] = item.topic
    yield item


def columns_of(records: bytes, topics: dict[int, str]) -> Iterator[Item]:
    """Yield the contents of ``records``; channels are added to ``topics``."""
    content = np.frombuffer(records, np.uint8)
    others, messages, end = walk(content)
    if end != len(content):
        raise ValueError(f'a record is broken at byte {end} of {len(content)}')
    for at in others.tolist():
        yield from items_of(records[at], records[at:], topics)
    headers = rows_at(content, messages, ROOM).view(HEADER).ravel()
    yield from by_topic(
        topics,
        headers['channel'],
        headers['log_time'].astype(np.int64),
        headers['publish_time'].astype(np.int64),
        content,
        messages + ROOM,
        headers['length'].astype(np.int64) + AHEAD - ROOM,
    )


def by_topic(
    topics: Mapping[int, str],
    channel: np.ndarray,
    time: np.ndarray,
    stamp: np.ndarray,
    content: np.ndarray,
    start: np.ndarray,
    size: np.ndarray,
) -> Iterator[Column]:
    """
    Yield the columns of n messages in ``content``; the other arrays have shape (n,).

    Raises ValueError if a channel is not among the ``topics``.
    """
    numbers = np.unique(channel).tolist()
    if unknown := [number for number in numbers if number not in topics]:
        raise ValueError(
            f'messages are on channel {unknown[0]}, which nothing before them defines'
        )
    packed = np.flatnonzero(size >= len(ZSTD))
    heads = rows_at(content, start[packed], len(ZSTD))
    packed = packed[(heads == np.frombuffer(ZSTD, np.uint8)).all(axis=1)]
    if len(packed):  # rosbag2 can compress each message
        content, start, size = unpacked(content, start, size, {*packed.tolist()})
    for number in numbers:
        ours = channel == number
        yield Column(topics[number], time[ours], stamp[ours], content, start[ours], size[ours])


def unpacked(
    content: np.ndarray, start: np.ndarray, size: np.ndarray, packed: set[int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return content, start and size after decompressing the ``packed`` messages with zstd."""
    messages = [
        content[at : at + length].tobytes() for at, length in zip(start, size, strict=True)
    ]
    for number in packed:
        messages[number] = ZstdDecompressor().decompressobj().decompress(messages[number])
    size = np.fromiter(map(len, messages), np.int64, len(messages))
    return np.frombuffer(b''.join(messages), np.uint8), size.cumsum() - size, size


def rows_at(content: np.ndarray, start: np.ndarray, size: int) -> np.ndarray:
    """Return ``size`` bytes from each ``start``, shape (n, size)."""
    if not start.size:
        return np.zeros((0, size), np.uint8)
    return np.lib.stride_tricks.sliding_window_view(content, size)[start]


@kernel()
def walk(content: Any) -> Any:
    """Return the starts of schemas and channels, the starts of messages, and the last end."""
    most = len(content) // AHEAD
    others, messages = np.empty(most, np.int64), np.empty(most, np.int64)
    other = message = at = 0
    while at + AHEAD <= len(content):
        length = 0
        for i in range(8):
            length += int(content[at + 1 + i]) << (8 * i)
        if not 0 <= length <= len(content) - at - AHEAD:
            break
        if content[at] == MESSAGE:
            messages[message] = at
            message += 1
        elif content[at] in (SCHEMA, CHANNEL):
            others[other] = at
            other += 1
        at += AHEAD + length
    return others[:other], messages[:message], at
