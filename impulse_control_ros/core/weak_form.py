"""
The weak form of the equation of motion, exact for a held effort, and its regression.

    m sum phi_k (x_{k+1} - 2 x_k + x_{k-1}) / dt + d sum phi_k (x_{k+1} - x_{k-1}) / 2
        + F_c dt sum phi_k s_k + o dt sum phi_k = dt sum phi_k (u_k + u_{k-1}) / 2

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
phi         weights         1        (4 s (1 - s))^3 with s = j / n over a window of n samples
c1, c2      ...             1        differences moved onto phi by summation by parts
u           effort          N        held over [t_k, t_{k+1}), see `HOLDS`
V           ...             -        covariance of the estimates, by leaving out clusters
==========  ==============  =======  ==========================================================

The position is never differentiated. The effort is the instrument of the acceleration (Janot et
al. 2014): noise of the position and a damping that varies, which both disturb the acceleration,
would bias m in least squares. Where d varies, only what happens within blocks of 60 ms counts for
m, F_c and o. Windows overlap, and friction that is not as the model has it stays
so for long: white standard errors are 2 to 6 times too small. So the covariance is that of a
jackknife over clusters of about 1 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from statistics import NormalDist

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from impulse_control_ros.core.axis_record import direction_of, Samples

# Weights of u_{k-1}, u_k, u_{k+1}: held over the sample after its time or the one before it, or a
# sample of a signal that is linear in between.
HOLDS = {
    'after': (1 / 2, 1 / 2, 0.0),
    'sampled': (1 / 6, 4 / 6, 1 / 6),
    'before': (0.0, 1 / 2, 1 / 2),
}
LONGEST_SMOOTHING = 0.05  # s, for the sign of the velocity
CLUSTER = 1.0  # s
CLUSTERS = 20  # at least, of a short record
STEADY = 0.06  # s over which d is taken as constant where it varies
BLOCK = 1 << 22  # values of the windows in memory at once


@dataclass(frozen=True, kw_only=True)
class Windows:
    """
    The terms of the weak form for windows in motion, each array of shape (k,) unless stated.

    ``inertia``, ``damping``, ``friction`` and ``offset`` multiply m, d, F_c and o; ``forward`` is
    the part of ``damping`` in motion to positive x. ``efforts`` (k, 3) are dt sum phi u for
    u_{k-1}, u_k and u_{k+1}. ``time`` [s] is the middle; ``record`` the index of its record and
    ``piece`` that of its piece. ``noise`` and ``damping_noise`` are the standard deviations that
    the noise of the position gives inertia and damping.
    """

    window: float
    inertia: np.ndarray
    damping: np.ndarray
    forward: np.ndarray
    friction: np.ndarray
    offset: np.ndarray
    efforts: np.ndarray
    noise: np.ndarray
    damping_noise: np.ndarray
    time: np.ndarray
    time_step: np.ndarray
    record: np.ndarray
    piece: np.ndarray

    def effort(self, held: str) -> np.ndarray:
        """Return the right side [N s] for one of `HOLDS`."""
        return self.efforts @ np.array(HOLDS[held])

    @cached_property
    def symmetric(self) -> np.ndarray:
        """Regressors of m, d, F_c, offset: shape (k, 4)."""
        return np.column_stack([self.inertia, self.damping, self.friction, self.offset])

    @cached_property
    def asymmetric(self) -> np.ndarray:
        """Regressors of m, d_plus, d_minus, F_c_plus, F_c_minus: shape (k, 5)."""
        return np.column_stack(
            [
                self.inertia,
                self.forward,
                self.damping - self.forward,
                0.5 * (self.offset + self.friction),
                0.5 * (self.friction - self.offset),
            ]
        )

    @cached_property
    def clusters(self) -> np.ndarray:
        """The cluster of each window, for the errors: 0, 1, ..., shape (k,)."""
        moving = len(self.time) * self.window / 4.0
        return self._parts(max(min(CLUSTER, moving / CLUSTERS), 2.0 * self.window))

    @cached_property
    def blocks(self) -> np.ndarray:
        """The block of each window, within which d is constant: 0, 1, ..., shape (k,)."""
        return self._parts(max(STEADY, 3.0 * self.window))

    def _parts(self, length: float) -> np.ndarray:
        place = np.floor((self.time - self.time.min()) / length).astype(np.int64)
        return np.unique(self.piece * (place.max() + 1) + place, return_inverse=True)[1]


def weights(n: int) -> np.ndarray:
    """Return phi over n + 1 samples; it and its first two derivatives vanish at the ends."""
    s = np.arange(n + 1) / n
    return (4.0 * s * (1.0 - s)) ** 3


def windows_of(
    pieces: Sequence[Samples], window: float, spacing: float = 0.25, longest: float | None = None
) -> Windows:
    """
    Return the windows of ``window`` [s] that lie in motion, ``spacing`` windows apart.

    ``longest`` [s] bounds the smoothing of the velocity, by default `LONGEST_SMOOTHING`.
    """
    found = [
        part
        for number, piece in enumerate(pieces)
        for part in _piece_windows(piece, number, window, spacing, longest or LONGEST_SMOOTHING)
    ]
    if not found:
        found = [(np.zeros((0, 8)), np.zeros((0, 6)))]
    terms = np.concatenate([one for one, _ in found])
    facts = np.concatenate([one for _, one in found])
    return Windows(
        window=window,
        inertia=terms[:, 0],
        damping=terms[:, 1],
        forward=terms[:, 2],
        friction=terms[:, 3],
        offset=terms[:, 4],
        efforts=terms[:, 5:8],
        noise=facts[:, 0],
        damping_noise=facts[:, 1],
        time=facts[:, 2],
        time_step=facts[:, 3],
        record=facts[:, 4].astype(int),
        piece=facts[:, 5].astype(int),
    )


def _piece_windows(
    piece: Samples, number: int, window: float, spacing: float, longest: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return terms (k, 8) and facts (k, 6) of the windows of one piece, in blocks."""
    dt = piece.time_step
    n = max(round(window / dt), 4)
    phi = weights(n)
    size = n + 3  # phi_j belongs to sample j + 1 of the window
    if len(piece.position) < size:
        return []
    first, middle, last = (np.pad(phi, (at, 2 - at)) for at in (0, 1, 2))
    c1, c2 = 0.5 * (last - first), (last - 2.0 * middle + first) / dt
    direction, standing = direction_of(piece, min(window, longest))
    ends = np.concatenate([[0], standing.cumsum()])
    stride = max(int(n * spacing), 1)
    starts = np.arange(0, len(piece.position) - size + 1, stride)
    starts = starts[ends[starts + size] == ends[starts]]
    change = 0.5 * (piece.position[2:] - piece.position[:-2])
    side = 0.5 * (direction[1:] + direction[:-1])  # of the two samples that meet at t_k
    forward = np.zeros_like(piece.position)
    forward[1:-1] = 0.5 * (1.0 + side[:-1]) * change
    friction = np.zeros_like(piece.position)
    friction[1:] = side
    signals = ((piece.position, (c2, c1)), (forward, (middle,)), (friction, (middle * dt,)))
    effort = (piece.effort, (first * dt, middle * dt, last * dt))
    found = []
    rows = max(BLOCK // size, 1)
    for at in range(0, len(starts), rows):
        some = starts[at : at + rows]
        parts = [
            sliding_window_view(signal, size)[some] @ np.column_stack(columns)
            for signal, columns in (*signals, effort)
        ]
        total = np.full((len(some), 1), dt * phi.sum())
        deviation = math.sqrt(piece.variance)
        facts = np.empty((len(some), 6))
        facts[:] = (
            deviation * np.linalg.norm(c2),
            deviation * np.linalg.norm(c1),
            0.0,
            dt,
            piece.index,
            number,
        )
        facts[:, 2] = piece.start + (some + 0.5 * (size - 1)) * dt
        found.append((np.concatenate([*parts[:3], total, parts[3]], axis=1), facts))
    return found


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
    sums = np.empty((count, left.shape[1], right.shape[1]))
    for i in range(left.shape[1]):
        for j in range(right.shape[1]):
            sums[:, i, j] = np.bincount(clusters, left[:, i] * right[:, j], count)
    return sums


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
