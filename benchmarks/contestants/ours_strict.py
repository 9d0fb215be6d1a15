"""Ours, exact: solve() in the strict reading, and its trajectory at 1e-4."""

import numpy as np

from impulse_control_ros.core.hybrid import solve

READING = 'STRICT'
PACKAGES = ('numba',)
KIND = 'ours'


def prepare(case):
    """Return the run."""
    def run():
        times = np.arange(case.steps + 1) * case.time_step
        solution = solve(case.axis, case.controller, times[-1])
        position, _ = solution.at(times)
        return times, position
    return run
