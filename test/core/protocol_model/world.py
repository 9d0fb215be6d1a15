"""The worlds of the protocol's model: processes, messages on their way, what may still fail."""

from collections.abc import Iterator
from typing import NamedTuple

from impulse_control_ros.core.protocol import Answered, StateHeader
from test.core.protocol_model.recorder import Command, Recorder, State


class Plant(NamedTuple):
    """``joined`` has (id, last whole tick) of the recorders, ``since`` is that of `step_limit`."""

    header: StateHeader
    alive: bool = True
    tick: int = 0
    awaits: bool = True
    joined: tuple[tuple[str, int], ...] = ()
    since: int = 0
    released: bool = False  # a recorder may lack something: nobody was there to send it
    cleared: bool = False  # the active controller was silent at this state
    begun: int = 0  # the first tick of the episode


class Controller(NamedTuple):
    """``told``: a state of its run has named another one since its last answer."""

    id: str
    alive: bool = True
    last: Answered = Answered()
    sent: Command | None = None
    told: bool = False


class Bound(NamedTuple):
    """
    How often it may still happen that something fails, that a state is published again early,
    that a message overtakes another, that the plant is reset, and that the recorder has not
    discovered a writer yet.
    """

    faults: int = 0
    copies: int = 0
    overtakes: int = 0
    resets: int = 0
    unheard: int = 0


class World(NamedTuple):
    """The processes and the messages on their way; ``acted`` has the commands that acted."""

    plant: Plant
    controllers: tuple[Controller, ...]
    recorder: Recorder
    bound: Bound
    calm: bool  # there has been no fault, nor will there be
    states: tuple[tuple[State, ...], ...]
    commands: tuple[tuple[Command, ...], ...]
    recorded_states: tuple[State, ...]
    recorded_commands: tuple[Command, ...]
    acted: tuple[Command, ...] = ()


Worlds = Iterator[World]


def put(items, at, item):
    return (*items[:at], item, *items[at + 1 :])


def spend(bound, what):
    return bound._replace(**{what: getattr(bound, what) - 1})


def sent(bound, waiting, message) -> Iterator[tuple[Bound, tuple]]:
    """Yield what waits for a best effort reader after a message to it."""
    yield bound, (*waiting, message)
    if bound.faults:
        yield spend(bound, 'faults'), waiting
    if bound.overtakes and waiting:
        yield spend(bound, 'overtakes'), (*waiting[:-1], message, waiting[-1])


def heard(world, writer) -> Iterator[tuple[World, bool]]:
    """Yield whether the recorder hears a writer: from some message on it does."""
    recorder = world.recorder
    if recorder.alive and writer not in recorder.hears:
        yield world._replace(recorder=recorder._replace(hears=recorder.hears | {writer})), True
        if world.bound.unheard:
            yield world._replace(bound=spend(world.bound, 'unheard')), False
    else:
        yield world, recorder.alive
