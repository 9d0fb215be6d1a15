"""Read the messages of chosen topics of a bag in time order, for playback."""

from collections.abc import Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
import yaml

from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag_reader import items
from impulse_control_ros.files.mcap_reader import Column

Message = tuple[int, str, bytes]  # log time [ns], topic, CDR
Offers = dict[str, tuple[str, dict[str, Any]]]  # type and offered quality of service
Spans = dict[str, tuple[int, int]]


def surveyed(bag: Path) -> tuple[Offers, Spans]:
    """Return, by topic, type and quality of service, and the first and last log time [ns]."""
    kinds: dict[int, str] = {}
    found: Offers = {}
    spans: Spans = {}
    for item in items(bag):
        if isinstance(item, Schema):
            kinds[item.id] = item.name
        elif isinstance(item, Channel):
            found[item.topic] = kinds.get(item.schema_id, ''), offered_by(item)
        elif isinstance(item, Column):
            first, last = int(item.time.min()), int(item.time.max())
            before = spans.get(item.topic, (first, last))
            spans[item.topic] = min(before[0], first), max(before[1], last)
    return found, spans


def chosen(found: Offers, wanted: Sequence[str] | None) -> Offers:
    """
    Return the ``wanted`` topics among those ``found``, or all.

    Raises `ParameterError` if a topic is not in the bag.
    """
    if wanted is None:
        return found
    names = [f'/{name.lstrip("/")}' for name in wanted]
    for name in names:
        if name not in found:
            raise refusal('topic', name, f'one of the bag: {", ".join(found)}')
    return {name: found[name] for name in names}


def offered_by(channel: Channel) -> dict[str, Any]:
    """Return the QoS that the first recorded publisher offers; raises `BagError`."""
    try:
        offers = yaml.safe_load(channel.metadata.get('offered_qos_profiles', '')) or [{}]
        return dict(offers[0])
    except (yaml.YAMLError, LookupError, TypeError, ValueError, AttributeError):
        raise BagError(f'offered_qos_profiles of {channel.topic} cannot be read') from None


def start_of(spans: Sequence[tuple[int, int]], offset: float) -> int:
    """Return the log time [ns] to start at; raises `ParameterError` for an invalid offset."""
    first, last = min(first for first, _ in spans), max(last for _, last in spans)
    if not 0.0 <= offset <= (last - first) / SECOND:
        raise refusal('--start-offset', offset, f'in [0, {(last - first) / SECOND:g}] [s]')
    return first + round(offset * SECOND)


def in_order(bag: Path, topics: set[str], start_ns: int) -> Iterator[Message]:
    """Yield (log time [ns], topic, bytes) from ``start_ns`` on, chunk by chunk."""
    chunk: list[Column] = []
    for item in items(bag):
        if isinstance(item, Column):
            if chunk and item.content is not chunk[0].content:
                yield from of_chunk(chunk, topics, start_ns)
                chunk = []
            chunk.append(item)
    yield from of_chunk(chunk, topics, start_ns)


def of_chunk(chunk: Sequence[Column], topics: set[str], start_ns: int) -> Iterator[Message]:
    """Yield the messages of one chunk on ``topics``, in time order."""
    messages = [
        (time, start, size, column)
        for column in chunk
        if column.topic in topics
        for time, start, size in zip(
            column.time.tolist(), column.start.tolist(), column.size.tolist(), strict=True
        )
        if time >= start_ns
    ]
    for time, start, size, column in sorted(messages, key=itemgetter(0, 1)):
        yield time, column.topic, column.content[start : start + size].tobytes()
