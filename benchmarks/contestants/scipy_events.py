"""SciPy: solve_ivp to the next terminal event, then the jump, then again."""

import numpy as np
from scipy.integrate import solve_ivp

READING = 'ONE_JUMP'
KIND = 'interpreted'
PACKAGES = ('scipy',)


def prepare(case):
    """Return the run."""
    m, damping, F_c, K = case.m, case.d + case.D, case.F_c, case.K

    def flow(t, state, direction):
        x, v = state
        return v, -(damping * v + K * x + F_c * direction) / m

    def position_zero(t, state, direction):
        return direction * state[0]

    def velocity_zero(t, state, direction):
        return direction * state[1]

    position_zero.terminal, position_zero.direction = True, 1.0
    velocity_zero.terminal, velocity_zero.direction = True, -1.0

    def run():
        t, x, v = 0.0, case.x_0, -case.kick * case.x_0
        times, positions = [[t]], [[x]]
        while t < case.seconds:
            direction = np.sign(v)
            # A zero that the arc starts at would count at once, so it has no event.
            events = [velocity_zero, position_zero] if x * direction < 0.0 else [velocity_zero]
            arc = solve_ivp(
                flow,
                (t, case.seconds),
                (x, v),
                'DOP853',
                events=events,
                args=(direction,),
                rtol=1e-7,
                atol=1e-9,
            )
            times.append(arc.t[1:])
            positions.append(arc.y[0, 1:])
            t, (x, v) = arc.t[-1], arc.y[:, -1]
            if arc.t_events[0].size:
                v = -case.kick * x
            elif arc.status == 1:
                x, v = 0.0, case.bounce * v
        return np.concatenate(times), np.concatenate(positions)

    return run
