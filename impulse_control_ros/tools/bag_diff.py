"""Two runs of messages, compared bit by bit and told in words."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.tick import seconds

SHOWN = 5


@dataclass(frozen=True, kw_only=True)
class Difference:
    """
    What differs between the ``recorded`` messages of a topic and the ``replayed`` ones.

    Both are rows of one dtype with a stamp [ns], in its order; ``common`` holds the stamps that
    both have, ``differing`` those of them whose rows are not the same bits, ``gone`` the stamps
    of what is recorded only, ``new`` of what is replayed only.
    """

    recorded: np.ndarray
    replayed: np.ndarray
    common: np.ndarray
    differing: np.ndarray
    gone: np.ndarray
    new: np.ndarray


def difference(recorded: np.ndarray, replayed: np.ndarray) -> Difference:
    """Compare rows of one dtype; of several recorded with one stamp the last counts."""
    _, last = np.unique(recorded['stamp'][::-1], return_index=True)
    recorded = recorded[len(recorded) - 1 - last]
    common, ours, theirs = np.intersect1d(
        recorded['stamp'], replayed['stamp'], assume_unique=True, return_indices=True
    )
    same = np.ones(len(common), bool)
    for name in recorded.dtype.names or ():
        same &= bits(recorded[name][ours]) == bits(replayed[name][theirs])
    return Difference(
        recorded=recorded,
        replayed=replayed,
        common=common,
        differing=common[~same],
        gone=np.setdiff1d(recorded['stamp'], common),
        new=np.setdiff1d(replayed['stamp'], common),
    )


def bits(values: np.ndarray) -> np.ndarray:
    """Return values by which equal bits are equal, also of NaN, and -0 is not 0."""
    return np.ascontiguousarray(values).view(f'u{values.dtype.itemsize}')


def row_at(rows: np.ndarray, stamp: int) -> dict[str, Any]:
    """Return the row with this stamp by its names, without the stamp."""
    row = rows[int(np.searchsorted(rows['stamp'], stamp))]
    return {name: row[name].item() for name in rows.dtype.names or () if name != 'stamp'}


def lines_of(found: Mapping[str, Difference]) -> Iterator[str]:
    """Yield what to print about the differences by topic."""
    for topic, one in found.items():
        line = f'{topic:<16}{len(one.common):>9} compared, {len(one.differing)} differ'
        yield line + ''.join(
            f', {len(stamps)} only {where}'
            for stamps, where in ((one.gone, 'recorded'), (one.new, 'replayed'))
            if len(stamps)
        )
    for topic, one in found.items():
        if len(one.differing):
            yield first_line(topic, one)
    if len(found['joint_commands'].differing):
        yield effort_line(found['joint_commands'])
    events = found['impulse_events']
    if len(events.differing) + len(events.gone) + len(events.new):
        yield from event_lines('guard', 'impulses', GUARDS, events)
        yield from event_lines('verdict', 'verdicts', VERDICTS, events)


def same(found: Mapping[str, Difference]) -> bool:
    """
    Tell whether every message of the bag is what the replay says.

    What the bag lacks is no difference: a recorder counts it as missing. But an impulse is one
    where its command is there, for it is sent first.
    """
    unheard = np.intersect1d(found['impulse_events'].new, found['joint_commands'].common)
    return not len(unheard) and not any(
        len(one.differing) + len(one.gone) for one in found.values()
    )


def first_line(topic: str, found: Difference) -> str:
    """Return a line for the first message that differs."""
    stamp = int(found.differing[0])
    recorded, replayed = row_at(found.recorded, stamp), row_at(found.replayed, stamp)
    told = ', '.join(
        f'{name} {value!r} was {recorded[name]!r}'
        for name, value in replayed.items()
        if value != recorded[name]
    )
    return f'first in {topic} at {seconds(stamp)} s: {told or "the sign of a zero"}'


def effort_line(found: Difference) -> str:
    """Return how far the efforts of commands are apart [N]."""
    replayed, recorded = (
        rows['effort'][np.isin(rows['stamp'], found.common)]
        for rows in (found.replayed, found.recorded)
    )
    with np.errstate(all='ignore'):  # recorded efforts may be nan, infinite or huge
        apart = np.abs(replayed - recorded)
    is_known = np.isfinite(apart)
    apart, stamps, unknown = apart[is_known], found.common[is_known], np.count_nonzero(~is_known)
    left_out = f', {unknown} that are not finite left out' if unknown else ''
    if not len(apart):
        return f'effort apart: none to compare{left_out}'
    at = int(np.argmax(apart))
    peak = float(apart[at])
    rms = peak * np.sqrt(np.mean((apart / (peak or 1.0)) ** 2))  # whose squares do not overflow
    return (
        f'effort apart: RMS {rms:.6g} N, peak {peak:.6g} N at {seconds(int(stamps[at]))} s'
        f'{left_out}'
    )


def event_lines(name: str, title: str, words: Sequence[str], events: Difference) -> Iterator[str]:
    """
    Yield a table of the events by guard or verdict, and the first that are in one of both only.

    ``name`` is the field with the index of one of the ``words``. Yields nothing without any.
    """
    both = events.recorded, events.replayed
    if not any(rows[name].any() for rows in both):
        return
    yield f'{title:<16}{"recorded":>9}{"replayed":>9}{"both":>9}'
    lone: list[tuple[int, str, str]] = []
    for number, word in list(enumerate(words))[1:]:
        before, now = (rows['stamp'][rows[name] == number] for rows in both)
        gone, new = np.setdiff1d(before, now), np.setdiff1d(now, before)
        if name == 'guard' or len(before) + len(now):
            yield f'{word:<16}{len(before):>9}{len(now):>9}{len(before) - len(gone):>9}'
        lone += [
            (int(stamp), word, where)
            for stamps, where in ((gone, 'recorded'), (new, 'replayed'))
            for stamp in stamps
        ]
    for stamp, word, where in sorted(lone)[:SHOWN]:
        yield f'{word} at {seconds(stamp)} s is only {where}'
    if len(lone) > SHOWN:
        yield f'and {len(lone) - SHOWN} more'
