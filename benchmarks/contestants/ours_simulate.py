"""Ours, sampled: simulate() at 1e-4, everything recorded."""

from impulse_control_ros.core.simulate import simulate

READING = 'STRICT'
PACKAGES = ('numba',)
KIND = 'ours'


def prepare(case):
    """Return the run."""

    def run():
        made = simulate(case.axis, case.controller, case.seconds)
        return made.time, made.position

    return run
