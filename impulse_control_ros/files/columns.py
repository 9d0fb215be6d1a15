"""
The messages of an MCAP file as arrays: the library finds the chunks, a kernel walks through each.

An object for each message costs microseconds; a minute of a 10 kHz series has 1.2 million.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
import struct
from typing import Any, IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream, MAGIC_SIZE, StreamReader
import numba
import numpy as np
from zstandard import ZstdError

BROKEN = (McapError, OSError, ValueError, RuntimeError, struct.error, ZstdError)
AHEAD = 9  # opcode and length stand before each record
CHANNEL, MESSAGE = int(Opcode.CHANNEL), int(Opcode.MESSAGE)
HEADER = np.dtype({'names': ['opcode', 'length', 'channel', 'log_time', 'publish_time'],
                   'formats': ['u1', '<u8', '<u2', '<u8', '<u8'],
                   'offsets': [0, 1, 9, 15, 23], 'itemsize': 31})


class BagError(Exception):
    """A bag that cannot be written or read; the message names the path and the reason."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what the MCAP library and its codecs raise into a `BagError` that names the file."""
    try:
        yield
    except BROKEN as error:
        raise BagError(f'{path}: {error or type(error).__name__}') from error


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


def columns(path: Path) -> Iterator[Column | Metadata | Schema | Channel]:
    """
    Yield what a file holds, of one that was cut off as far as it goes.

    Raises `BagError` for what is no MCAP file, and for damage in a finished one.
    """
    with path.open('rb') as stream, naming(path):
        reader = make_reader(stream, validate_crcs=True)
        try:
            summary = reader.get_summary()
        except BROKEN:  # what stands at the end is no footer
            summary = None
        if summary is None:
            stream.seek(0)
            yield from columns_up_to_the_cut(stream)
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


def columns_up_to_the_cut(stream: IO[bytes]
                          ) -> Iterator[Column | Metadata | Schema | Channel]:
    """Yield what stands before the first incomplete record or damaged chunk, in its order."""
    topics: dict[int, str] = {}
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
                yield record
            elif isinstance(record, Chunk):
                yield from columns_of(content_of(record), topics)
            elif isinstance(record, (Metadata, Schema)):
                yield record
    except BROKEN:
        return


def content_of(chunk: Chunk) -> bytes:
    """Return the records of a chunk; raises ValueError where its checksum is another."""
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def columns_of(records: bytes, topics: dict[int, str]) -> Iterator[Column]:
    """Yield the messages among ``records``; channels are added to ``topics``."""
    content = np.frombuffer(records, np.uint8)
    channels, messages, end = walk(content)
    if end != len(content):
        raise ValueError(f'a record is broken at byte {end} of {len(content)}')
    for at in channels:
        channel = Channel.read(ReadDataStream(BytesIO(records[at + AHEAD:])))
        topics[channel.id] = channel.topic
    headers = rows_at(content, messages, HEADER.itemsize).view(HEADER).ravel()
    for number in np.unique(headers['channel']):
        ours = headers['channel'] == number
        yield Column(topics[int(number)], headers['log_time'][ours].astype(np.int64),
                     headers['publish_time'][ours].astype(np.int64), content,
                     messages[ours] + HEADER.itemsize,
                     headers['length'][ours].astype(np.int64) + AHEAD - HEADER.itemsize)


def rows_at(content: np.ndarray, start: np.ndarray, size: int) -> np.ndarray:
    """Return ``size`` bytes from each ``start``, shape (n, size)."""
    if not start.size:
        return np.zeros((0, size), np.uint8)
    return np.lib.stride_tricks.sliding_window_view(content, size)[start]


@numba.njit(cache=True)
def walk(content: Any) -> Any:
    """Return where channels and messages start, and where the last whole record ends."""
    most = len(content) // AHEAD
    channels, messages = np.empty(most, np.int64), np.empty(most, np.int64)
    channel = message = at = 0
    while at + AHEAD <= len(content):
        length = 0
        for i in range(8):
            length += int(content[at + 1 + i]) << (8 * i)
        if not 0 <= length <= len(content) - at - AHEAD:
            break
        if content[at] == MESSAGE:
            messages[message] = at
            message += 1
        elif content[at] == CHANNEL:
            channels[channel] = at
            channel += 1
        at += AHEAD + length
    return channels[:channel], messages[:message], at
