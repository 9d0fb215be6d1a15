"""
The supervised law of the lanes of a batch, to the bits of `control_step`.

The lanes are ideal runs: without noise, supervision changes nothing between impulses but counts
and the last velocity. Those lanes answer as without supervision, and their memory is brought up to
date when it is needed. Only the rare lane for which supervision may act is answered apart, by
`control_step`: one with an impulse in flight, with an error above its envelope, whose suspension
ends, or which has learnt a delay.
"""

import numpy as np

from impulse_control_ros.core.batch_lanes import KEPT, LANES, UNUSED, X_R
from impulse_control_ros.core.control_gains import Gains
from impulse_control_ros.core.control_law import (
    control_step,
    GAINS,
    gains_of,
    LawState,
    learnt_gains,
    options_of,
    POSITION_ZERO,
)
from impulse_control_ros.core.jit import compiled, to_fixed_tuple
from impulse_control_ros.core.supervision import note_impulse
from impulse_control_ros.core.suspension import note_turn
from impulse_control_ros.core.velocity_noise import pass_exact

FIELDS = LawState._fields
DIRECTION, PENDING, SENT = (FIELDS.index(name) for name in ('direction', 'pending', 'sent'))
POSITION_GAIN, VELOCITY_GAIN, IMPULSES = (
    Gains._fields.index(name) for name in ('position_gain', 'velocity_gain', 'impulses')
)
EFFORT, AREA, GUARD = range(3)


@compiled
def answer_supervised(block, laws, memories, tick):
    """Evaluate the supervised law of each lane at sample ``tick``."""
    some = 0
    for j in range(LANES):
        size = abs(block.position[j] - block.gains[X_R, j])
        apart = (size > 1.1 * block.bound[j]) | (block.special[j] != 0.0)
        apart = apart | (tick >= block.resume[j])
        block.apart[j] = 1.0 if apart else 0.0
        some += 1 if apart else 0
    if some:
        for j in range(LANES):
            if block.apart[j] != 0.0:
                answer_apart(block, laws[j], memories[j], j, tick)
    noted = answer_noting(block)
    if some:
        for j in range(LANES):
            if block.apart[j] != 0.0:
                take_apart(block, j)
    if noted:
        for j in range(LANES):
            if block.noted[j] != 0.0 and block.apart[j] == 0.0:
                note(block, laws[j], memories[j], j, tick)


@compiled
def answer_noting(block):
    """Do `answer_lanes`, and count the lanes with an impulse or a turning point."""
    total = 0
    for j in range(LANES):
        gains = Gains(*to_fixed_tuple(block.gains[:, j], GAINS))
        state = LawState(*(to_fixed_tuple(block.law_state[:, j], KEPT) + UNUSED))
        command, after = control_step(
            state, gains, None, None, block.position[j], block.velocity[j]
        )
        block.effort[j], block.area[j] = command.effort, command.area
        block.guard[j] = command.guard
        turned = (after.direction != state.direction) & (state.direction != 0.0)
        block.noted[j] = 2.0 if turned else (1.0 if after.sent != 0.0 else 0.0)
        total += 1 if turned | (after.sent != 0.0) else 0
        for i in range(KEPT):
            block.law_state[i, j] = after[i]
    return total


@compiled
def answer_apart(block, law, memory, j, tick):
    """Evaluate the law of lane j by `control_step`."""
    gains, options = gains_of(law), options_of(law)
    if tick > 0:
        synchronize(block, memory, j, tick - 1.0, block.old_velocity[j], block.older_velocity[j])
    state = LawState(*(to_fixed_tuple(block.law_state[:, j], KEPT) + UNUSED))
    command, after = control_step(
        state, gains, options, memory, block.position[j], block.velocity[j], True
    )
    block.apart_answer[EFFORT, j] = command.effort
    block.apart_answer[AREA, j], block.apart_answer[GUARD, j] = command.area, command.guard
    for i in range(KEPT):
        block.apart_state[i, j] = after[i]
    block.synced[j] = tick
    keep(block, gains, options, memory, j, tick, after.pending)


@compiled
def take_apart(block, j):
    """Replace the answer of lane j by the one computed apart."""
    block.effort[j], block.area[j] = block.apart_answer[EFFORT, j], block.apart_answer[AREA, j]
    block.guard[j] = int(block.apart_answer[GUARD, j])
    for i in range(KEPT):
        block.law_state[i, j] = block.apart_state[i, j]


@compiled
def note(block, law, memory, j, tick):
    """Note the impulse, or the turning point, of a lane answered without supervision."""
    gains, options = gains_of(law), options_of(law)
    if options.supervision == 0.0:
        return
    synchronize(block, memory, j, tick, block.velocity[j], block.old_velocity[j])
    error = block.position[j] - gains.x_r
    owed, pending = block.law_state[SENT, j], block.law_state[PENDING, j]
    if owed != 0.0:
        direction = block.law_state[DIRECTION, j]
        crosses = block.guard[j] == POSITION_ZERO
        note_impulse(memory, options, crosses, direction, owed, owed - pending, error)
    if block.noted[j] == 2.0:
        note_turn(memory.suspension, error, owed != 0.0)
    keep(block, gains, options, memory, j, tick, pending)


@compiled
def synchronize(block, memory, j, tick, velocity, before):
    """Bring the memory of lane j up to ``tick``, at which it had this ``velocity``."""
    samples = tick - block.synced[j]
    if samples <= 0.0:
        return
    block.synced[j] = tick
    flight, suspension = memory.flight, memory.suspension
    pass_exact(memory.noise, samples)
    flight.level, flight.trend = velocity, velocity - before
    suspension.hop_age += samples
    suspension.left = max(suspension.left - samples, 0.0)


@compiled
def keep(block, gains, options, memory, j, tick, pending):
    """Keep what decides whether lane j is answered apart, and with which gains otherwise."""
    if options.supervision == 0.0:
        block.bound[j] = block.resume[j] = np.inf
        block.special[j] = 0.0
        return
    suspension = memory.suspension
    suspended = suspension.left > 0.0
    special = memory.flight.age > 0.0 or memory.learnt.delay != 0.0
    block.special[j] = 1.0 if special or (suspended and pending != 0.0) else 0.0
    block.bound[j] = suspension.bound
    block.resume[j] = tick + suspension.left if suspended else np.inf
    now = learnt_gains(gains, options, memory)
    block.gains[POSITION_GAIN, j], block.gains[VELOCITY_GAIN, j] = (
        now.position_gain,
        now.velocity_gain,
    )
    block.gains[IMPULSES, j] = 0.0 if suspended else gains.impulses
