"""
Select the messages of one run of a system, each sample once.

A bag may hold several runs: of a restarted plant, of two plants, or of a foreign plant whose time
went back. They are numbered in the order of their starts. If a state has several commands, the one
whose author the next state names counts (for the last state, the author that it names itself), or
else the first one. Only the events of these commands are kept.
"""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.protocol import CommandHeader, StateHeader
from impulse_control_ros.files.joint_state_arrays import Messages, Source

LATE = 10  # states before the one ahead of them in a row: time went back; fewer came late
FIRST, LAST = np.iinfo(np.int64).min, np.iinfo(np.int64).max


class Series(NamedTuple):
    """The series of a bag, or of one run."""

    states: Messages
    commands: Messages
    events: Messages


class Run(NamedTuple):
    """
    A run by its ``number`` and ``source``.

    ``span`` is the half-open interval of its publish times [ns].
    """

    number: int
    source: Source
    span: tuple[int, int]

    @property
    def name(self) -> str:
        """The name by which to select the run."""
        return self.source.run or str(self.number)

    def during(self, messages: Messages) -> Messages:
        """Return the messages published during the run."""
        return messages.where((messages.sent >= self.span[0]) & (messages.sent < self.span[1]))


class OneRun(NamedTuple):
    """
    The ``series`` of a ``run`` in order, and the ``withdrawn`` commands, which answer no state.

    ``others`` counts the messages that were left out, by name.
    """

    series: Series
    withdrawn: Messages
    run: Run
    others: Counter[str]

    @property
    def source(self) -> Source:
        """The source of the states."""
        return self.run.source


NO_RUN = Run(0, Source('', ''), (FIRST, LAST))


def runs_in(states: Messages, joint: str, is_ours: bool) -> list[Run]:
    """
    Return the runs of a topic in the order of their starts.

    Runs of our plants may have any joint, runs of a foreign plant need the ``joint``. Our
    recorder's bags (``is_ours``) are in time order.
    """
    found: list[tuple[int, Run]] = []
    for source in dict.fromkeys(origin.source for origin, count in states.counts() if count):
        if source.run or source.joint == joint:
            ours = of_source(states, source)
            for span in spans_of(ours, states, source, is_ours):
                run = Run(0, source, span)
                found.append((int(run.during(ours).sent.min()), run))
    found.sort()
    return [run._replace(number=number) for number, (_, run) in enumerate(found, start=1)]


def choose(runs: Sequence[Run], name: str, recorded: str | None) -> Run | None:
    """
    Return the run with a ``name`` or number; by default the last one, ours before foreign ones.

    ``recorded`` is the run id of our recorder's bag, None for other bags. Returns None if there
    are no runs. Raises ValueError for an unknown name.
    """
    found = [run for run in runs if recorded in (None, run.source.run)]
    if name:
        found = [run for run in runs if name in (run.name, str(run.number))]
        if not found:
            names = ', '.join(dict.fromkeys(run.name for run in runs)) or 'none'
            raise ValueError(f'run {name} is not in it; its runs: {names}')
    return next(reversed([run for run in found if run.source.run] or found), None)


def one_run(every: Series, run: Run, runs: Sequence[Run]) -> OneRun:
    """Return the messages of one of the ``runs``."""
    source = run.source
    parts = [of_source(messages, source) for messages in every]
    others = sum((messages_of_others(messages, source) for messages in every), Counter[str]())
    if not source.run:
        for other in runs:
            if other.source == source and other != run:
                name = f'run {other.number} of {len(runs)}'
                others[f'time goes back: {name}, which --run {other.number} reads,'] += sum(
                    len(other.during(part).rows) for part in parts
                )
        parts = [run.during(part) for part in parts]
        others['what repeats a stamp with other values'] += conflicts(parts[0])
    states = parts[0].in_order()
    commands, events = (part.where(part.stamps > 0) for part in parts[1:])
    commands = acting_commands(commands, states)
    series = Series(states, commands, events_of(events, commands))
    return OneRun(series, parts[1].where(parts[1].stamps == 0), run, +others)


def of_source(messages: Messages, source: Source) -> Messages:
    """Return the messages of a ``source``, or those that may answer its states."""
    return messages.from_origins(
        lambda origin: (
            origin.joint == source.joint
            and (
                origin.header.run == source.run
                or (not origin.header.run and isinstance(origin.header, CommandHeader))
            )
        )
    )


def conflicts(states: Messages) -> int:
    """Return the number of states that repeat a stamp with different values."""
    rows = states.rows[np.argsort(states.stamps, kind='stable')]
    values = rows.view(f'V{rows.dtype.itemsize}')
    again = rows['stamp'][1:] == rows['stamp'][:-1]
    return int(np.count_nonzero(again & (values[1:] != values[:-1])))


def spans_of(
    states: Messages, every: Messages, source: Source, is_ours: bool
) -> list[tuple[int, int]]:
    """
    Return the half-open interval of publish times [ns] of each run of a source.

    A run of a foreign plant ends where its time goes back, a run of ours where the states of
    another one begin.
    """
    if is_ours:
        return [(FIRST, LAST)]
    if source.run:
        later = every.sent[every.sent > states.sent.max()]
        return [(FIRST, int(later.min(initial=LAST)))]
    order = np.argsort(states.sent, kind='stable')
    starts = states.sent[order][restarts(states.stamps[order])].tolist()
    return list(pairwise([FIRST, *starts, LAST]))


def restarts(times: np.ndarray) -> list[int]:
    """Return the indices at which ``times`` [ns] go back for good, not for late messages."""
    steps = np.diff(times)
    far = LATE * float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    return [
        at
        for at in (np.flatnonzero(steps < 0) + 1).tolist()
        if (times[at : at + LATE] < times[at - 1]).all()
        # at the end too few messages follow to tell
        and (len(times) - at >= LATE or times[at - 1] - times[at] > far)
    ]


def is_by_place(sent: np.ndarray) -> bool:
    """
    Tell whether messages are better ordered by position in the bag than by time [ns].

    This is so if the recorder's clock was coarse or was set back. Times that go back in many
    places mean that the messages are not in order, and must be sorted by time.
    """
    steps = np.diff(sent)
    starts = restarts(sent)
    if not starts:
        return bool((steps >= 0).all() and (steps == 0).any())
    back = np.count_nonzero(steps < 0)
    return len(starts) == back and bool(np.diff([0, *starts]).min() >= LATE)


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


def events_of(events: Messages, commands: Messages) -> Messages:
    """Return the events, one per stamp, without those by other authors than the command."""
    author, of_command = controllers(events, commands)
    at = np.searchsorted(commands.stamps, events.stamps)
    answers = np.append(commands.stamps, 0)[at] == events.stamps
    return events.where(~answers | (np.append(of_command, -1)[at] == author)).in_order()


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


def damping_of(found: OneRun, rows: np.ndarray, is_ours: bool) -> np.ndarray:
    """
    Return the damping of a run from ``rows`` with publish times: shape (n,), dtype DAMPING.

    In a bag of our recorder (``is_ours``), publish times equal the stamps of the states. Other
    recorders store only when a message was sent, which is after the state that it belongs to.
    """
    if is_ours:
        return rows
    sent = rows['stamp'].copy()
    rows['stamp'] = state_before(found.series.states, sent)
    first, last = found.run.span
    rows = rows[(rows['stamp'] > 0) & (sent >= first) & (sent < last)]
    return np.sort(rows, order='stamp', kind='stable')
