"""
The damping d(t) by blocks of a record, and the bound d_bar that covers it.

With m, F_c and o of the whole record, each block j of about 30 ms gives

    d_j = (dt sum phi u - m (...) - F_c (...) - o (...)) / sum phi_k (x_{k+1} - x_{k-1}) / 2

with the standard error SE_j: noise of the position, friction that the model lacks, and the
uncertainty of m, F_c and o. Blocks in which the axis turns are left out, for the way back cancels
the way out and a small error of the friction is a large one of d; and so are those of less than
5 encoder steps, between which the axis may have stood. Of the J others with SE_j < 0.15 d_j,

    d_bar = max_j (d_j + z SE_j) + max_j abs(d_{j+1} - d_j) / 2,    z = z_(1 - 0.05 / J).

The first term bounds the mean of each block, all at once with 95 % confidence (Bonferroni). The
second allows for the variation within a block, which is half of that between neighbours.
"""

from statistics import NormalDist

import numpy as np

from impulse_control_ros.core.identification import DampingBlocks
from impulse_control_ros.core.weak_form import Windows

LARGEST_ERROR = 0.15  # of d_j
MISSED = 0.05  # probability that d_bar is below the damping of a block
ONE_WAY = 1.0 - 1e-9  # of a block, in which the sign of the velocity is the same throughout
LEAST_STEPS = 5.0  # of the encoder in a block
NEIGHBOURS = 1.5  # block lengths between the middles of blocks that follow each other


def damping_blocks(
    windows: Windows,
    effort: np.ndarray,
    values: np.ndarray,
    covariance: np.ndarray,
    force: float,
    encoder_step: np.ndarray,
) -> DampingBlocks:
    """
    Return d by blocks from windows that do not overlap and their ``effort`` (k,) [N s].

    ``values`` (4,) and ``covariance`` (4, 4) are of m, d, F_c, offset over the whole record;
    ``force`` [N] is the standard deviation of the friction that the model lacks, and
    ``encoder_step`` (k,) [m] that of the position in each window, 0 for none.
    """
    others = [0, 2, 3]
    terms = windows.symmetric[:, others]
    travel = np.where(windows.damping == 0.0, np.nan, windows.damping)
    d = (effort - terms @ values[others]) / travel
    slope = terms / travel[:, None]
    first = np.einsum('ki,ij,kj->k', slope, covariance[np.ix_(others, others)], slope)
    noise = (values[0] * windows.noise) ** 2 + (d * windows.damping_noise) ** 2
    noise += (force * windows.offset) ** 2
    error = np.sqrt(first + noise / travel**2)
    turns = np.abs(windows.friction) < ONE_WAY * windows.offset
    way = np.abs(windows.damping / windows.offset) * windows.window
    shown = ~turns & (way > LEAST_STEPS * encoder_step)
    kept = shown & (error < LARGEST_ERROR * d)  # false where d is nan or negative
    return DampingBlocks(
        duration=windows.window,
        record=windows.record[kept],
        time=windows.time[kept],
        d=d[kept],
        standard_error=error[kept],
    )


def bound_of(blocks: DampingBlocks) -> float:
    """Return d_bar [N s/m] of at least one block."""
    z = NormalDist().inv_cdf(1.0 - MISSED / len(blocks.d))
    gap = np.diff(blocks.time)
    follow = (gap > 0.0) & (gap < NEIGHBOURS * blocks.duration) & (np.diff(blocks.record) == 0)
    change = np.abs(np.diff(blocks.d))[follow]
    return float(np.max(blocks.d + z * blocks.standard_error) + 0.5 * change.max(initial=0.0))
