"""Pathsim: an ODE block, and zero crossings that set its state."""

import numpy as np
from pathsim import Connection, Simulation
from pathsim.blocks import ODE, Scope
from pathsim.events import ZeroCrossing
from pathsim.solvers import RKDP54

READING = 'ONE_JUMP'
KIND = 'interpreted'
PACKAGES = ('pathsim',)


def prepare(case):
    """Return the run."""
    m, damping, F_c, K = case.m, case.d + case.D, case.F_c, case.K
    start = np.array([case.x_0, -case.kick * case.x_0])
    direction = -1.0

    def flow(state, u, t):
        x, v = state
        return np.array([v, -(damping * v + K * x + F_c * direction) / m])

    axis, scope = ODE(flow, start), Scope()

    def jump(x, v):
        nonlocal direction
        axis.engine.state = np.array([x, v])
        direction = 1.0 if v > 0.0 else -1.0

    def at_position_zero(t):
        jump(0.0, case.bounce * axis.engine.state[1])

    def at_velocity_zero(t):
        x = axis.engine.state[0]
        jump(x, -case.kick * x)

    simulation = Simulation(
        [axis, scope],
        [Connection(axis[0], scope[0])],
        [
            ZeroCrossing(lambda t: axis.engine.state[0], at_position_zero, tolerance=1e-10),
            ZeroCrossing(lambda t: axis.engine.state[1], at_velocity_zero, tolerance=1e-8),
        ],
        dt=1e-3,
        Solver=RKDP54,
        tolerance_lte_rel=1e-7,
        tolerance_lte_abs=1e-8,
        log=False,
    )

    def run():
        nonlocal direction
        direction = -1.0
        simulation.run(case.seconds, reset=True)
        times, (positions,) = scope.read()
        return times, positions

    return run
