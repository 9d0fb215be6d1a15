"""Vectorised numpy at 1e-4: the plain loop's law for many runs a step."""

import numpy as np

READING = 'STRICT'
KIND = 'batch'
PACKAGES = ('numpy',)
RUNS = 1024


def prepare(case):
    """Return the runs; the first one's trajectory is kept."""
    m, d, F_c, K, D, dt = case.m, case.d, case.F_c, case.K, case.D, case.time_step
    against, towards = (1.0 - case.bounce) * m / dt, case.kick * m / dt

    def response(duration):
        decay = np.exp(-d * duration / m)
        gain = (1.0 - decay) / d
        return decay, gain, m * gain, (duration - m * gain) / d

    decay, gain, slide, push = response(dt)

    def turn(x, v, force, u):
        stop = np.log1p(-d * v / force) * m / d
        _, _, slid, pushed = response(stop)
        x = x + slid * v + pushed * force
        force = np.sign(u) * np.maximum(np.abs(u) - F_c, 0.0)
        _, gained, _, pushed = response(dt - stop)
        return x + pushed * force, gained * force

    def run():
        x, v = np.full(RUNS, case.x_0), np.zeros(RUNS)
        right, forward, stood, pulsed = x > 0.0, v > 0.0, v > 0.0, v > 0.0
        positions = np.empty(case.steps + 1)
        for k in range(case.steps + 1):
            positions[k] = x[0]
            stands, above, ahead = np.abs(v) <= 1e-6, x > 0.0, v > 0.0
            crossed = (above != right) & ~stands
            turned = (stands | ((ahead != forward) & ~stood & ~pulsed)) & ~crossed
            turned &= np.abs(x) > 1e-6
            u = -K * x - D * v
            if crossed.any():
                u -= np.where(crossed, against * v, 0.0)
            if turned.any():
                u -= np.where(turned, towards * x * np.where(stands & stood, 0.5, 1.0), 0.0)
            right ^= crossed
            stood, forward, pulsed = stands, ahead, crossed | turned
            direction = np.sign(np.where(v != 0.0, v, u))
            sticks = (v == 0.0) & (np.abs(u) <= F_c)
            force = np.where(sticks, 0.0, u - F_c * direction)
            old_x, old_v = x, v
            x, v = x + slide * v + push * force, decay * v + gain * force
            stops = np.flatnonzero((old_v != 0.0) & (v * direction <= 0.0))
            if stops.size:
                x[stops], v[stops] = turn(old_x[stops], old_v[stops], force[stops], u[stops])
        return np.arange(case.steps + 1) * dt, positions

    return run
