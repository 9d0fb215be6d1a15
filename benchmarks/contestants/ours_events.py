"""Ours, exact: solve(), its events alone."""

from impulse_control_ros.core.hybrid import Reading, solve

READING = 'ONE_JUMP'
PACKAGES = ('numba',)
KIND = 'ours'


def prepare(case):
    """Return the run."""

    def run():
        events = solve(case.axis, case.controller, case.seconds, reading=Reading.ONE_JUMP).events
        return events['time'], events['position']

    return run
