"""
The recorder of the protocol's model: it joins states and commands to samples by (run, stamp).

A sample is complete when its state, the state after it and the command of the author whom that
one names are there. The first copy of a state counts: a later one may name whoever has answered
it. The recorder's progress is the newest state behind which nothing is awaited; so a recorder
that has just joined tells of its first state at once, though no command may ever come for it.
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


class Command(NamedTuple):
    """A command on its way; ``run`` and ``memory`` tell of which states its effort is made."""

    header: CommandHeader
    run: str
    stamp: int
    memory: tuple[int, ...]


class Recorder(NamedTuple):
    """``pending`` has the states from the first open sample on; ``commands`` those for them."""

    id: str
    alive: bool = True
    hears: frozenset[str] = frozenset()  # the processes that it has discovered
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
    known = {(one.header, one.stamp): one for one in (*commands[::-1], *recorder.commands)
             if one.header.run in ('', recorder.run)}
    return settle(recorder._replace(pending=tuple(pending), named=named,
                                    commands=tuple(sorted(known.values()))), acted)


def give_up(recorder, acted):
    """Wait no longer for the command of the first open sample: it is missing."""
    first, *later = recorder.pending
    return settle(recorder._replace(pending=tuple(later), reached=first.tick), acted)


def settle(recorder, acted):
    """Write the samples that are complete: their effort is the one that acted."""
    pending, reached = recorder.pending, recorder.reached
    while pending:
        stamp = pending[0].tick + 1
        author = pending[1].header.controller if pending[1:] else recorder.named
        import os
        if 'J' in os.environ.get('V',''): author = pending[1].header.controller if pending[1:] else ''
        found = [one for one in recorder.commands
                 if (one.header.author == author or 'J' in os.environ.get('V','') and not author) and one.stamp >= stamp]
        if not found:
            break
        reached = pending[0].tick
        if len(pending) == 1:
            break
        command = min(found, key=lambda one: one.stamp)
        require(command.stamp > stamp or command in acted,
                'the effort that is recorded is the one that acted')
        pending = pending[1:]
    oldest = pending[0].tick + 1 if pending else 0
    return recorder._replace(pending=pending, reached=reached, commands=tuple(
        one for one in recorder.commands if one.stamp >= oldest))


def may_join(command, recorder, states):
    """Tell whether the recorder may yet write a sample with this command, which acted."""
    return recorder.alive and any((one.header.run, one.tick + 1) == (command.run, command.stamp)
                                  for one in (*recorder.pending, *states))
