"""Ours, exact: solve(), and its trajectory at 1e-4."""

from impulse_control_ros.core.hybrid import Reading, solve

READING = 'ONE_JUMP'
PACKAGES = ('numba',)
KIND = 'ours'


def prepare(case):
    """Return the run."""

    def run():
        solution = solve(case.axis, case.controller, case.seconds, reading=Reading.ONE_JUMP)
        times, position, _ = solution.sampled(case.time_step, case.steps)
        return times, position

    return run
