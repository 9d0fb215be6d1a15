"""
Of all messages of a bag, those of one run, each sample once.

A bag may hold several: of a plant that was restarted, of two plants, of a foreign plant whose
time went back. Of several commands for one state the one counts whose author the next state
names, or the last one itself, else the first one; the events are those of these commands.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.protocol import StateHeader
from impulse_control_ros.files.joint_state_arrays import DAMPING, Messages, Source

LATE = 10  # states before the one ahead of them in a row: time went back; fewer came late


NO_SOURCE = Source('', '/', '')


class Series(NamedTuple):
    """The series of a bag, or of one run."""

    states: Messages
    commands: Messages
    impulses: Messages


class OneRun(NamedTuple):
    """
    The ``series`` of one run in order, and the commands ``withdrawn`` that answer no state.

    ``source`` is whose they are; ``others`` tells what was left out, and of how many messages.
    ``span`` are the times [ns] from which on, and before which, it was sent.
    """

    series: Series
    withdrawn: Messages
    source: Source
    others: Counter[str]
    span: tuple[int, int]


def choose(states: Messages, joint: str, run: str | None, name: str) -> Source | None:
    """
    Return whose states to take, None where there are none: most of all states are theirs.

    ``run`` is that of the bag, None for any; ``name`` that of a source, '' for any; of a foreign
    plant the ``joint``. Raises ValueError for a wrong name, or for too many foreign plants.
    """
    counts = Counter[Source]()
    for origin, count in states.counts():
        if count and (origin.header.run or origin.joint == joint):
            counts[origin.source] += count
    found = [
        source
        for source in counts
        if source.name == name or (not name and run in (None, source.run))
    ]
    if name and not found:
        raise ValueError(f'run {name} is not in it; its runs: {names_of(counts)}')
    found = [source for source in found if source.run] or found
    if len(found) > 1 and not found[0].run:
        raise ValueError(
            f'joint {joint!r} has states in the namespaces {names_of(found)}: '
            'choose one with --run'
        )
    return max(found, key=lambda source: counts[source], default=None)


def names_of(sources: Iterable[Source]) -> str:
    """Return the names of sources."""
    return ', '.join(dict.fromkeys(source.name for source in sources)) or 'none'


def one_run(every: Series, source: Source, is_ours: bool) -> OneRun:
    """Return the messages of a ``source``; in a bag of our recorder (``is_ours``) time goes on."""
    states = every.states.from_origins(lambda origin: origin.source == source)
    parts = [states, *(of_source(messages, source) for messages in every[1:])]
    others = sum((messages_of_others(messages, source) for messages in every), Counter[str]())
    span = span_of(states, every.states, source, is_ours)
    if not source.run:
        whole = parts
        parts = [part.where((part.sent >= span[0]) & (part.sent < span[1])) for part in whole]
        others['another part of it, in which time goes back,'] += sum(
            len(all_of.rows) - len(part.rows) for all_of, part in zip(whole, parts, strict=True)
        )
    states = parts[0].in_order()
    commands, impulses = (part.where(part.stamps > 0) for part in parts[1:])
    commands = acting_commands(commands, states)
    series = Series(states, commands, events_of(impulses, commands))
    return OneRun(series, parts[1].where(parts[1].stamps == 0), source, +others, span)


def of_source(messages: Messages, source: Source) -> Messages:
    """Return the commands or events that may answer the states of a ``source``."""
    if source.run:
        return messages.from_origins(
            lambda origin: origin.joint == source.joint and (origin.header.run in (source.run, ''))
        )
    messages = messages.from_origins(lambda one: one.joint == source.joint and not one.header.run)
    # a controller may be in another namespace than its plant, where there is none in this one
    near = messages.from_origins(lambda origin: origin.namespace == source.namespace)
    return near if len(near.rows) else messages


def span_of(states: Messages, every: Messages, source: Source, is_ours: bool) -> tuple[int, int]:
    """
    Return the times [ns] from which on, and before which, a run was recorded.

    That of a foreign plant is the longest part in which its time does not go back. That of ours
    ends with the states of another one.
    """
    first, last = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    if is_ours or not len(states.rows):
        return first, last
    if source.run:
        later = every.sent[every.sent > states.sent.max()]
        return first, int(later.min(initial=last))
    order = np.argsort(states.sent, kind='stable')
    stamps, sent = states.stamps[order], states.sent[order]
    starts = [
        0,
        *(
            at
            for at in (np.flatnonzero(np.diff(stamps) < 0) + 1).tolist()
            if len(stamps) - at >= LATE and (stamps[at : at + LATE] < stamps[at - 1]).all()
        ),
    ]
    longest = int(np.argmax(np.diff([*starts, len(stamps)])))
    ends = [first, *sent[starts[1:]].tolist(), last]
    return ends[longest], ends[longest + 1]


def messages_of_others(messages: Messages, source: Source) -> Counter[str]:
    """Return the number of messages of other runs than ``source``."""
    counts = Counter[str]()
    for origin, count in messages.counts():
        if origin.header.run and origin.header.run != source.run:
            counts[f'run {origin.header.run}'] += count
        elif not origin.header.run and source.run and isinstance(origin.header, StateHeader):
            counts['a foreign plant'] += count
    return counts


def acting_commands(commands: Messages, states: Messages) -> Messages:
    """Return the commands that count, one a stamp: most often they are all there are."""
    run = states.origins[states.origin[0]].header.run if len(states.rows) else ''
    # what does not say that it is for our run, and the plant has not taken, may be for another
    is_strange = commands.per_message(lambda origin: origin.header.run != run) > 0
    if not run or not (is_strange.any() or (np.diff(commands.stamps) <= 0).any()):
        return commands.in_order()
    author, controller = controllers(commands, states)
    after = np.searchsorted(states.stamps, commands.stamps, 'right')
    is_named = author == controller[np.minimum(after, len(controller) - 1)]
    keep = is_named | ~is_strange
    return commands.where(keep).in_order(is_named[keep])


def events_of(impulses: Messages, commands: Messages) -> Messages:
    """Return the events, one a stamp, that are not of another author than the command."""
    author, of_command = controllers(impulses, commands)
    at = np.searchsorted(commands.stamps, impulses.stamps)
    answers = np.append(commands.stamps, 0)[at] == impulses.stamps
    return impulses.where(~answers | (np.append(of_command, -1)[at] == author)).in_order()


def controllers(*series: Messages) -> list[np.ndarray]:
    """Return the number of its controller for each message, the same numbers in all series."""
    names = {origin.node_id for messages in series for origin in messages.origins}
    numbers = {name: number for number, name in enumerate(names)}
    return [messages.per_message(lambda origin: numbers[origin.node_id]) for messages in series]


def state_before(states: Messages, sent: np.ndarray) -> np.ndarray:
    """Return the stamp of the state that was sent last before each time ``sent`` [ns], or 0."""
    order = np.argsort(states.sent, kind='stable')
    stamps = np.append(0, states.stamps[order])
    return stamps[np.searchsorted(states.sent[order], sent, 'right')]


def damping_of(
    run: OneRun, found: Mapping[str, Sequence[np.ndarray]], is_ours: bool
) -> np.ndarray:
    """
    Return the damping of a run, of what was ``found`` by namespace: shape (n,), dtype DAMPING.

    In a bag of our recorder (``is_ours``) the publish times are those of the states. Other
    recorders know only when a message was sent: after the state that it belongs to.
    """
    near = found.get(run.source.namespace) or [rows for parts in found.values() for rows in parts]
    rows = np.concatenate([np.zeros(0, DAMPING), *near])
    if is_ours:
        return rows
    sent = rows['stamp'].copy()
    rows['stamp'] = state_before(run.series.states, sent)
    first, last = run.span
    rows = rows[(rows['stamp'] > 0) & (sent >= first) & (sent < last)]
    return np.sort(rows, order='stamp', kind='stable')
