"""
Steps LANES runs side by side, with the laws of one run.

==========  ============  ====  =====================================================
symbol      name          unit  meaning
==========  ============  ====  =====================================================
j           lane          1     place of a run among the LANES that step together
k           tick          1     sample
==========  ============  ====  =====================================================

A step of one run is a chain in which each operation waits for the one before. LANES runs side
by side fill that waiting: the conditions in the laws only choose between values, so the inner
loops over the lanes become vector instructions. The rare step that `short_step` does not cover
is taken alone.

A block holds LANES runs: the records of one run, each field an array over the lanes. It is one
record, so that the compiler sees that these arrays do not overlap.
"""

import numpy as np

from impulse_control_ros.core.damping import (
    DAMPING,
    filtered,
    NOISE,
    sine,
    SINUSOIDAL,
    within_bounds,
)
from impulse_control_ros.core.impulse import answered, GAINS, Gains, MEMORY, Memory
from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.metrics import added, outside_since, SUMS, Sums
from impulse_control_ros.core.plant import AXIS, DIVERGED, long_step, short_step

LANES = 32  # four vectors of eight: enough to fill the waiting, few enough for the L1 cache
CACHE_LINE = 64  # bytes; a vector across two lines takes twice as long to load
NOW = np.dtype(
    [
        (name, 'f8')
        for name in (
            'position',
            'velocity',
            'damping',
            'noise',
            'wave',
            'effort',
            'area',
            'first_error',
            'inverse_m',
            'old_position',
            'old_velocity',
            'whole',
            'bounded',
        )
    ]
    + [('guard', 'i8')]
)


def laned(record: np.dtype[np.void]) -> np.dtype[np.void]:
    """Return ``record`` with an array over the lanes for each field."""
    return np.dtype([(name, record[name], (LANES,)) for name in record.names or ()])


BLOCK = np.dtype(
    [
        ('now', laned(NOW)),
        ('axis', laned(AXIS)),
        ('profile', laned(DAMPING)),
        ('gains', laned(GAINS)),
        ('memory', laned(MEMORY)),
        ('sums', laned(SUMS)),
    ]
)


def loaded(
    axis: np.ndarray,
    start: np.ndarray,
    profile: np.ndarray,
    gains: np.ndarray,
) -> np.ndarray:
    """
    Put runs into blocks; the last run fills what is left.

    ``axis``, ``profile`` and ``gains`` have shape (runs,) and dtypes AXIS, DAMPING and GAINS,
    ``start`` has shape (runs, 2): position [m] and velocity [m/s].
    """
    count = -(-len(axis) // LANES)
    at = np.minimum(np.arange(count * LANES), len(axis) - 1).reshape(count, LANES)
    memory = np.zeros(count * BLOCK.itemsize + CACHE_LINE, np.uint8)
    offset = -memory.ctypes.data % CACHE_LINE
    blocks = memory[offset : offset + count * BLOCK.itemsize].view(BLOCK)
    for part, rows in (('axis', axis), ('profile', profile), ('gains', gains)):
        for name in rows.dtype.names or ():
            blocks[part][name] = rows[name][at]
    now = blocks['now']
    now['position'], now['velocity'] = start[at, 0], start[at, 1]
    now['damping'], now['bounded'] = profile['value'][at], 1.0
    now['first_error'] = now['position'] - blocks['gains']['x_r']
    now['inverse_m'] = 1.0 / blocks['axis']['m']
    return blocks


@compiled
def answer_lanes(block):
    """Do the control law of each lane."""
    now, m, g = block.now, block.memory, block.gains
    for j in range(LANES):
        memory = Memory(
            m.started[j],
            m.position[j],
            m.side[j],
            m.direction[j],
            m.x_r[j],
            m.pending[j],
            m.pulsed[j],
            m.hold[j],
        )
        gains = Gains(
            g.K[j],
            g.D[j],
            g.position_gain[j],
            g.velocity_gain[j],
            g.x_r[j],
            g.impulses[j],
            g.effort_limit[j],
            g.position_deadband[j],
            g.velocity_deadband[j],
            g.hold_off[j],
            g.time_step[j],
            g.sample_rate[j],
        )
        now.effort[j], now.area[j], now.guard[j], after = answered(
            memory, gains, now.position[j], now.velocity[j]
        )
        m.started[j], m.position[j], m.side[j] = after.started, after.position, after.side
        m.direction[j], m.x_r[j], m.pending[j] = after.direction, after.x_r, after.pending
        m.pulsed[j], m.hold[j] = after.pulsed, after.hold


@compiled
def add_lanes(block, outside, tolerances, tick):
    """Add the sample of each lane to its sums."""
    now, s, x_r = block.now, block.sums, block.gains.x_r
    for j in range(LANES):
        sums = added(
            Sums(
                s.overshoot[j],
                s.iae[j],
                s.ise[j],
                s.position_zero[j],
                s.velocity_zero[j],
                s.sticking[j],
                s.impulse_area[j],
                s.peak_effort[j],
                s.peak_velocity[j],
            ),
            sign(now.first_error[j]),
            now.position[j] - x_r[j],
            now.velocity[j],
            now.effort[j],
            now.area[j],
            now.guard[j],
        )
        s.overshoot[j], s.iae[j], s.ise[j] = sums.overshoot, sums.iae, sums.ise
        s.position_zero[j], s.velocity_zero[j] = sums.position_zero, sums.velocity_zero
        s.sticking[j], s.impulse_area[j] = sums.sticking, sums.impulse_area
        s.peak_effort[j], s.peak_velocity[j] = sums.peak_effort, sums.peak_velocity
        small = (abs(now.position[j]) < DIVERGED) & (abs(now.velocity[j]) < DIVERGED)
        now.bounded[j] = now.bounded[j] if small else 0.0
    for i in range(len(tolerances)):
        last, tolerance = outside[i], tolerances[i]
        for j in range(LANES):
            last[j] = outside_since(last[j], tick, now.position[j] - x_r[j], tolerance)


@compiled
def set_damping(block, tick, noisy, wavy):
    """Set the damping of each lane for the sample that starts at ``tick``."""
    now, p = block.now, block.profile
    if noisy:
        for j in range(LANES):
            now.noise[j] = filtered(now.noise[j], p.pole[j], p.gain[j], p.seed[j], tick)
    if wavy:
        for j in range(LANES):
            now.wave[j] = sine(p.turn[j] * tick)
    if noisy or wavy:
        for j in range(LANES):
            now.damping[j] = within_bounds(
                p.kind[j], p.value[j], p.lower[j], p.upper[j], now.noise[j], now.wave[j]
            )


@compiled
def step_lanes(block):
    """Step the axis of each lane."""
    now, axis = block.now, block.axis
    left = LANES
    for j in range(LANES):
        now.old_position[j], now.old_velocity[j] = now.position[j], now.velocity[j]
        now.position[j], now.velocity[j], whole = short_step(
            now.position[j],
            now.velocity[j],
            now.effort[j],
            now.damping[j],
            now.inverse_m[j],
            axis.F_c[j],
            axis.time_step[j],
        )
        now.whole[j] = 1.0 if whole else 0.0
        left -= 1 if whole else 0
    for j in range(LANES if left else 0):
        if now.whole[j] == 0.0:
            now.position[j], now.velocity[j] = long_step(
                now.old_position[j],
                now.old_velocity[j],
                now.effort[j],
                now.damping[j],
                axis.m[j],
                axis.F_c[j],
                axis.time_step[j],
            )


@compiled
def run_blocks(blocks, steps, tolerances, outside):
    """
    Run every block for ``steps`` steps.

    ``outside``, shape (blocks, tolerances, LANES), becomes the last tick outside each tolerance.
    """
    for i in range(len(blocks)):
        block = blocks[i]
        noisy, wavy = False, False
        for j in range(LANES):
            noisy |= block.profile.kind[j] == NOISE
            wavy |= block.profile.kind[j] == SINUSOIDAL
        for tick in range(steps + 1):
            answer_lanes(block)
            add_lanes(block, outside[i], tolerances, float(tick))
            if tick < steps:
                set_damping(block, tick, noisy, wavy)
                step_lanes(block)
