"""
One plant, its controllers and a recorder, as the nodes wrap the decisions of core/protocol.py.

What a process does with a message or a timeout yields every world that may follow: what it sends
to best effort readers arrives, or, at the price of a fault, is lost, arrives twice, or overtakes
the message before it. What it sends to the recorder arrives in order, once the recorder has
discovered the sender. A `Violation` names the rule that does not hold. Some fields are for the
rules only and known to no node: ``acted``, ``run``, ``memory``, ``told``, ``begun``, ``released``.

The law's memory is the stamps that it has answered since it was empty. Stamps are the tick plus
1, in steps of 1.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

from impulse_control_ros.core import protocol
from impulse_control_ros.core.protocol import (
    Answered,
    CommandHeader,
    FOREIGN,
    Reply,
    StateHeader,
    Verdict,
)
from test.core import protocol_recorder as joiner
from test.core.protocol_recorder import Command, may_join, Recorder, require, State

COMMAND_TIMEOUT, PATIENCE = 1.0, 0.02
import os

V = os.environ.get('V','')
NODE_CLEARS = 'C' in V


class Plant(NamedTuple):
    """``joined`` has (id, last whole tick) of the recorders, ``since`` is that of `may_step`."""

    header: StateHeader
    alive: bool = True
    tick: int = 0
    awaits: bool = True
    joined: tuple[tuple[str, int], ...] = ()
    since: int = 0
    released: bool = False  # the recorders may lack something: nobody was there to send it
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
    that a message comes before the one that was sent before it, that the plant is reset, and that
    the recorder has not discovered a writer yet.
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


def put(items: tuple[Any, ...], at: int, item: Any) -> tuple[Any, ...]:
    return (*items[:at], item, *items[at + 1:])


def spend(bound: Bound, what: str) -> Bound:
    return bound._replace(**{what: getattr(bound, what) - 1})


def sent(bound: Bound, waiting: tuple[Any, ...], message: Any) -> Iterator[tuple[Bound, Any]]:
    """Yield what waits for a best effort reader after a message to it."""
    yield bound, (*waiting, message)
    if bound.faults:
        yield spend(bound, 'faults'), waiting
    if bound.overtakes and waiting:
        yield spend(bound, 'overtakes'), (*waiting[:-1], message, waiting[-1])


def heard(world: World, writer: str) -> Iterator[tuple[World, bool]]:
    """Yield whether the recorder hears a writer: from some message on it does."""
    recorder = world.recorder
    if recorder.alive and writer not in recorder.hears:
        yield world._replace(recorder=recorder._replace(hears=recorder.hears | {writer})), True
        if world.bound.unheard:
            yield world._replace(bound=spend(world.bound, 'unheard')), False
    else:
        yield world, recorder.alive


# -- the plant ------------------------------------------------------------------------------


def publish(world: World) -> Worlds:
    state = State(world.plant.header, world.plant.tick)
    for now, hears in heard(world, state.header.run):
        ways = [(now.bound, ())]
        for waiting, one in zip(world.states, world.controllers, strict=True):
            ways = [(after, (*ready, queue)) for bound, ready in ways
                    for after, queue in (sent(bound, waiting, state) if one.alive
                                         else [(bound, ())])]
        recorded = (*world.recorded_states, state) if hears else world.recorded_states
        for bound, states in ways:
            yield now._replace(bound=bound, states=states, recorded_states=recorded)


def on_command(world: World, command: Command) -> Worlds:
    plant = world.plant
    header, verdict = protocol.judge_command(
        plant.header, command.header, plant.awaits and command.stamp == plant.tick + 1)
    if verdict is not Verdict.ACTS:
        yield world._replace(plant=plant._replace(header=header))
        return
    require(plant.awaits, 'one effort acts for a state')
    require((command.run, command.stamp) == (plant.header.run, plant.tick + 1),
            'the effort that acts was made for its state')
    require(command.memory == tuple(range(command.memory[0], command.stamp + 1)),
            'a memory has no gap')
    require(command.memory[0] > plant.begun, 'a memory is of one episode')
    plant = plant if plant.header.controller else hold(plant)
    yield from proceed(world._replace(
        plant=plant._replace(header=header, awaits=False), acted=(*world.acted, command)))


def proceed(world: World) -> Worlds:
    """Step, or reset instead, unless something holds the plant."""
    plant = world.plant
    reached = [one for _, one in plant.joined]
    if plant.awaits or plant.tick >= protocol.step_limit(reached, plant.since):
        yield world
        return
    check_recorder(world)
    tick, last = plant.tick + 1, world.acted[-1]
    plant = plant._replace(tick=tick, awaits=True, cleared=False, since=0)
    world = world._replace(acted=tuple(one for one in world.acted if one is last or may_join(
        one, world.recorder, world.recorded_states)))
    ways = [(plant, world.bound)]
    if world.bound.resets:
        header = protocol.after_reset(plant.header)
        ways += (plant._replace(header=header, begun=tick), spend(world.bound, 'resets')),
    for after, bound in ways:
        require(after.header.controller == last.header.author,
                'a state names the author of the command that acted before it')
        yield from publish(world._replace(plant=after, bound=bound))


def check_recorder(world: World) -> None:
    """Check that a recorder which has joined has, or gets, the sample that the plant leaves."""
    plant, recorder, acted = world.plant, world.recorder, world.acted[-1]
    if not recorder.alive or recorder.id not in dict(plant.joined):
        return
    coming, known = ({one.tick for one in states if one.header.run == plant.header.run}
                     for states in (world.recorded_states, recorder.pending))
    require(plant.released or plant.tick in coming | known,
            'the plant holds its state until a new recorder has it')
    require(len(coming) <= protocol.WINDOW * (1 + plant.released),
            'a recorder that has joined is not left behind')
    lives = any(one.alive and one.id == acted.header.author for one in world.controllers)
    require(plant.released or plant.cleared or not lives
            or acted in (*world.recorded_commands, *recorder.commands),
            'a recorder that has joined gets each command of a controller that lives')


def on_silence(world: World, silent: float) -> Worlds:
    """Publish the state again; after `COMMAND_TIMEOUT` nobody is waited for."""
    plant = world.plant
    if NODE_CLEARS or plant.awaits:
        header = protocol.after_silence(plant.header, silent, COMMAND_TIMEOUT)
        plant = plant._replace(header=header, cleared=plant.cleared or header != plant.header)
    if not plant.awaits and silent >= COMMAND_TIMEOUT:
        plant = let_go(plant)
    for after in publish(world._replace(plant=plant)):
        yield from proceed(after)


def hold(plant: Plant) -> Plant:
    """Hold the state until each recorder has it and its command: somebody is new."""
    return plant._replace(since=plant.tick, released=False)


def let_go(plant: Plant) -> Plant:
    """Wait no longer for what the recorders lack up to the present state: nobody sends it."""
    if 'L' in V:
        return plant._replace(released=True, since=0)
    if 'M' in V:
        return plant._replace(released=True, since=-1)
    return plant._replace(released=True, joined=tuple(
        (name, max(reached, plant.tick)) for name, reached in plant.joined))


def on_progress(world: World, recorder: str, run: str, reached: int) -> Worlds:
    plant = world.plant
    if run == plant.header.run:
        joined = dict(plant.joined)
        if recorder not in joined:
            joined[recorder], plant = plant.tick - 1, hold(plant)
        if reached >= 0:
            joined[recorder] = max(joined[recorder], reached)
        plant = plant._replace(joined=tuple(joined.items()))
    yield from proceed(world._replace(plant=plant))


def drop(world: World, recorder: str) -> Worlds:
    """Go on without a recorder that has been silent for recorder_timeout."""
    joined = tuple(one for one in world.plant.joined if one[0] != recorder)
    yield from proceed(world._replace(plant=world.plant._replace(joined=joined)))


# -- a controller ---------------------------------------------------------------------------


def on_state(world: World, at: int, state: State, quiet: float) -> Worlds:
    one, stamp = world.controllers[at], state.tick + 1
    if one.id == FOREIGN:  # somebody's own: it answers whatever comes
        answered = one.sent and one.sent.stamp == stamp
        last, reply = one.last, Reply.REPEAT if answered else Reply.ANSWER
    else:
        last, reply = protocol.judge_state(one.id, one.last, state.header, stamp, 1, quiet)
    one = one._replace(last=last, told=one.told or (
        state.header.run == last.run and state.header.controller not in ('', one.id)))
    if reply in (Reply.ANSWER, Reply.ANSWER_AFRESH):
        one = answer(world, one, state, reply is Reply.ANSWER_AFRESH)
    world = world._replace(controllers=put(world.controllers, at, one))
    if reply not in (Reply.ANSWER, Reply.ANSWER_AFRESH, Reply.REPEAT):
        yield world
        return
    command = one.sent
    require(command and (command.run, command.stamp) == (state.header.run, stamp),
            'what is sent again is the answer')
    require(not world.calm or state.tick == 0 or state.header.controller == one.id,
            'without faults the standby is silent')
    for now, hears in heard(world, one.id):
        recorded = world.recorded_commands
        if hears:  # the order of two writers says nothing
            recorded = tuple(sorted((*recorded, command), key=lambda one: one.header.author))
        for bound, queue in sent(now.bound, world.commands[at], command):
            yield now._replace(bound=bound, commands=put(world.commands, at, queue),
                               recorded_commands=recorded)


def answer(world: World, one: Controller, state: State, afresh: bool) -> Controller:
    run, episode, _ = state.header
    stamp = state.tick + 1
    header = CommandHeader() if one.id == FOREIGN else CommandHeader(run, episode, one.id)
    memory = (stamp,) if afresh or not one.sent else (*one.sent.memory, stamp)
    before = [it for it in world.acted if it.header == header and it.stamp == stamp - 1]
    require(not one.told or one.id == FOREIGN or len(memory) == 1,
            'whoever was told of another has forgotten')
    require(one.told or not before or memory[:-1] == before[0].memory,
            'whoever acted last and hears of no other keeps its memory')
    require(not world.calm or stamp == len(memory), 'without faults no memory is cleared')
    return one._replace(sent=Command(header, run, stamp, memory), told=False)


# -- the recorder ---------------------------------------------------------------------------


def poll(world: World) -> Worlds:
    """Take what waits, and tell the plant how far the recording is; nothing if both are old."""
    plant, recorder, run = world.plant, world.recorder, world.plant.header.run
    states, commands = world.recorded_states, world.recorded_commands
    recorder = joiner.take(recorder, states, commands, world.acted)
    if recorder.run != run and plant.alive:
        recorder = Recorder(recorder.id, hears=recorder.hears, run=run)
        recorder = joiner.take(recorder, states, commands, world.acted)
    after = world._replace(recorder=recorder, recorded_states=(), recorded_commands=())
    if plant.alive and dict(plant.joined).get(recorder.id, -2) < recorder.reached:
        yield from on_progress(after, recorder.id, run, recorder.reached)
    elif states or commands:
        yield after
