"""The messages of an MCAP chunk as arrays: its end, its records and its indexes."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from mcap.opcode import Opcode
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

AHEAD = 9  # bytes of opcode and length before each record
CHUNK_SIZE = 512 * 1024
LARGEST_CHUNK = 1024 * 1024  # if the time does not advance
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
Indexes = Mapping[int, np.ndarray]  # of dtype ENTRY, by channel


class Block(NamedTuple):
    """
    Messages in the order of the file.

    ``content`` has their bytes, each after `ROOM` bytes for the header of its record. ``start``,
    where each record begins, ``channel`` and ``stamp``, the publish time [ns], have shape (n,).
    """

    content: np.ndarray
    start: np.ndarray
    channel: np.ndarray
    stamp: np.ndarray

    def split(self, count: int) -> tuple['Block', 'Block']:
        """Return the first ``count`` messages and the rest."""
        end = self.start[count] if count < len(self.start) else len(self.content)
        return (
            Block(self.content[:end], *(column[:count] for column in self[1:])),
            Block(
                self.content[end:],
                self.start[count:] - end,
                self.channel[count:],
                self.stamp[count:],
            ),
        )


def block_of(stamps: Sequence[int], channels: Sequence[int], data: Sequence[bytes]) -> Block:
    """Return the block of some messages."""
    content = np.frombuffer(bytearray(ROOM).join((b'', *data)), np.uint8)
    size = np.fromiter(map(len, data), np.int64, len(data)) + ROOM
    return Block(content, size.cumsum() - size, np.array(channels), np.array(stamps))


def joined(blocks: Sequence[Block]) -> Block:
    """Return several blocks as one."""
    if len(blocks) == 1:
        return blocks[0]
    contents, starts, channels, stamps = zip(*blocks, strict=True)
    before = np.cumsum([0, *map(len, contents[:-1])])
    starts = tuple(start + shift for start, shift in zip(starts, before, strict=True))
    return Block(*map(np.concatenate, (contents, starts, channels, stamps)))


def first_chunk(block: Block, last: int) -> int:
    """
    Return how many messages of a block belong to its first chunk, at most all.

    The chunk ends once it has `CHUNK_SIZE` and the time advances, at the latest before
    `LARGEST_CHUNK`. ``last`` is the log time [ns] before the chunk.
    """
    full, most = np.searchsorted(block.start, (CHUNK_SIZE, LARGEST_CHUNK), 'right').tolist()
    if len(block.content) > LARGEST_CHUNK:
        most = max(full, most - 1)
    later = np.flatnonzero(block.stamp[full:most] > max(last, int(block.stamp[:full].max())))
    return int(full + later[0]) if later.size else int(most)


def records_of(chunk: Block, last: int, counts: Mapping[int, int]) -> tuple[memoryview, Indexes]:
    """
    Return the records of a chunk, and the index of each channel in it.

    ``last`` is the log time [ns] and ``counts`` the messages by channel before the chunk.
    """
    start, channels = chunk.start, chunk.channel
    head, time = np.empty(len(start), MESSAGE), np.maximum.accumulate(chunk.stamp)
    head['opcode'] = Opcode.MESSAGE
    head['length'] = np.diff(start, append=len(chunk.content)) - AHEAD
    head['channel'], head['publish_time'] = channels, chunk.stamp
    head['log_time'] = np.maximum(time, last)
    indexes = {}
    for channel in np.flatnonzero(np.bincount(channels)).tolist():
        ours = np.flatnonzero(channels == channel)
        head['sequence'][ours] = np.arange(1, len(ours) + 1) + counts[channel]
        indexes[channel] = np.empty(len(ours), ENTRY)
        indexes[channel]['log_time'] = head['log_time'][ours]
        indexes[channel]['place'] = start[ours]
    places = sliding_window_view(chunk.content, ROOM, writeable=True)
    places[start] = head.view(np.uint8).reshape(-1, ROOM)
    return chunk.content.data, indexes
