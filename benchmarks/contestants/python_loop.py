"""A plain Python loop at 1e-4: exact steps, stop instants, guards, PD and impulses."""

import math

READING = 'STRICT'
KIND = 'interpreted'
PACKAGES = ()


def prepare(case):
    """Return the run."""
    m, d, F_c, K, D, dt = case.m, case.d, case.F_c, case.K, case.D, case.time_step
    against, towards = (1.0 - case.bounce) * m / dt, case.kick * m / dt

    def response(duration):
        decay = math.exp(-d * duration / m)
        gain = (1.0 - decay) / d
        return decay, gain, m * gain, (duration - m * gain) / d

    decay, gain, slide, push = response(dt)

    def turn(x, v, force, u):
        stop = math.log1p(-d * v / force) * m / d
        _, _, slid, pushed = response(stop)
        x += slid * v + pushed * force
        if abs(u) <= F_c:
            return x, 0.0
        _, gained, _, pushed = response(dt - stop)
        force = u - math.copysign(F_c, u)
        return x + pushed * force, gained * force

    def run():
        x, v = case.x_0, 0.0
        right, forward, stood, pulsed = x > 0.0, False, False, False
        times, positions = [], []
        for k in range(case.steps + 1):
            times.append(k * dt)
            positions.append(x)
            u = -K * x - D * v
            stands = abs(v) <= 1e-6
            impulse = 0.0
            if (x > 0.0) != right and not stands:
                impulse = -against * v
                right = not right
            elif abs(x) > 1e-6:
                if stands:
                    impulse = -towards * x * (0.5 if stood else 1.0)
                elif (v > 0.0) != forward and not stood and not pulsed:
                    impulse = -towards * x
            stood, forward, pulsed = stands, v > 0.0, impulse != 0.0
            u += impulse
            if v == 0.0 and abs(u) <= F_c:
                continue
            force = u - math.copysign(F_c, v if v != 0.0 else u)
            ahead = decay * v + gain * force
            if v * ahead < 0.0 or (ahead == 0.0 and v != 0.0):
                x, v = turn(x, v, force, u)
            else:
                x, v = x + slide * v + push * force, ahead
        return times, positions

    return run
