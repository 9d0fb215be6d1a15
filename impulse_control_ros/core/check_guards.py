"""
Check whether impulses start exactly where a guard of the control law is met.

=============  ====================================================================================
guard          met by the sample
=============  ====================================================================================
position zero  the error e, extrapolated by guard_lookahead samples, is zero or differs in sign
               from the previous sample, judged by both set-points; the axis moves
velocity zero  the velocity is zero or differs in sign from the previous sample, not because of an
               impulse; or it is zero at the first sample or after a set-point change
sticking       the velocity is zero at this and the previous sample
=============  ====================================================================================

The last two guards need e beyond the dead band and no pending impulse area. At rest they also need
stiction_wait_samples since the last impulse. A velocity within its dead band counts as zero. An
impulse is missed if only the law has it, and unexplained if only the commands have it.
"""

from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.check_report import Check, found, PerSample
from impulse_control_ros.core.control_law import GUARDS, POSITION_ZERO, STICKING, VELOCITY_ZERO

NEVER = 2**62  # samples


class Commands(NamedTuple):
    """
    The states that a controller answered, and its answers, shape (n,).

    ``samples`` are the sample numbers. ``velocity`` is nan where it was not measured; ``guard``
    and ``area`` [N s] are 0 where no impulse started. ``fresh`` is true where the controller had
    no memory of the previous sample, and ``begins`` also where its memory is unknown.
    """

    samples: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    guard: np.ndarray
    area: np.ndarray
    fresh: np.ndarray
    begins: np.ndarray


class Remembered(NamedTuple):
    """
    Internal values of the law at each sample, shape (n,).

    ``velocity`` [m/s] is the velocity used, ``integral`` [N] the integral part of the feedback,
    ``owed`` [N s] the area due, and ``waits`` [N s] the part that effort_limit holds back.
    """

    velocity: np.ndarray
    integral: np.ndarray
    owed: np.ndarray
    waits: np.ndarray


def since(where: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """Return the number of samples since ``where`` was last true, or NEVER: shape (n,)."""
    index = np.arange(len(where))
    last = np.maximum.accumulate(np.where(where, index, -1))
    start = np.maximum.accumulate(np.where(begins, index, 0))
    return np.where(last >= start, index - last, NEVER)


def before(values: np.ndarray, begins: np.ndarray, fill: float) -> np.ndarray:
    """Return the value at the previous sample, ``fill`` where there is none."""
    return np.where(begins, fill, np.concatenate((values[:1], values[:-1])))


def directions(v: np.ndarray, begins: np.ndarray, of: PerSample) -> np.ndarray:
    """Return the sign of v, 0 at rest; leaving rest takes dead band plus hysteresis."""
    speed, way, dead = np.abs(v), np.sign(v), of('velocity_deadband')
    moves = speed > dead + of('velocity_hysteresis')
    is_clear = moves | (speed <= dead) | begins | (way != before(way, begins, 0.0))
    last = np.maximum.accumulate(np.where(is_clear, np.arange(len(v)), 0))
    return np.where(moves, way, 0.0)[last]


def position_zeros(commands: Commands, of: PerSample, v: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return where the error crosses zero, and where the hysteresis lets a crossing count."""
    begins, x_r = commands.begins, of('x_r')
    ahead = commands.position + of('guard_lookahead') * of('time_step') * v
    side, side_before = np.sign(ahead - x_r), before(np.sign(ahead - x_r), begins, 0.0)
    judged_anew = np.sign(before(ahead, begins, 0.0) - x_r)
    crosses = (side_before != 0) & (side != side_before) & (side != judged_anew)
    crosses = np.where(commands.fresh, side == 0.0, crosses)
    far = before(np.abs(ahead - x_r) > of('position_hysteresis'), begins, False).astype(bool)
    fired = before(commands.guard == POSITION_ZERO, begins, False).astype(bool)
    return crosses, since(far, begins) <= since(fired, begins)


def expected_guards(commands: Commands, of: PerSample, memory: Remembered) -> np.ndarray:
    """Return the guard of the impulse that the law starts at each sample, shape (n,)."""
    begins, fresh, x_r = commands.begins, commands.fresh, of('x_r')
    way = directions(memory.velocity, begins, of)
    way_before = before(way, begins, 0.0)
    rests, rested = way == 0.0, way_before == 0.0
    acted = before(memory.owed != 0.0, begins, False).astype(bool)
    turns = (way != way_before) & ~rested & ~acted
    arrives = rests & (fresh | (before(x_r, begins, 0.0) != x_r))

    at_rest = np.minimum.reduce(
        [since(~rests, begins), since(begins, begins) + 1, since(acted, begins) + 1]
    )
    may_push = fresh | ~rested | (at_rest >= of('stiction_wait_samples'))
    may_push &= np.abs(commands.position - x_r) > of('position_deadband')
    may_push &= before(memory.waits, begins, 0.0) == 0.0

    crosses, counts = position_zeros(commands, of, memory.velocity)
    guards = np.select(
        [crosses & ~rests, rests & rested & ~arrives & may_push, (arrives | turns) & may_push],
        [np.where(counts, POSITION_ZERO, 0), STICKING, VELOCITY_ZERO],
        0,
    )
    # no impulse starts for hold_off samples after a position zero
    ago = since(before(commands.guard == POSITION_ZERO, begins, False).astype(bool), begins) + 1
    held = of('hold_off')[np.maximum(np.arange(len(ago)) - ago, 0)] >= ago
    return np.where(of('impulses') & ~held, guards, 0)


def note_of(known: np.ndarray, how: str = '') -> str:
    """Return a note: ``how`` samples are judged, and how many have no ``known`` past."""
    gap = '' if known.all() else f'{(~known).sum()} samples follow unknown ones'
    return '; '.join(filter(None, (how, gap)))


def guard_checks(
    commands: Commands, expected: np.ndarray, known: np.ndarray, how: str = ''
) -> list[Check]:
    """Check that the commands start exactly the impulses of the law; a note says ``how``."""
    differs, fired = known & (commands.guard != expected), commands.guard != 0
    note = note_of(known, how)
    names = np.array(['no impulse', *GUARDS[1:]])
    columns = commands.samples, names[commands.guard], names[expected], np.zeros(len(fired))
    missed = [
        found(f'missed {names[guard]}', '', known, differs & (expected == guard), columns, note)
        for guard in (POSITION_ZERO, VELOCITY_ZERO, STICKING)
    ]
    return [
        *missed,
        found('unexplained impulse', '', known & fired, differs & fired, columns, note),
    ]
