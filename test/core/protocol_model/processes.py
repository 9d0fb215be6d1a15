"""
One plant, its controllers and a recorder, as the nodes wrap the decisions of core/protocol.py.

What a process does with a message or a timeout yields every world that may follow. What it sends
to a best effort reader arrives, or, as far as the `Bound` goes, is lost or overtakes the message
before it. A state that comes before the plant's parameters (rule 6 of the protocol) is a lost one.
What it sends to the recorder arrives in order, once the recorder has discovered the writer.

A `Violation` names the property that does not hold; the numbers are those in test_protocol.py. For
the properties alone, and known to no node, are ``acted``, ``run``, ``memory``, ``told``,
``begun``, ``released`` and ``cleared``. A law's memory is the stamps that it has answered since it
was empty. Stamps are the tick plus 1, in steps of 1.
"""

from impulse_control_ros.core import protocol
from impulse_control_ros.core.protocol import CommandHeader, FOREIGN, Reply, Verdict
from test.core.protocol_model.recorder import (
    Command,
    may_join,
    Recorder,
    require,
    State,
    take,
)
from test.core.protocol_model.world import Controller, heard, Plant, put, sent, spend, Worlds

COMMAND_TIMEOUT, PATIENCE = 1.0, 0.02


# -- the plant ------------------------------------------------------------------------------


def publish(world) -> Worlds:
    state = State(world.plant.header, world.plant.tick)
    for now, hears in heard(world, state.header.run):
        ways = [(now.bound, ())]
        for waiting, one in zip(world.states, world.controllers, strict=True):
            ways = [
                (after, (*ready, queue))
                for bound, ready in ways
                for after, queue in (sent(bound, waiting, state) if one.alive else [(bound, ())])
            ]
        recorded = (*world.recorded_states, state) if hears else world.recorded_states
        for bound, states in ways:
            yield now._replace(bound=bound, states=states, recorded_states=recorded)


def on_command(world, command) -> Worlds:
    plant = world.plant
    header, verdict = protocol.judge_command(
        plant.header, command.header, plant.awaits and command.stamp == plant.tick + 1
    )
    if verdict is not Verdict.ACTS:
        yield world._replace(plant=plant._replace(header=header))
        return
    require(plant.awaits, '1: one effort acts for a state')
    require(
        (command.run, command.stamp) == (plant.header.run, plant.tick + 1),
        '1: the effort that acts was made for its state',
    )
    check_memory(world, command)
    plant = plant if plant.header.controller else hold(plant)
    yield from proceed(
        world._replace(
            plant=plant._replace(header=header, awaits=False), acted=(*world.acted, command)
        )
    )


def check_memory(world, command) -> None:
    """Check that the memory behind an effort that acts is of this episode, and without a gap."""
    first = command.memory[0]
    require(command.memory == tuple(range(first, command.stamp + 1)), '7: a memory has no gap')
    require(first > world.plant.begun, '7: a memory is of one episode')


def proceed(world) -> Worlds:
    """Step, or reset instead, unless something holds the plant."""
    plant = world.plant
    limit = protocol.step_limit([one for _, one in plant.joined], plant.since)
    if plant.awaits or plant.tick >= limit:
        yield world
        return
    check_recorder(world)
    tick, last = plant.tick + 1, world.acted[-1]
    # every recorder has reached ``since`` now, so 0 does as well
    plant = plant._replace(tick=tick, awaits=True, cleared=False, since=0)
    world = world._replace(
        acted=tuple(
            one
            for one in world.acted
            if one is last or may_join(one, world.recorder, world.recorded_states)
        )
    )
    ways = [(plant, world.bound)]
    if world.bound.resets:
        header = protocol.after_reset(plant.header)
        ways.append((plant._replace(header=header, begun=tick), spend(world.bound, 'resets')))
    for after, bound in ways:
        require(
            after.header.controller == last.header.author,
            '5: a state names the author of the command that acted before it',
        )
        yield from publish(world._replace(plant=after, bound=bound))


def check_recorder(world) -> None:
    """Check that a recorder which has joined has, or gets, the sample that the plant leaves."""
    plant, recorder, acted = world.plant, world.recorder, world.acted[-1]
    if not recorder.alive or recorder.id not in dict(plant.joined):
        return
    coming, known = (
        {one.tick for one in states if one.header.run == plant.header.run}
        for states in (world.recorded_states, recorder.pending)
    )
    require(
        plant.released or plant.tick in coming | known,
        '4: the plant holds its state until a new recorder has it',
    )
    require(
        len(coming) <= protocol.WINDOW * (1 + plant.released),
        '4: a recorder that has joined is not left behind',
    )
    lives = any(one.alive and one.id == acted.header.author for one in world.controllers)
    require(
        plant.released
        or plant.cleared
        or not lives
        or acted in (*world.recorded_commands, *recorder.commands),
        '4: a recorder that has joined gets each command of a controller that lives',
    )


def on_silence(world, silent) -> Worlds:
    """Publish the state again; after `COMMAND_TIMEOUT` nobody is waited for."""
    plant = world.plant
    if names_anew(plant):
        header = protocol.after_silence(plant.header, silent, COMMAND_TIMEOUT)
        plant = plant._replace(header=header, cleared=plant.cleared or header != plant.header)
    if not plant.awaits and silent >= COMMAND_TIMEOUT:
        plant = let_go(plant)
    for after in publish(world._replace(plant=plant)):
        yield from proceed(after)


def names_anew(plant) -> bool:
    """Tell whether a state may name nobody: not before the next one has told who answered it."""
    return plant.awaits


def hold(plant) -> Plant:
    """Hold the state until each recorder has it and its command: somebody is new."""
    return plant._replace(since=plant.tick, released=False)


def let_go(plant) -> Plant:
    """Wait no longer for what the recorders lack up to the present state: nobody sends it."""
    return plant._replace(
        released=True,
        joined=tuple((name, max(reached, plant.tick)) for name, reached in plant.joined),
    )


def on_progress(world, recorder, reached) -> Worlds:
    plant, joined = world.plant, dict(world.plant.joined)
    if recorder not in joined:
        joined[recorder], plant = plant.tick - 1, hold(plant)
    joined[recorder] = max(joined[recorder], reached)
    yield from proceed(world._replace(plant=plant._replace(joined=tuple(joined.items()))))


def drop(world, recorder) -> Worlds:
    """Go on without a recorder that has been silent for recorder_timeout."""
    joined = tuple(one for one in world.plant.joined if one[0] != recorder)
    yield from proceed(world._replace(plant=world.plant._replace(joined=joined)))


# -- a controller and the recorder ------------------------------------------------------------


def on_state(world, at, state, quiet) -> Worlds:
    one, stamp = world.controllers[at], state.tick + 1
    if one.id == FOREIGN:  # somebody's own: it answers whatever comes
        answered = one.sent and one.sent.stamp == stamp
        last, reply = one.last, Reply.REPEAT if answered else Reply.ANSWER
    else:
        last, reply = protocol.judge_state(one.id, one.last, state.header, stamp, 1, quiet)
    one = one._replace(
        last=last,
        told=one.told
        or (state.header.run == last.run and state.header.controller not in ('', one.id)),
    )
    if reply in (Reply.ANSWER, Reply.ANSWER_AFRESH):
        one = answer(world, one, state, reply is Reply.ANSWER_AFRESH)
    world = world._replace(controllers=put(world.controllers, at, one))
    if reply not in (Reply.ANSWER, Reply.ANSWER_AFRESH, Reply.REPEAT):
        yield world
        return
    command = one.sent
    require(
        command and (command.run, command.stamp) == (state.header.run, stamp),
        '1: what is sent again is the answer',
    )
    require(
        not world.calm or state.tick == 0 or state.header.controller == one.id,
        '6: without faults the standby is silent',
    )
    for now, hears in heard(world, one.id):
        recorded = world.recorded_commands
        if hears:  # the order of two writers says nothing
            recorded = tuple(sorted((*recorded, command), key=lambda it: it.header.author))
        for bound, queue in sent(now.bound, world.commands[at], command):
            yield now._replace(
                bound=bound, commands=put(world.commands, at, queue), recorded_commands=recorded
            )


def answer(world, one, state, afresh) -> Controller:
    run, episode, _ = state.header
    stamp = state.tick + 1
    header = CommandHeader() if one.id == FOREIGN else CommandHeader(run, episode, one.id)
    memory = (stamp,) if afresh or not one.sent else (*one.sent.memory, stamp)
    before = [it for it in world.acted if it.header == header and it.stamp == stamp - 1]
    require(
        not one.told or one.id == FOREIGN or len(memory) == 1,
        '7: whoever was told of another has forgotten',
    )
    require(
        one.told or not before or memory[:-1] == before[0].memory,
        '7: whoever acted last and hears of no other keeps its memory',
    )
    require(not world.calm or stamp == len(memory), '6: without faults no memory is cleared')
    return one._replace(sent=Command(header, run, stamp, memory), told=False)


def poll(world) -> Worlds:
    """Let the recorder take what waits, and tell the plant how far it is; nothing if both did."""
    plant, recorder, run = world.plant, world.recorder, world.plant.header.run
    states, commands = world.recorded_states, world.recorded_commands
    recorder = take(recorder, states, commands, world.acted)
    if recorder.run != run and plant.alive:
        recorder = Recorder(recorder.id, hears=recorder.hears, run=run)
        recorder = take(recorder, states, commands, world.acted)
    after = world._replace(recorder=recorder, recorded_states=(), recorded_commands=())
    if plant.alive and dict(plant.joined).get(recorder.id, -2) < recorder.reached:
        yield from on_progress(after, recorder.id, recorder.reached)
    elif states or commands:
        yield after
