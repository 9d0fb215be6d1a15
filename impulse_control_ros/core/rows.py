"""
Runs one after another, with all of core/nonidealities.py and core/careful.py.

The lanes of core/lanes.py know the ideal axis and the plain law, some ten times faster; the bits
of a run are those of `simulate` in both.
"""

import numpy as np

from impulse_control_ros.core.careful import control_carefully
from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.metrics import added, outside_since, SUMS, Sums
from impulse_control_ros.core.plant import DIVERGED
from impulse_control_ros.core.plant_step import plant_step, sense

# What a run leaves: its last state, whether it was ever out of bounds, its sums.
LEFT = np.dtype([('position', 'f8'), ('first_error', 'f8'), ('bounded', 'f8'), ('sums', SUMS)])


@compiled
def clear(hidden, memory, watch):
    """Set what a run remembers to nothing, as `at_rest`, `fresh_memory` and `fresh_watch`."""
    inner, old, seen = hidden[0], memory[0], watch[0]
    inner.measured, inner.actuator, inner.noise = np.nan, 0.0, np.nan
    for i in range(len(inner.queue)):
        inner.queue[i] = 0.0
    old.started, old.position, old.side, old.direction = 0.0, 0.0, 0.0, 0.0
    old.x_r, old.pending, old.pulsed, old.hold = 0.0, 0.0, 0.0, 0.0
    seen.seen, seen.position, seen.velocity, seen.kick = 0.0, 0.0, 0.0, 0.0
    seen.unarmed, seen.stood, seen.integral = 0.0, 0.0, 0.0


@compiled
def run_row(
    axis,
    profile,
    hardware,
    state,
    hidden,
    gains,
    care,
    memory,
    watch,
    answer,
    steps,
    tolerances,
    outside,
):
    """
    Run one row; returns (sums, first error, whether bounded).

    ``outside``, shape (tolerances,), becomes the last tick outside each tolerance.
    """
    now, seen, told, x_r = state[0], hidden[0], answer[0], gains[0].x_r
    sums = Sums(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    first_error, bounded = now.position - x_r, True
    sense(axis, hardware, state, hidden)
    for tick in range(steps + 1):
        control_carefully(memory, watch, gains, care, seen.position, seen.velocity, answer)
        error = now.position - x_r
        sums = added(
            sums, sign(first_error), error, now.velocity, told.effort, told.area, told.guard
        )
        for i in range(len(tolerances)):
            outside[i] = outside_since(outside[i], float(tick), error, tolerances[i])
        bounded = bounded and abs(now.position) < DIVERGED and abs(now.velocity) < DIVERGED
        if tick < steps:
            plant_step(axis, profile, hardware, state, hidden, told.effort)
    return sums, first_error, bounded


@compiled
def run_rows(
    axis,
    profile,
    hardware,
    states,
    gains,
    care,
    hidden,
    memory,
    watch,
    answer,
    steps,
    tolerances,
    outside,
    left,
):
    """
    Run rows of shape (n,) from ``states`` on; ``left``, dtype LEFT, becomes what they leave.

    ``outside`` has shape (n, tolerances); the five before ``steps`` are scratch of shape (1,).
    """
    for i in range(len(axis)):
        one = slice(i, i + 1)
        clear(hidden, memory, watch)
        sums, first_error, bounded = run_row(
            axis[one],
            profile[one],
            hardware[one],
            states[one],
            hidden,
            gains[one],
            care[one],
            memory,
            watch,
            answer,
            steps,
            tolerances,
            outside[i],
        )
        one_left = left[i]
        one_left.position, one_left.first_error = states[i].position, first_error
        one_left.bounded = 1.0 if bounded else 0.0
        total = one_left.sums
        total.overshoot, total.iae, total.ise = sums.overshoot, sums.iae, sums.ise
        total.position_zero, total.velocity_zero = sums.position_zero, sums.velocity_zero
        total.sticking, total.impulse_area = sums.sticking, sums.impulse_area
        total.peak_effort, total.peak_velocity = sums.peak_effort, sums.peak_velocity
