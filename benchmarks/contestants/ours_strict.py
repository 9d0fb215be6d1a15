"""Ours, exact: solve() in the strict reading, and its trajectory at 1e-4."""

from impulse_control_ros.core.hybrid import solve

READING = 'STRICT'
PACKAGES = ('numba',)
KIND = 'ours'


def prepare(case):
    """Return the run."""

    def run():
        solution = solve(case.axis, case.controller, case.seconds)
        times, position, _ = solution.sampled(case.time_step, case.steps)
        return times, position

    return run
