"""
Select the messages of one run from a bag, each sample once.

A bag may hold several runs: of a restarted plant, of two plants, or of a foreign plant whose time
went back. If a state has several commands, the one whose author the next state names counts (for
the last state, the author that it names itself), or else the first one. Only the events of these
commands are kept.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.protocol import StateHeader
from impulse_control_ros.files.joint_state_arrays import DAMPING, Messages, Source

LATE = 10  # consecutive states older than the one before: time went back; fewer were late


NO_SOURCE = Source('', '/', '')


class Series(NamedTuple):
    """The series of a bag, or of one run."""

    states: Messages
    commands: Messages
    impulses: Messages


class OneRun(NamedTuple):
    """
    The ``series`` of one run in order, and the ``withdrawn`` commands, which answer no state.

    ``source`` is the source of the states. ``others`` counts the messages that were left out, by
    kind. ``span`` is the half-open interval of publish times [ns] of the run.
    """

    series: Series
    withdrawn: Messages
    source: Source
    others: Counter[str]
    span: tuple[int, int]


def choose(states: Messages, joint: str, run: str | None, name: str) -> Source | None:
    """
    Return the source with the most states among those allowed, None if there are none.

    ``run`` is the run of the bag, None for any. ``name`` is the name of a source, '' for any.
    Foreign plants need the ``joint``. Raises ValueError for a wrong name or several foreign
    plants.
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
    """Return the messages of a ``source``; our recorder's bags (``is_ours``) are in time order."""
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
    # if the plant's namespace has no controller, one in another namespace may answer
    near = messages.from_origins(lambda origin: origin.namespace == source.namespace)
    return near if len(near.rows) else messages


def span_of(states: Messages, every: Messages, source: Source, is_ours: bool) -> tuple[int, int]:
    """
    Return the half-open interval of publish times [ns] of a run.

    A run of a foreign plant is the longest part in which time does not go back. A run of our
    plants ends where states of another run begin.
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
    """Return the commands that count, one per stamp: usually all of them."""
    run = states.origins[states.origin[0]].header.run if len(states.rows) else ''
    # commands that neither name our run nor were accepted by the plant may be for another run
    is_strange = commands.per_message(lambda origin: origin.header.run != run) > 0
    if not run or not (is_strange.any() or (np.diff(commands.stamps) <= 0).any()):
        return commands.in_order()
    author, controller = controllers(commands, states)
    after = np.searchsorted(states.stamps, commands.stamps, 'right')
    is_named = author == controller[np.minimum(after, len(controller) - 1)]
    keep = is_named | ~is_strange
    return commands.where(keep).in_order(is_named[keep])


def events_of(impulses: Messages, commands: Messages) -> Messages:
    """Return the events, one per stamp, without those by other authors than the command."""
    author, of_command = controllers(impulses, commands)
    at = np.searchsorted(commands.stamps, impulses.stamps)
    answers = np.append(commands.stamps, 0)[at] == impulses.stamps
    return impulses.where(~answers | (np.append(of_command, -1)[at] == author)).in_order()


def controllers(*series: Messages) -> list[np.ndarray]:
    """Return the number of each message's controller, the same numbers in all series."""
    names = {origin.node_id for messages in series for origin in messages.origins}
    numbers = {name: number for number, name in enumerate(names)}
    return [messages.per_message(lambda origin: numbers[origin.node_id]) for messages in series]


def state_before(states: Messages, sent: np.ndarray) -> np.ndarray:
    """Return the stamp of the last state sent up to each time ``sent`` [ns], or 0."""
    order = np.argsort(states.sent, kind='stable')
    stamps = np.append(0, states.stamps[order])
    return stamps[np.searchsorted(states.sent[order], sent, 'right')]


def damping_of(
    run: OneRun, found: Mapping[str, Sequence[np.ndarray]], is_ours: bool
) -> np.ndarray:
    """
    Return the damping of a run from that ``found`` by namespace: shape (n,), dtype DAMPING.

    In a bag of our recorder (``is_ours``), publish times equal the stamps of the states. Other
    recorders store only when a message was sent, which is after the state that it belongs to.
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
