"""
The regression of the weak form: values by instruments, errors by leaving out clusters.

    Z^T (u - A theta) = 0,    V = (g - 1) / g sum_i (theta_i - theta) (theta_i - theta)^T

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
A, u        regressors, ..  N s      terms and effort of each window
Z           instruments     N s      A, with the effort in place of the inertia
theta_i     -               -        the estimate without cluster i of g
V           covariance      -        of the estimates
==========  ==============  =======  ==========================================================

The effort is the instrument of the acceleration (Janot et al. 2014): noise of the position and a
damping that varies, which both disturb the acceleration, would bias m in least squares. Where d
varies, only what happens within blocks of 60 ms counts for m, F_c and o. Windows overlap, and
friction that is not as the model has it stays so for long: white standard errors are 2 to 6 times
too small. So the covariance is that of a jackknife over clusters of about 1 s.
"""

from dataclasses import dataclass
import itertools
import math
from statistics import NormalDist

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Fit:
    """
    A fit of p parameters to k windows.

    ``values`` (p,); ``covariance`` (p, p) by the jackknife over ``count`` clusters. ``own`` (p,)
    is the rms of each regressor made orthogonal to the others, ``independence`` (p,) its part of
    the whole rms. ``share`` (p,) and ``residual`` are those of least squares, over the rms effort;
    ``condition`` is that of the scaled regressors. ``varies`` says that d may vary by block.
    """

    values: np.ndarray
    covariance: np.ndarray
    own: np.ndarray
    independence: np.ndarray
    share: np.ndarray
    residual: float
    condition: float
    count: int
    varies: bool

    @property
    def errors(self) -> np.ndarray:
        """Standard errors (p,)."""
        return np.sqrt(np.diag(self.covariance))


def fit(
    regressors: np.ndarray,
    effort: np.ndarray,
    clusters: np.ndarray,
    blocks: np.ndarray | None = None,
) -> Fit:
    """
    Fit ``effort`` (k,) by ``regressors`` (k, p), of which the first two are inertia and damping.

    ``clusters`` (k,) are 0, 1, ... in ascending order.
    The instruments are the effort and the regressors but the first. With ``blocks`` (k,), 0, 1,
    ..., d may differ from block to block: the instruments but that of d are made orthogonal to the
    damping in each block, and d is the mean. Raises `numpy.linalg.LinAlgError` if the instruments
    do not determine the parameters.
    """
    given, kept = np.column_stack([effort, regressors[:, 1:]]), regressors
    if blocks is not None:
        travel = regressors[:, 1]
        given, kept = within_blocks(given, travel, blocks), within_blocks(kept, travel, blocks)
        given[:, 1] = kept[:, 1] = travel
    terms, scale = _scaled(regressors)
    instruments, count = _scaled(given)[0], int(clusters.max()) + 1
    left = _by_cluster(instruments, terms, clusters, count)
    right = _by_cluster(instruments, effort[:, None], clusters, count)[:, :, 0]
    values = np.linalg.solve(left.sum(axis=0), right.sum(axis=0))
    without = left.sum(axis=0) - left, right.sum(axis=0) - right
    moved = np.linalg.solve(without[0], without[1][:, :, None])[:, :, 0] - values
    covariance = moved.T @ moved * (count - 1) / count
    kept = kept / scale
    normal = kept.T @ kept / len(effort)
    eigenvalues = np.linalg.eigvalsh(normal)
    size = np.sqrt(np.diag(normal))
    own = np.array([_own(normal, j) for j in range(len(values))])
    explained = given[:, 0] if blocks is None else given[:, 0] + values[1] * kept[:, 1]
    least_squares = np.linalg.lstsq(kept, explained, rcond=1e-12)[0]
    left_over, rms = explained - kept @ least_squares, float(np.sqrt(np.mean(effort**2)))
    return Fit(
        values=values / scale,
        covariance=covariance / np.outer(scale, scale),
        own=own * scale,
        independence=own / np.where(size > 0.0, size, 1.0),
        share=np.abs(least_squares) * own / rms,
        residual=float(np.sqrt(np.mean(left_over**2))) / rms,
        condition=math.sqrt(eigenvalues[-1] / max(eigenvalues[0], 1e-30)),
        count=count,
        varies=blocks is not None,
    )


def within_blocks(columns: np.ndarray, travel: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return the columns made orthogonal to ``travel`` within each block."""
    square = np.bincount(blocks, travel**2)
    square[square == 0.0] = 1.0
    inner = np.column_stack([np.bincount(blocks, travel * column) for column in columns.T])
    return np.asarray(columns - travel[:, None] * (inner / square[:, None])[blocks])


def _scaled(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns of rms 1, and their rms."""
    rms = np.sqrt(np.mean(columns**2, axis=0))
    rms[rms == 0.0] = 1.0
    return columns / rms, rms


def _by_cluster(
    left: np.ndarray, right: np.ndarray, clusters: np.ndarray, count: int
) -> np.ndarray:
    """Return the products of the columns, summed by cluster: shape (count, p, q)."""
    ends = np.searchsorted(clusters, np.arange(count + 1))
    return np.array(
        [left[begin:end].T @ right[begin:end] for begin, end in itertools.pairwise(ends)]
    )


def _own(normal: np.ndarray, j: int) -> float:
    """Return the rms of regressor j made orthogonal to the others."""
    others = np.delete(np.arange(len(normal)), j)
    cross = normal[j, others]
    inner = np.linalg.pinv(normal[np.ix_(others, others)], rcond=1e-12, hermitian=True)
    return math.sqrt(max(float(normal[j, j] - cross @ inner @ cross), 0.0))


def student(probability: float, freedom: int) -> float:
    """Return the quantile of Student's distribution, by its expansion about the normal one."""
    z, nu = NormalDist().inv_cdf(probability), max(freedom, 3)
    return (
        z
        + (z**3 + z) / (4 * nu)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * nu**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * nu**3)
    )
