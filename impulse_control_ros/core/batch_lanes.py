"""
Lanes of a batch: LANES ideal runs that step side by side.

Within a step of one run, each operation waits for the previous one. Side by side, the conditions
in the law only select values, so the compiler vectorizes the loops over the lanes. The rare step
that `short_step` does not cover is computed lane by lane. So is the law where its supervision may
change the answer: core/supervised_lanes.py.
"""

import numpy as np

from impulse_control_ros.core.control_gains import Gains
from impulse_control_ros.core.control_law import control_step, FRESH, GAINS, LawState
from impulse_control_ros.core.damping import (
    DAMPING,
    filtered,
    sine,
    within_bounds,
)
from impulse_control_ros.core.jit import compiled, record, sign, to_fixed_tuple
from impulse_control_ros.core.metrics import added, outside_since, Sums
from impulse_control_ros.core.plant import DIVERGED, long_step, short_step
from impulse_control_ros.core.varied import Rows

LANES = 32  # four vectors of eight: enough to hide latency, few enough for the L1 cache
CACHE_LINE = 64  # bytes; a vector across two lines takes twice as long to load
SUMS, X_R = len(Sums._fields), Gains._fields.index('x_r')
KEPT = LawState._fields.index('hold') + 1  # fields that a law without options uses
UNUSED = FRESH[KEPT:]
NOW = (
    'position', 'velocity', 'damping', 'noise', 'wave', 'effort', 'area', 'first_error',
    'inverse_m', 'old_position', 'old_velocity', 'whole', 'bounded', 'm', 'F_c', 'time_step',
    # of the supervision
    'older_velocity', 'bound', 'resume', 'special', 'apart', 'noted', 'synced',
)  # fmt: skip
# a block of runs is one record, so that the compiler sees that these arrays do not overlap
BLOCK = record(
    [
        *((name, 'f8', (LANES,)) for name in NOW),
        ('guard', 'i8', (LANES,)),
        *((name, DAMPING[name], (LANES,)) for name in DAMPING.names or ()),
        ('gains', 'f8', (GAINS, LANES)),
        ('law_state', 'f8', (KEPT, LANES)),
        ('sums', 'f8', (SUMS, LANES)),
        ('apart_state', 'f8', (KEPT, LANES)),
        ('apart_answer', 'f8', (3, LANES)),
    ]
)


def places(runs: int) -> np.ndarray:
    """Return the run of each lane, shape (blocks, LANES); the last one fills the last block."""
    count = -(-runs // LANES)
    return np.minimum(np.arange(count * LANES), runs - 1).reshape(count, LANES)


def loaded(rows: Rows) -> np.ndarray:
    """Pack runs into blocks, dtype BLOCK; copies of the last run fill the last block."""
    at = places(len(rows.plant))
    count = len(at)
    memory = np.zeros(count * BLOCK.itemsize + CACHE_LINE, np.uint8)
    offset = -memory.ctypes.data % CACHE_LINE
    blocks = memory[offset : offset + count * BLOCK.itemsize].view(BLOCK)
    for name in ('m', 'F_c', 'time_step'):
        blocks[name] = rows.plant[name][at]
    for name in DAMPING.names or ():
        blocks[name] = rows.plant['damping'][name][at]
    for i, name in enumerate(Gains._fields):
        blocks['gains'][:, i] = rows.law[name][at]
    blocks['position'], blocks['velocity'] = rows.start[at, 0], rows.start[at, 1]
    blocks['damping'], blocks['bounded'] = blocks['value'], 1.0
    blocks['first_error'] = blocks['position'] - rows.law['x_r'][at]
    blocks['inverse_m'] = 1.0 / blocks['m']
    blocks['special'] = 1.0  # the first sample
    return blocks


@compiled
def answer_lanes(block):
    """Evaluate the control law of each lane."""
    for j in range(LANES):
        gains = Gains(*to_fixed_tuple(block.gains[:, j], GAINS))
        state = LawState(*(to_fixed_tuple(block.law_state[:, j], KEPT) + UNUSED))
        command, after = control_step(
            state, gains, None, None, block.position[j], block.velocity[j]
        )
        block.effort[j], block.area[j] = command.effort, command.area
        block.guard[j] = command.guard
        for i in range(KEPT):
            block.law_state[i, j] = after[i]


@compiled
def add_lanes(block, outside, tolerances, tick):
    """Add the sample of each lane to its sums."""
    for j in range(LANES):
        error = block.position[j] - block.gains[X_R, j]
        sums = added(
            Sums(*to_fixed_tuple(block.sums[:, j], SUMS)),
            sign(block.first_error[j]),
            error,
            block.velocity[j],
            block.effort[j],
            block.area[j],
            block.guard[j],
        )
        for i in range(SUMS):
            block.sums[i, j] = sums[i]
        small = (abs(block.position[j]) < DIVERGED) & (abs(block.velocity[j]) < DIVERGED)
        block.bounded[j] = block.bounded[j] if small else 0.0
    for i in range(len(tolerances)):
        last, tolerance = outside[i], tolerances[i]
        for j in range(LANES):
            error = block.position[j] - block.gains[X_R, j]
            last[j] = outside_since(last[j], tick, error, tolerance)


@compiled
def set_damping(block, tick, noisy, wavy):
    """Set the damping of each lane for the sample that starts at ``tick``."""
    if noisy:
        for j in range(LANES):
            block.noise[j] = filtered(
                block.noise[j], block.pole[j], block.gain[j], block.seed[j], tick
            )
    if wavy:
        for j in range(LANES):
            block.wave[j] = sine(block.turn[j] * tick)
    if noisy or wavy:
        for j in range(LANES):
            block.damping[j] = within_bounds(
                block.kind[j],
                block.value[j],
                block.lower[j],
                block.upper[j],
                block.noise[j],
                block.wave[j],
            )


@compiled
def step_lanes(block):
    """Step the axis of each lane."""
    left = LANES
    for j in range(LANES):
        block.older_velocity[j] = block.old_velocity[j]
        block.old_position[j], block.old_velocity[j] = block.position[j], block.velocity[j]
        block.position[j], block.velocity[j], whole = short_step(
            block.position[j],
            block.velocity[j],
            block.effort[j],
            block.damping[j],
            block.inverse_m[j],
            block.F_c[j],
            block.time_step[j],
        )
        block.whole[j] = 1.0 if whole else 0.0
        left -= 1 if whole else 0
    for j in range(LANES if left else 0):
        if block.whole[j] == 0.0:
            block.position[j], block.velocity[j] = long_step(
                block.old_position[j],
                block.old_velocity[j],
                block.effort[j],
                block.damping[j],
                block.m[j],
                block.F_c[j],
                block.time_step[j],
            )
