"""
Check whether a motion obeys the axis (3): the flow map, sample by sample.

With effort u and damping d constant over a sample of length dt, (3) integrates exactly:

    m (v+ - v) = (u + w) dt - d (x+ - x) - F dt,    x+ - x = dt (v + h (v+ - v)),

============  =============  =======  =======================================================
symbol        name           unit     meaning
============  =============  =======  =======================================================
d             d              N s/m    any value within the bounds (1), if it is not known
F             friction       N        mean friction: F_c against a motion that does not turn,
                                      F_c to F_s below v_s, any of +-F_s in a sample with a stop
w             disturbance    N        force beside the effort
h             weight         1        1 / (1 - exp(-z)) - 1 / z, z = d dt / m: 1/2 and a little
                                      more; any of [0, 1] where friction varies in the sample
============  =============  =======  =======================================================

Measurement errors widen the tolerance. The velocity error is the same over one sample and over
many. With a noisy velocity, the first equation is therefore also checked as a sum over many
samples.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.check_report import (
    bounded,
    Check,
    Gains,
    LoopSamples,
    per_sample,
    PerSample,
    Plants,
    ROUNDING,
)

Pair = tuple[np.ndarray, np.ndarray]
WINDOWS = (10, 100, 1000)  # samples, where the velocity is noisy
LARGEST_NOISE = 6.0  # standard deviations, see `normal` in core/nonidealities.py
LARGEST_FORCE = 8.0  # standard deviations of filtered noise; larger values do not occur
SINE = 1e-9  # relative tolerance between two ways to compute a sinusoidal force


class Axis(NamedTuple):
    """The axis from each state to the next: shape (n - 1,), some as (lower, upper) bounds."""

    m: np.ndarray
    d: Pair
    F_c: np.ndarray
    F_s: np.ndarray
    v_s: np.ndarray
    disturbance: Pair


class Errors(NamedTuple):
    """
    Largest errors of the measured position [m] and velocity [m/s].

    ``differs``, shape (n - 1,), is true where the velocity at the end of a sample is the
    difference of the measured positions.
    """

    position: float = 0.0
    velocity: float = 0.0
    differs: np.ndarray | bool = False


def check_motion(loop: LoopSamples, plant: Plants, errors: Errors | None = None) -> list[Check]:
    """Check the motion of an axis; ``errors`` defaults to the errors of its sensor."""
    every = per_sample(plant, len(loop.time))

    def of(name: str) -> np.ndarray:
        return every(name)[:-1]

    tick, known = np.rint(loop.time[:-1] / loop.time_step), loop.damping[:-1]
    loaded = tick >= np.rint(of('payload.time') / loop.time_step)
    is_constant = of('damping.kind') == 'constant'
    lower, upper = (
        np.where(is_constant, of('damping.value'), of(f'damping.{end}'))
        for end in ('lower', 'upper')
    )
    F_c, F_s = of('F_c'), of('stribeck.F_s')
    axis = Axis(
        m=of('m') + np.where(loaded, of('payload.mass'), 0.0),
        d=(np.where(np.isnan(known), lower, known), np.where(np.isnan(known), upper, known)),
        F_c=F_c,
        F_s=np.maximum(F_s, F_c),
        v_s=np.where(F_s > F_c, of('stribeck.v_s'), 0.0),
        disturbance=disturbance(of, tick),
    )
    note = 'not recorded' if np.isnan(known).all() else ''
    in_bounds = bounded('damping', 'N s/m', known, (lower, upper), ROUNDING * upper, note=note)
    return [*motion_checks(loop, axis, errors or errors_of(of)), in_bounds]


def check_foreign_motion(loop: LoopSamples, gains: Gains, errors: Errors) -> list[Check]:
    """
    Check the motion of an axis with unknown parameters, under the assumptions of the paper.

    The axis has the mass of the control law, damping in [0, d_bar], and friction of any size that
    opposes the motion.
    """
    of = per_sample(gains, len(loop.time))
    none, any_size = np.zeros(len(loop.time) - 1), np.full(len(loop.time) - 1, np.inf)
    axis = Axis(
        m=of('m')[:-1],
        d=(none, of('d_bar')[:-1]),
        F_c=none,
        F_s=any_size,
        v_s=any_size,
        disturbance=(none, none),
    )
    return motion_checks(loop, axis, errors)


def errors_of(of: PerSample) -> Errors:
    """Return the largest errors of a plant's sensor."""
    noise = LARGEST_NOISE * of('sensor.position_noise') + 0.5 * of('sensor.resolution')
    return Errors(
        position=float(noise.max()),
        velocity=LARGEST_NOISE * float(of('sensor.velocity_noise').max()),
        differs=of('sensor.velocity') == 'difference',
    )


def disturbance(of: PerSample, tick: np.ndarray) -> Pair:
    """Return the bounds of the disturbance [N] over the sample from each ``tick``."""
    dt, kind = of('time_step'), of('disturbance.kind')
    start, end = (np.rint(of(f'disturbance.{name}') / dt) for name in ('start', 'end'))
    acts = (start <= tick) & ((end == 0) | (tick < end))
    force = np.where(acts, of('disturbance.force'), 0.0)
    turns = of('disturbance.bandwidth') * dt * (tick - start)
    shape = np.where(kind == 'sinusoidal', np.sin(2 * np.pi * turns), kind == 'constant')
    spread = np.select([kind == 'noise', kind == 'sinusoidal'], [LARGEST_FORCE, SINE], 0.0)
    spread = spread * np.abs(force)
    return force * shape - spread, force * shape + spread


def motion_checks(loop: LoopSamples, axis: Axis, errors: Errors) -> list[Check]:
    """Check that each state follows from the previous one, in position and momentum."""
    # a velocity that is a difference of positions is only checked as such
    differs = np.broadcast_to(errors.differs, len(loop.dt))
    mean = np.where(differs, loop.velocity[1:], np.nan)
    v = np.where(np.append(differs[:1], differs), np.nan, loop.velocity)
    loop, before, after = replace(loop, velocity=v), v[:-1], v[1:]
    # an axis that leaves rest moves in one direction from the start of the sample
    leaves = (before == 0.0) & (errors.velocity == 0.0)
    slowest = np.minimum(np.abs(before), np.abs(after)) - errors.velocity
    moves = leaves | ((np.sign(before) == np.sign(after)) & (slowest > 0.0))
    way = np.where(moves, np.sign(after), 0.0)  # 0 where the axis may stop or turn
    slow = slowest < axis.v_s
    checks = [position_steps(loop, axis, errors, slow | (way == 0.0), mean)]
    forces = force_bounds(loop, axis, errors, way, slow)
    sums = WINDOWS if errors.velocity and np.isfinite(axis.F_s).all() else ()
    return checks + [
        momentum(loop, axis, errors, forces, window)
        for window in (1, *sums)
        if window < len(loop.time)
    ]


def weight(z: np.ndarray) -> np.ndarray:
    """Return h of d dt / m, shape (n,)."""
    large = np.maximum(z, 1e-2)
    return np.where(z < 1e-2, 0.5 + z / 12 - z**3 / 720, -1 / np.expm1(-large) - 1 / large)


def position_steps(
    loop: LoopSamples, axis: Axis, errors: Errors, varies: np.ndarray, mean: np.ndarray
) -> Check:
    """
    Check each position step; the friction ``varies`` in some.

    Where the sensor measures the ``mean`` velocity (nan elsewhere), only this velocity is checked.
    """
    x, before, change = loop.position, loop.velocity[:-1], np.diff(loop.velocity)
    weights = [
        np.where(varies, free, weight(end * loop.dt / axis.m))
        for free, end in zip((0.0, 1.0), axis.d, strict=True)
    ]
    is_mean = ~np.isnan(mean)
    ends = [loop.dt * np.where(is_mean, mean, before + share * change) for share in weights]
    size = np.abs(x[:-1]) + np.abs(x[1:]) + np.maximum(*map(np.abs, ends))
    error = loop.dt * errors.velocity + np.where(is_mean, 0.0, 2 * errors.position)
    step = np.where(loop.breaks[1:], np.nan, np.diff(x))
    bounds = np.minimum(*ends), np.maximum(*ends)
    return bounded('position step', 'm', step, bounds, ROUNDING * size + error)


def force_bounds(
    loop: LoopSamples, axis: Axis, errors: Errors, way: np.ndarray, slow: np.ndarray
) -> Pair:
    """Return the bounds that forces set on v+ - v [m/s] in each sample, shape (n - 1,)."""
    dt, v = loop.dt, loop.velocity
    largest = np.where(slow, axis.F_s, axis.F_c)
    against = np.where(way > 0, axis.F_c, -np.where(way < 0, largest, axis.F_s))
    along = np.where(way < 0, -axis.F_c, np.where(way > 0, largest, axis.F_s))
    # the displacement, from the more accurate measurement, and its error
    other = dt * (errors.velocity + 0.5 * np.abs(np.diff(v)))
    error = np.minimum(2 * errors.position, other)
    step = np.where(
        2 * errors.position <= other, np.diff(loop.position), 0.5 * dt * (v[:-1] + v[1:])
    )
    drags = [end * (step + side * error) for end in axis.d for side in (-1, 1)]
    lower, upper = ((end + loop.applied[:-1]) * dt for end in axis.disturbance)
    return (
        (lower - np.maximum.reduce(drags) - along * dt) / axis.m,
        (upper - np.minimum.reduce(drags) - against * dt) / axis.m,
    )


def momentum(loop: LoopSamples, axis: Axis, errors: Errors, forces: Pair, window: int) -> Check:
    """Check the momentum balance over each ``window`` of samples."""
    x, v = np.abs(loop.position), np.abs(loop.velocity)
    friction = np.where(np.isinf(axis.F_s), 0.0, axis.F_s)
    terms = (np.abs(loop.applied[:-1]) + friction) * loop.dt
    terms = (terms + axis.d[1] * (x[1:] + x[:-1])) / axis.m + v[1:] + v[:-1]
    breaks = loop.breaks[1:] | np.isnan(forces[0])
    parts = (np.where(breaks, 0.0, part) for part in (*forces, ROUNDING * terms))
    lower, upper, rounding, broken = (summed(part, window) for part in (*parts, 1.0 * breaks))
    change = loop.velocity[window:] - loop.velocity[:-window]
    unknown = np.isnan(loop.velocity).sum()
    m = axis.m[: len(change)]
    return bounded(
        'momentum' if window == 1 else f'momentum of {window} samples',
        'N s',
        m * np.where(broken > 0, np.nan, change),
        (m * lower, m * upper),
        m * (rounding + 2 * errors.velocity),
        note=f'{unknown} velocities were not measured' if unknown else '',
    )


def summed(values: np.ndarray, window: int) -> np.ndarray:
    """Return the sums over each ``window`` of values."""
    if window == 1:
        return values
    total = np.concatenate(([0.0], np.cumsum(values)))
    return total[window:] - total[:-window]
