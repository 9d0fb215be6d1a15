"""
The weak form of the equation of motion, exact for a held effort.

    m sum phi_k (x_{k+1} - 2 x_k + x_{k-1}) / dt + d sum phi_k (x_{k+1} - x_{k-1}) / 2
        + F_c dt sum phi_k s_k + o dt sum phi_k = dt sum phi_k (u_k + u_{k-1}) / 2

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
phi         weights         1        (4 s (1 - s))^3 with s = j / n over a window of n samples
c1, c2      ...             1        differences moved onto phi by summation by parts
u           effort          N        held over [t_k, t_{k+1}), see `HOLDS`
==========  ==============  =======  ==========================================================

The position is never differentiated. core/regression.py fits the parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from impulse_control_ros.core.axis_motion import Motion

# Weights of u_{k-1}, u_k, u_{k+1}: held over the sample after its time or the one before it, or a
# sample of a signal that is linear in between.
HOLDS = {
    'after': (1 / 2, 1 / 2, 0.0),
    'sampled': (1 / 6, 4 / 6, 1 / 6),
    'before': (0.0, 1 / 2, 1 / 2),
}
CLUSTER = 1.0  # s
CLUSTERS = 20  # at least, of a short record
STEADY = 0.06  # s over which d is taken as constant where it varies


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


def windows_of(motions: Sequence[Motion], window: float, spacing: float = 0.25) -> Windows:
    """
    Return the windows of ``window`` [s] that lie in motion, ``spacing`` windows apart.

    ``motions`` are those of all pieces.
    """
    found = [_windows_of(motion, number, window, spacing) for number, motion in enumerate(motions)]
    terms = np.concatenate([one for one, _ in found])
    facts = np.concatenate([one for _, one in found])
    return Windows(
        window=window,
        inertia=terms[:, 0],
        damping=terms[:, 1],
        forward=terms[:, 2],
        friction=terms[:, 3],
        efforts=terms[:, 4:7],
        offset=facts[:, 6],
        noise=facts[:, 0],
        damping_noise=facts[:, 1],
        time=facts[:, 2],
        time_step=facts[:, 3],
        record=facts[:, 4].astype(int),
        piece=facts[:, 5].astype(int),
    )


def _windows_of(
    motion: Motion, number: int, window: float, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return terms (k, 7) and facts (k, 7) of the windows of one piece."""
    piece = motion.samples
    dt = piece.time_step
    n = max(round(window / dt), 4)
    phi = weights(n)
    size = n + 3  # phi_j belongs to sample j + 1 of the window
    if len(piece.position) < size:
        return np.zeros((0, 7)), np.zeros((0, 7))
    first, middle, last = (np.pad(phi, (at, 2 - at)) for at in (0, 1, 2))
    c1, c2 = 0.5 * (last - first), (last - 2.0 * middle + first) / dt
    stride = max(int(n * spacing), 1)
    starts = np.arange(0, len(piece.position) - size + 1, stride)
    moving = motion.stood[starts + size] == motion.stood[starts]
    terms = [
        # einsum, for BLAS copies windows that overlap
        np.einsum('ki,ji->kj', sliding_window_view(signal, size)[::stride], np.array(columns))
        for signal, columns in (
            (piece.position, (c2, c1)),
            (motion.forward, (middle,)),
            (motion.friction, (middle * dt,)),
            (piece.effort, (first * dt, middle * dt, last * dt)),
        )
    ]
    deviation = math.sqrt(piece.variance)
    facts = np.empty((len(starts), 7))
    facts[:] = (
        deviation * np.linalg.norm(c2),
        deviation * np.linalg.norm(c1),
        0.0,
        dt,
        piece.index,
        number,
        dt * phi.sum(),
    )
    facts[:, 2] = piece.start + (starts + 0.5 * (size - 1)) * dt
    return np.concatenate(terms, axis=1)[moving], facts[moving]
