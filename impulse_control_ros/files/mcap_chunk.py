"""
Messages on their way into a chunk of an MCAP file: their records, and their indexes.

All of it is made as arrays, for thousands of messages at once.
"""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from mcap.opcode import Opcode
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

CHUNK_SIZE = 512 * 1024
LARGEST_CHUNK = 1024 * 1024  # where time stands still
MESSAGE = np.dtype(
    [
        ('opcode', 'u1'),
        ('length', '<u8'),
        ('channel', '<u2'),
        ('sequence', '<u4'),
        ('log_time', '<u8'),
        ('publish_time', '<u8'),
    ]
)
ROOM = MESSAGE.itemsize
ENTRY = np.dtype([('log_time', '<u8'), ('place', '<u8')])
AHEAD = 9  # opcode and length, which does not count them


class Block(NamedTuple):
    """
    Messages in the order of the file.

    ``content`` has their bytes, each behind `ROOM` bytes for the header of its record, which
    begins at ``start``. ``channel`` and ``stamp``, the publish time [ns], have shape (n,) too.
    """

    content: np.ndarray
    start: np.ndarray
    channel: np.ndarray
    stamp: np.ndarray


def block_of(stamps: Iterable[int], channels: Iterable[int], data: list[bytes]) -> Block:
    """Return the block of some messages."""
    content = np.frombuffer(bytearray(ROOM).join((b'', *data)), np.uint8)
    size = np.fromiter(map(len, data), np.int64, len(data)) + ROOM
    return Block(content, size.cumsum() - size, np.array(channels), np.array(stamps))


class OpenChunk:
    """
    The chunk that grows: messages come in, and go on as records.

    ``counts`` has the number of messages by channel since the start of the file, ``begins`` and
    ``last`` are the first and the last log time [ns]. ``parts`` are its records, and ``indices``
    the entries of its message indexes by channel.
    """

    def __init__(self) -> None:
        self.counts: dict[int, int] = {}
        self.begins = self.last = 0
        self._kept: tuple[list[Any], ...] = [], [], []  # stamps, channels, data
        self._kept_size = 0
        self.clear()

    def clear(self) -> None:
        """Begin another chunk."""
        self.parts: list[memoryview] = []
        self.indices: dict[int, list[bytes]] = {}
        self._size = 0

    def keep(self, messages: Iterable[tuple[int, int, bytes]]) -> bool:
        """Take (publish time [ns], channel, data); returns whether they fill the chunk."""
        columns = tuple(zip(*messages, strict=True))
        for kept, column in zip(self._kept, columns, strict=False):
            kept.extend(column)
        if columns:
            self._kept_size += sum(map(len, columns[2])) + ROOM * len(columns[2])
        return self._size + self._kept_size > CHUNK_SIZE

    def add_kept(self) -> Iterator[None]:
        """Do `add` for the messages that were kept."""
        (stamps, channels, data), self._kept, self._kept_size = self._kept, ([], [], []), 0
        if data:
            yield from self.add(block_of(stamps, channels, data))

    def add(self, block: Block) -> Iterator[None]:
        """
        Add messages, whose headers are filled in place; the log time never goes back.

        Yields each time that the chunk is full: it is to be written, and cleared.
        """
        time = np.maximum(np.maximum.accumulate(block.stamp), self.last)
        later = np.flatnonzero(np.diff(time, prepend=self.last))
        end = np.append(block.start[1:], len(block.content))
        first, count = 0, len(time)
        while first < count:
            chunk = block.start[first] - self._size
            full = np.searchsorted(block.start, chunk + CHUNK_SIZE, 'right')
            overfull = np.searchsorted(end, chunk + LARGEST_CHUNK, 'right')
            on_time = later[np.searchsorted(later, full) :][:1]
            stop = int(min(count, max(full, overfull), *on_time))
            if first < stop:
                self._append(block, slice(first, stop), time, end)
            if stop < count:
                yield
            first = stop

    def _append(self, block: Block, part: slice, time: np.ndarray, end: np.ndarray) -> None:
        """Add a ``part`` of a block, whose messages have a log ``time`` and an ``end``."""
        start, channels, time = block.start[part], block.channel[part], time[part]
        head, place = np.empty(len(start), MESSAGE), start - start[0] + self._size
        head['opcode'], head['length'] = Opcode.MESSAGE, end[part] - start - AHEAD
        head['channel'], head['log_time'], head['publish_time'] = channels, time, block.stamp[part]
        for channel in np.flatnonzero(np.bincount(channels)).tolist():
            ours, before = np.flatnonzero(channels == channel), self.counts[channel]
            self.counts[channel] += len(ours)
            head['sequence'][ours] = np.arange(before + 1, self.counts[channel] + 1)
            entries = np.empty(len(ours), ENTRY)
            entries['log_time'], entries['place'] = time[ours], place[ours]
            self.indices.setdefault(channel, []).append(entries.tobytes())
        sliding_window_view(block.content, ROOM, writeable=True)[start] = head.view(
            np.uint8
        ).reshape(-1, ROOM)
        if not self.parts:
            self.begins = int(time[0])
        self.parts.append(block.content[start[0] : end[part.stop - 1]].data)
        self._size += len(self.parts[-1])
        self.last = int(time[-1])

    @property
    def held(self) -> dict[int, int]:
        """The number of its messages by channel."""
        return {
            channel: sum(map(len, index)) // ENTRY.itemsize
            for channel, index in self.indices.items()
        }

    @property
    def count(self) -> int:
        """The number of messages since the start of the file."""
        return sum(self.counts.values()) + len(self._kept[0])

    def forget(self) -> bool:
        """Drop the messages that are in no chunk before it; returns False where there are none."""
        dropped = bool(self.parts or self._kept[0])
        for channel, count in self.held.items():
            self.counts[channel] -= count
        self._kept, self._kept_size = ([], [], []), 0
        self.clear()
        return dropped
