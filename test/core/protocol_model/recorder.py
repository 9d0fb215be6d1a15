"""
The messages of the protocol's model, and its recorder: files/sample_joiner.py in a few lines.

A sample is written once its state, the next state and the command of the author whom that one
names are there. The first copy of a state tells who acted before it; whoever answers it the plant
names in a later copy. `Recorder.reached` is the last tick whose command is there, or is missing
because its author has sent a later one or was given up. test_protocol.py drives the real joiner
through the same messages.
"""

from typing import NamedTuple

from impulse_control_ros.core.protocol import CommandHeader, StateHeader


class Violation(Exception):  # noqa: N818 - it is what is searched for
    """A rule that does not hold."""


def require(holds, rule):
    if not holds:
        raise Violation(rule)


class State(NamedTuple):
    """A state on its way."""

    header: StateHeader
    tick: int

    def __str__(self):
        return f'state {self.tick} {self.header.frame_id}'


class Command(NamedTuple):
    """A command on its way; ``run`` and ``memory`` tell of which states its effort is made."""

    header: CommandHeader
    run: str
    stamp: int
    memory: tuple[int, ...]

    def __str__(self):
        return f'the command of {self.header.author} for state {self.stamp - 1} of {self.run}'


class Recorder(NamedTuple):
    """``pending`` has the states from the first open sample on; ``commands`` those for them."""

    id: str
    alive: bool = True
    hears: frozenset[str] = frozenset()  # the writers that it has discovered
    run: str = ''
    reached: int = -1
    pending: tuple[State, ...] = ()
    commands: tuple[Command, ...] = ()
    named: str = ''  # by the newest copy of the newest state


def take(recorder, states, commands, acted):
    """Take what waits; of an author's commands for a state the first one counts."""
    pending, named = list(recorder.pending), recorder.named
    for state in states:
        if state.header.run == recorder.run:
            named = state.header.controller
            if not pending or state.tick > pending[-1].tick:
                pending.append(state)
    known = {
        (one.header, one.stamp): one
        for one in (*commands[::-1], *recorder.commands)
        if one.header.run in ('', recorder.run)
    }
    return settle(
        recorder._replace(
            pending=tuple(pending), named=named, commands=tuple(sorted(known.values()))
        ),
        acted,
    )


def give_up(recorder, acted):
    """Wait no longer for the command of the first open sample: it is missing."""
    first, *later = recorder.pending
    return settle(recorder._replace(pending=tuple(later), reached=first.tick), acted)


def settle(recorder, acted):
    """Write the samples that are complete: their effort is the one that acted."""
    while recorder.pending:
        stamp, author = recorder.pending[0].tick + 1, author_of_first(recorder)
        found = [
            one for one in recorder.commands if one.header.author == author and one.stamp >= stamp
        ]
        if not found:
            break
        recorder = recorder._replace(reached=recorder.pending[0].tick)
        if len(recorder.pending) == 1:
            break
        command = min(found, key=lambda one: one.stamp)
        require(
            command.stamp > stamp or command in acted,
            '4: the effort that is recorded is the one that acted',
        )
        recorder = recorder._replace(pending=recorder.pending[1:])
    oldest = recorder.pending[0].tick + 1 if recorder.pending else 0
    return recorder._replace(
        commands=tuple(one for one in recorder.commands if one.stamp >= oldest)
    )


def author_of_first(recorder):
    """Return whose command belongs to the first open sample, '' where nobody has said so yet."""
    return recorder.pending[1].header.controller if len(recorder.pending) > 1 else recorder.named


def may_join(command, recorder, states):
    """Tell whether the recorder may yet write a sample with this command, which acted."""
    return recorder.alive and any(
        (one.header.run, one.tick + 1) == (command.run, command.stamp)
        for one in (*recorder.pending, *states)
    )
