"""
The messages of an MCAP file as arrays: the library finds the chunks, a kernel walks through each.

An object for each message costs microseconds; a minute of a 10 kHz series has 1.2 million.
"""

from collections.abc import Iterator
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
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream, MAGIC_SIZE, StreamReader
import numba
import numpy as np
from zstandard import ZstdError

from impulse_control_ros.errors import BagError
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
AHEAD = 9  # opcode and length stand before each record
SCHEMA, CHANNEL, MESSAGE = int(Opcode.SCHEMA), int(Opcode.CHANNEL), int(Opcode.MESSAGE)
DATA_END, FOOTER = struct.Struct('<BQI'), struct.Struct('<QQI')
BLOCK = 2**20
HEADER = np.dtype(
    {
        'names': ['opcode', 'length', 'channel', 'log_time', 'publish_time'],
        'formats': ['u1', '<u8', '<u2', '<u8', '<u8'],
        'offsets': [0, 1, 9, 15, 23],
        'itemsize': 31,
    }
)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what the MCAP library and its codecs raise into a `BagError` that names the file."""
    try:
        yield
    except BROKEN as error:
        raise BagError(f'{path}: {str(error) or type(error).__name__}') from error


class Column(NamedTuple):
    """
    Messages of one ``topic`` in a chunk, in the order of the file.

    ``time`` is the log time and ``stamp`` the publish time [ns], shape (n,). ``same_size`` gives
    their bytes.
    """

    topic: str
    time: np.ndarray
    stamp: np.ndarray
    content: np.ndarray
    start: np.ndarray
    size: np.ndarray

    def same_size(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (which of the n, their bytes of shape (k, size)) for each size that occurs."""
        for size in np.unique(self.size):
            which = np.flatnonzero(self.size == size)
            yield which, rows_at(self.content, self.start[which], int(size))


class Cut(NamedTuple):
    """The end of a file that its writer did not finish: the bytes behind its last whole record."""

    unread: int


Item = Column | Metadata | Schema | Channel | Cut


def columns(path: Path) -> Iterator[Item]:
    """
    Yield what a file holds, of one that was cut off as far as it goes and then `Cut`.

    Raises `BagError` for what is no MCAP file, and for damage in a finished one.
    """
    with naming(path), path.open('rb') as stream:
        if stream.read(MAGIC_SIZE) != MAGIC:
            raise ValueError('this is no MCAP file')
        stream.seek(0)
        reader = make_reader(stream, validate_crcs=True)
        finished = ends_with_magic(stream)
        if finished:
            require_checksums(stream)
        summary = reader.get_summary() if finished else None
        if summary is None:
            yield from in_sequence(stream, finished)
            return
        yield from reader.iter_metadata()
        yield from summary.schemas.values()
        yield from summary.channels.values()
        topics = {number: channel.topic for number, channel in summary.channels.items()}
        for index in sorted(summary.chunk_indexes, key=lambda one: one.chunk_start_offset):
            stream.seek(index.chunk_start_offset + AHEAD)
            yield from columns_of(content_of(Chunk.read(ReadDataStream(stream))), topics)
        if not summary.chunk_indexes:
            stream.seek(MAGIC_SIZE)
            yield from columns_of(stream.read()[:-MAGIC_SIZE], topics)


def ends_with_magic(stream: IO[bytes]) -> bool:
    """Tell a file that its writer has finished."""
    stream.seek(max(MAGIC_SIZE, stream.seek(0, os.SEEK_END) - MAGIC_SIZE))
    return stream.read() == MAGIC


def require_checksums(stream: IO[bytes]) -> None:
    """Raise ValueError where a finished file is not what was written; a checksum of 0 is none."""
    footer = stream.seek(-MAGIC_SIZE - FOOTER.size, os.SEEK_END)
    summary_start, _, of_summary = FOOTER.unpack(stream.read(FOOTER.size))
    if not summary_start:
        return
    data_end = summary_start - DATA_END.size
    if not MAGIC_SIZE <= data_end < footer:
        raise ValueError('it is damaged: its footer leads nowhere')
    stream.seek(data_end)
    opcode, _, of_data = DATA_END.unpack(stream.read(DATA_END.size))
    if opcode != Opcode.DATA_END:
        raise ValueError('it is damaged: no end of data stands where its footer says')
    for start, end, expected in (
        (summary_start, footer + FOOTER.size - 4, of_summary),
        (0, data_end, of_data),
    ):
        if expected and checksum_of(stream, start, end) != expected:
            raise ValueError('it is damaged: its checksum is another')


def checksum_of(stream: IO[bytes], start: int, end: int) -> int:
    """Return the CRC-32 of the bytes from ``start`` to ``end``."""
    checksum, left = 0, end - stream.seek(start)
    while left:
        block = stream.read(min(left, BLOCK))
        checksum, left = zlib.crc32(block, checksum), left - len(block)
    return checksum


def in_sequence(stream: IO[bytes], finished: bool) -> Iterator[Item]:
    """Yield the records of a file without an index, or without an end, in their order."""
    topics: dict[int, str] = {}
    end = stream.seek(0, os.SEEK_END)
    read_to = stream.seek(0)
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                yield from columns_of(content_of(record), topics)
            elif isinstance(record, Metadata | Schema | Channel):
                yield record
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            read_to = stream.tell()
    except BROKEN:
        if finished:
            raise
    if not finished:
        yield Cut(end - read_to)


def content_of(chunk: Chunk) -> bytes:
    """Return the records of a chunk; raises ValueError where its checksum is another."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def columns_of(records: bytes, topics: dict[int, str]) -> Iterator[Column | Schema | Channel]:
    """Yield what is among ``records``; its channels are added to ``topics``."""
    content = np.frombuffer(records, np.uint8)
    others, messages, end = walk(content)
    if end != len(content):
        raise ValueError(f'a record is broken at byte {end} of {len(content)}')
    for at in others:
        kind = Schema if content[at] == SCHEMA else Channel
        record = kind.read(ReadDataStream(BytesIO(records[at + AHEAD :])))
        yield record
        if isinstance(record, Channel):
            topics[record.id] = record.topic
    headers = rows_at(content, messages, HEADER.itemsize).view(HEADER).ravel()
    for number in np.unique(headers['channel']):
        ours = headers['channel'] == number
        yield Column(
            topics[int(number)],
            headers['log_time'][ours].astype(np.int64),
            headers['publish_time'][ours].astype(np.int64),
            content,
            messages[ours] + HEADER.itemsize,
            headers['length'][ours].astype(np.int64) + AHEAD - HEADER.itemsize,
        )


def rows_at(content: np.ndarray, start: np.ndarray, size: int) -> np.ndarray:
    """Return ``size`` bytes from each ``start``, shape (n, size)."""
    if not start.size:
        return np.zeros((0, size), np.uint8)
    return np.lib.stride_tricks.sliding_window_view(content, size)[start]


@numba.njit(cache=True)
def walk(content: Any) -> Any:
    """Return where schemas and channels start, where messages, and where the last record ends."""
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
