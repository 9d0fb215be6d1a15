"""
What can happen next in a world of the protocol's model, in the order of a fair schedule.

Messages of one writer arrive in order, at any time; those of two runs of the plant come from two
writers. A timeout fires when nothing else can happen, or at the price of a fault. A process is
killed at the price of a fault and may start again at any time. Nothing else is lost then, but
what a killed writer has not yet got through to the recorder.
"""

from collections.abc import Iterator

from impulse_control_ros.core.protocol import FOREIGN, RUN_TIMEOUT, StateHeader
from test.core.protocol_model.processes import (
    COMMAND_TIMEOUT,
    drop,
    on_command,
    on_silence,
    on_state,
    PATIENCE,
    poll,
    publish,
)
from test.core.protocol_model.recorder import give_up, Recorder, State, Violation
from test.core.protocol_model.world import Bound, Controller, Plant, put, spend, World, Worlds

Moves = Iterator[tuple[tuple[object, ...], World]]  # what happens, in words


def start(ids: tuple[str, ...], recorder: str, bound: Bound) -> Worlds:
    """Yield the worlds in which the plant has just published its first state."""
    none = ((),) * len(ids)
    yield from publish(
        World(
            Plant(StateHeader('00000001')),
            tuple(map(Controller, ids)),
            Recorder(recorder, alive=bool(recorder)),
            bound,
            not bound.faults,
            none,
            none,
            (),
            (),
        )
    )


def each(worlds: Worlds, *what: object) -> Moves:
    try:
        for world in worlds:
            yield what, world
    except Violation as broken:
        raise Violation(str(broken), *what) from None


def moves(world: World) -> Moves:
    """Yield what can happen; the first is what a fair schedule lets happen."""
    plant, recorder, quiet = world.plant, world.recorder, True
    for move in deliveries(world):
        quiet = False
        yield move
    if quiet and len(recorder.pending) > 1 and (recorder.commands or recorder.reached >= 0):
        yield ('recorder gives up',), world._replace(recorder=give_up(recorder, world.acted))
    for name, _ in plant.joined:
        if not (recorder.alive and name == recorder.id):
            yield from each(drop(world, name), 'recorder_timeout')
    if plant.alive and quiet:
        if plant.awaits or not is_alive(world, plant.header.controller):
            yield from each(on_silence(world, COMMAND_TIMEOUT), 'command_timeout')
        yield from each(on_silence(world, PATIENCE), 'published again')
    elif plant.alive and world.bound.copies:
        yield from each(
            on_silence(world._replace(bound=spend(world.bound, 'copies')), PATIENCE),
            'published again',
        )
    yield from starts(world)
    if world.bound.faults:
        yield from faults(world._replace(bound=spend(world.bound, 'faults')), quiet)


def is_fed(world: World) -> bool:
    """Tell whether plant and a controller live."""
    return world.plant.alive and any(one.alive for one in world.controllers)


def is_alive(world: World, controller: str) -> bool:
    return any(one.alive and one.id == controller for one in world.controllers)


def deliveries(world: World) -> Moves:
    plant = world.plant
    if world.recorder.alive:
        yield from each(poll(world), 'recorder polls')
    for at, waiting in enumerate(world.commands):
        if waiting and plant.alive:
            left = world._replace(commands=put(world.commands, at, waiting[1:]))
            yield from each(on_command(left, waiting[0]), 'plant gets', waiting[0])
    for at, waiting in enumerate(world.states):
        one = world.controllers[at]
        for state in heads(waiting, one.last.run):
            first = waiting.index(state)
            left = world._replace(
                states=put(world.states, at, waiting[:first] + waiting[first + 1 :])
            )
            for quiet in quiet_times(world, at, state):
                yield from each(
                    on_state(left, at, state, quiet),
                    one.id,
                    'gets',
                    state,
                    *['after silence'] * (quiet > 0),
                )


def heads(waiting: tuple[State, ...], first: str | None) -> list[State]:
    """Return the first message of each run, those of the run ``first`` before the others."""
    found: dict[str, State] = {}
    for state in waiting:
        found.setdefault(state.header.run, state)
    return sorted(found.values(), key=lambda state: state.header.run != first)


def quiet_times(world: World, at: int, state: State) -> tuple[float, ...]:
    """Return for how long the controller may have heard nothing of its run."""
    run = world.controllers[at].last.run
    if run in (None, state.header.run):
        return (0.0,)
    comes = (
        world.plant.alive
        and world.plant.header.run == run
        or any(one.header.run == run for one in world.states[at])
    )
    return (0.0,) if comes else (RUN_TIMEOUT, 0.0)


def starts(world: World) -> Moves:
    plant, recorder = world.plant, world.recorder
    if not plant.alive:
        yield from each(
            publish(world._replace(plant=Plant(StateHeader(successor(plant.header.run))))),
            'plant starts',
        )
    for at, one in enumerate(world.controllers):
        if not one.alive and one.id != FOREIGN:
            yield (
                ('controller starts',),
                world._replace(
                    controllers=put(world.controllers, at, Controller(successor(one.id)))
                ),
            )
    if recorder.id and not recorder.alive:
        yield ('recorder starts',), world._replace(recorder=Recorder(successor(recorder.id)))


def successor(name: str) -> str:
    return f'{name[:-1]}{int(name[-1]) + 1}'


def faults(world: World, quiet: bool) -> Moves:
    plant, recorder = world.plant, world.recorder
    if plant.alive and not quiet:
        yield from each(on_silence(world, COMMAND_TIMEOUT), 'command_timeout early')
    if recorder.alive and recorder.id in dict(plant.joined):
        yield from each(drop(world, recorder.id), 'recorder_timeout early')
    if plant.alive and not is_alive(world, FOREIGN):  # it knows no run: two are one to it
        after = world._replace(
            plant=plant._replace(alive=False, joined=()),
            commands=((),) * len(world.commands),
            recorder=deaf(recorder, plant.header.run),
        )
        yield ('plant is killed',), after
        if after.recorded_states:
            yield (
                ('plant is killed before its states are through',),
                after._replace(recorded_states=()),
            )
    for at, one in enumerate(world.controllers):
        if one.alive:
            yield from kill(world, at)
    if recorder.alive:
        yield (
            ('recorder is killed',),
            world._replace(
                recorder=Recorder(recorder.id, alive=False),
                recorded_states=(),
                recorded_commands=(),
            ),
        )


def kill(world: World, at: int) -> Moves:
    name, sent = world.controllers[at].id, world.recorded_commands
    after = world._replace(
        controllers=put(world.controllers, at, Controller(name, alive=False)),
        states=put(world.states, at, ()),
        recorder=deaf(world.recorder, name),
    )
    yield (name, 'is killed'), after
    through = tuple(one for one in sent if one.header.author != name)
    if through != sent:
        yield (
            (name, 'is killed before its commands are through'),
            after._replace(recorded_commands=through),
        )


def deaf(recorder: Recorder, writer: str) -> Recorder:
    return recorder._replace(hears=recorder.hears - {writer})
