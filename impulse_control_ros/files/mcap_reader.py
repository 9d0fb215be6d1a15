"""
The messages of an MCAP file as arrays: the library parses the chunks, a kernel goes through each.

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
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
import numpy as np
from zstandard import ZstdError

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
SCHEMA, CHANNEL, MESSAGE = int(Opcode.SCHEMA), int(Opcode.CHANNEL), int(Opcode.MESSAGE)
KINDS: dict[int, Any] = {
    SCHEMA: Schema,
    CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.CHUNK: Chunk,
}


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


def storage_file(bag: str | Path) -> Path:
    """Return the MCAP file of a bag folder, or the file itself; raises `BagError`."""
    if why_not := obstacle(Path(bag)):
        raise BagError(why_not)
    return mcap_files(Path(bag))[0]


def obstacle(bag: Path) -> str:
    """Return why `columns` cannot read a bag, '' if it can: it must be, or have, one MCAP file."""
    if not bag.exists():
        return f'bag {str(bag)!r} does not exist'
    files = mcap_files(bag)
    if len(files) != 1:
        return f'bag {str(bag)!r} has {len(files)} .mcap files; 1 is expected'
    with naming(files[0]), files[0].open('rb') as stream:
        return '' if stream.read(len(MAGIC)) == MAGIC else f'{files[0]}: this is no MCAP file'


def mcap_files(bag: Path) -> list[Path]:
    """Return the MCAP files of a bag: a folder, or a file."""
    return [bag] if bag.is_file() else sorted(bag.glob('*.mcap'))


def columns(path: Path) -> Iterator[Item]:
    """
    Yield what a `storage_file` holds, of one that was cut off as far as it goes and then `Cut`.

    Raises `BagError` for damage in a finished one.
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
            # 0 is no checksum
            if int.from_bytes(record[-4:], 'little') not in (0, checksum):
                raise ValueError(f'the checksum at byte {at} is another')
            checksum = 0
        else:
            checksum = zlib.crc32(record, checksum)
        yield opcode, record
        at += len(record)


def items_of(opcode: int, record: bytes, topics: dict[int, str]) -> Iterator[Item]:
    """Yield what a record holds, if it is of use; a channel is added to ``topics``."""
    if opcode not in KINDS:
        return
    item = KINDS[opcode].read(ReadDataStream(BytesIO(record[AHEAD:])))
    if isinstance(item, Chunk):
        content, length = get_chunk_data_stream(item, validate_crc=True)
        yield from columns_of(content.read(length), topics)
        return
    if isinstance(item, Channel):
        topics[item.id] = item.topic
    yield item


def columns_of(records: bytes, topics: dict[int, str]) -> Iterator[Item]:
    """Yield what is among ``records``; its channels are added to ``topics``."""
    content = np.frombuffer(records, np.uint8)
    others, messages, end = walk(content)
    if end != len(content):
        raise ValueError(f'a record is broken at byte {end} of {len(content)}')
    for at in others.tolist():
        yield from items_of(records[at], records[at:], topics)
    headers = rows_at(content, messages, ROOM).view(HEADER).ravel()
    for number in np.unique(headers['channel']):
        ours = headers['channel'] == number
        yield Column(
            topics[int(number)],
            headers['log_time'][ours].astype(np.int64),
            headers['publish_time'][ours].astype(np.int64),
            content,
            messages[ours] + ROOM,
            headers['length'][ours].astype(np.int64) + AHEAD - ROOM,
        )


def rows_at(content: np.ndarray, start: np.ndarray, size: int) -> np.ndarray:
    """Return ``size`` bytes from each ``start``, shape (n, size)."""
    if not start.size:
        return np.zeros((0, size), np.uint8)
    return np.lib.stride_tricks.sliding_window_view(content, size)[start]


@kernel()
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
