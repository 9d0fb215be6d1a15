"""
Figures of merit of a recorded or simulated run.

All take arrays of one run on the sampling grid: ``time`` [s] and ``error`` e = x - x_r [m].
"""

import numpy as np


def settling_time(time: np.ndarray, error: np.ndarray, tolerance: float) -> float:
    """Return the first time [s] after which abs(e) stays within ``tolerance`` [m], or nan."""
    outside = np.flatnonzero(np.abs(error) > tolerance)
    if outside.size == 0:
        return float(time[0])
    if outside[-1] + 1 == len(time):
        return float('nan')
    return float(time[outside[-1] + 1])


def overshoot(error: np.ndarray) -> float:
    """Return how far [m] the error goes to the side opposite of where it starts, at most."""
    return float(max(0.0, np.max(-np.sign(error[0]) * error)))


def peak(values: np.ndarray) -> float:
    """Return the largest absolute value."""
    return float(np.max(np.abs(values)))


def first_position_zero(error: np.ndarray) -> int | None:
    """Return the index of the first sample at or past e = 0, or None."""
    past = np.flatnonzero(np.sign(error) != np.sign(error[0]))
    return int(past[0]) if past.size else None
