"""Ours, sampled: simulate_batch() at 1e-4 on one thread, with figures of merit."""

import numba
import numpy as np

from impulse_control_ros.core.batch import simulate_batch

READING = 'STRICT'
KIND = 'batch'
PACKAGES = ('numba',)
RUNS = 1024


def prepare(case):
    """Return the runs; a batch keeps no trajectory, so it returns the ends."""
    rows = {'x_0': np.full(RUNS, case.x_0), 'damping.value': np.full(RUNS, case.d)}
    numba.set_num_threads(1)

    def run():
        figures = simulate_batch(case.axis, case.controller, case.seconds, rows)
        return np.full(RUNS, case.seconds), figures['final_error']

    return run
