"""Ours, exact: solve(), and its trajectory at 1e-4."""

import numpy as np

from impulse_control_ros.core.hybrid import Reading, solve

READING = 'ONE_JUMP'
PACKAGES = ('numba',)
KIND = 'ours'


def prepare(case):
    """Return the run."""
    def run():
        times = np.arange(case.steps + 1) * case.time_step
        solution = solve(case.axis, case.controller, times[-1], reading=Reading.ONE_JUMP)
        position, _ = solution.at(times)
        return times, position
    return run
