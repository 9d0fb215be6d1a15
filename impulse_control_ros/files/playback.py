"""Read the messages of chosen topics of a bag in time order, for playback."""

from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Schema
import numpy as np
import yaml

from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag_reader import items
from impulse_control_ros.files.experiment import LAST_SECOND
from impulse_control_ros.files.mcap_reader import Column, Cut, Note

Message = tuple[int, str, bytes]  # log time [ns], topic, CDR
YEAR = 366 * 86_400 * SECOND


class Offer(NamedTuple):
    """What the channels of a topic tell: types, encodings, and the QoS of its publishers."""

    kinds: set[str]
    encodings: set[str]
    profiles: str

    @property
    def kind(self) -> str:
        """The type of its messages; raises `BagError` where they cannot be published."""
        if self.encodings != {'cdr'}:
            raise BagError(f'its messages are {", ".join(sorted(self.encodings))}, not cdr')
        if '' in self.kinds:
            raise BagError('its channel has no schema')
        if len(self.kinds) > 1:
            raise BagError(f'it has several types: {", ".join(sorted(self.kinds))}')
        return min(self.kinds)

    @property
    def qos(self) -> Mapping[str, Any]:
        """What the first publisher that was recorded offers; raises `BagError`."""
        try:
            offers = yaml.safe_load(self.profiles) or [{}]
            return dict(offers[0])
        except (yaml.YAMLError, LookupError, TypeError, ValueError, RecursionError):
            raise BagError('its offered_qos_profiles cannot be read') from None


def surveyed(bag: Path) -> tuple[dict[str, Offer], dict[str, list[np.ndarray]], list[str]]:
    """
    Return, by topic, what its channels tell, and the log times [ns] of its messages.

    The last are sentences on what the bag lacks.
    """
    kinds: dict[int, str] = {}
    found: dict[str, Offer] = {}
    times: dict[str, list[np.ndarray]] = {}
    lacks: list[str] = []
    for item in items(bag):
        if isinstance(item, Schema):
            kinds[item.id] = item.name
        elif isinstance(item, Channel):
            profiles = item.metadata.get('offered_qos_profiles', '')
            offer = found.setdefault(item.topic, Offer(set(), set(), profiles))
            offer.kinds.add(kinds.get(item.schema_id, ''))
            offer.encodings.add(item.message_encoding)
        elif isinstance(item, Column):
            times.setdefault(item.topic, []).append(item.time)
        elif isinstance(item, Cut):
            lacks.append(f'it was cut off; {item.unread} bytes at its end cannot be read')
        elif isinstance(item, Note):
            lacks.append(item.text)
    return found, times, lacks


def chosen(found: Mapping[str, Offer], wanted: Sequence[str] | None) -> dict[str, Offer]:
    """
    Return the topics ``wanted`` of those ``found``, or all; a slash in front does not matter.

    Raises `ParameterError` if a topic is not in the bag.
    """
    if wanted is None:
        return dict(found)
    names = {name.strip('/'): name for name in found}
    for name in wanted:
        if name.strip('/') not in names:
            raise refusal('topic', name, f'one of the bag: {", ".join(found)}')
    return {names[name.strip('/')]: found[names[name.strip('/')]] for name in wanted}


def span_of(times: Sequence[np.ndarray]) -> tuple[int, int]:
    """
    Return the first and the last [ns] of log times that are in ROS time and within a year.

    The year is that around their median: other clocks have told the rest. Raises `BagError`
    where there is none.
    """
    every = np.concatenate([np.zeros(0, np.int64), *times])
    every = every[(every >= 0) & (every < LAST_SECOND * SECOND)]
    if not len(every):
        raise BagError('no message has a log time before the year 2038')
    middle = np.partition(every, len(every) // 2)[len(every) // 2]
    near = every[np.abs(every - middle) < YEAR]
    return int(near.min()), int(near.max())


def start_of(first: int, last: int, offset: float) -> int:
    """Return the log time [ns] at which to start; raises `ParameterError` for the offset."""
    if not 0.0 <= offset <= (last - first) / SECOND:
        raise refusal('--start-offset', offset, f'in [0, {(last - first) / SECOND:g}] [s]')
    return first + round(offset * SECOND)


def in_order(bag: Path, topics: set[str], first: int, last: int) -> Iterator[Message]:
    """Yield (log time [ns], topic, bytes) of the ``first`` to the ``last`` time, by chunks."""
    chunk: list[Column] = []
    for item in items(bag):
        if isinstance(item, Column):
            if chunk and item.content is not chunk[0].content:
                yield from of_chunk(chunk, topics, first, last)
                chunk = []
            chunk.append(item)
    yield from of_chunk(chunk, topics, first, last)


def of_chunk(
    chunk: Sequence[Column], topics: set[str], first: int, last: int
) -> Iterator[Message]:
    """Yield the messages of one chunk's ``topics`` in the order of time."""
    messages = [
        (time, start, size, column)
        for column in chunk
        if column.topic in topics
        for time, start, size in zip(
            column.time.tolist(), column.start.tolist(), column.size.tolist(), strict=True
        )
        if first <= time <= last
    ]
    for time, start, size, column in sorted(messages, key=itemgetter(0, 1)):
        yield time, column.topic, column.content[start : start + size].tobytes()
