"""
The model of an axis over pieces of records: its fits, the choice of the window, the timing.

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
T           window          s        length of the windows of the weak form
lambda      attenuation     1        (q^2 / 12 + s_x^2) norm(c2)^2 / var(own regressor of m)
tau         delay           s        by which the effort acts late: u(t - tau) = u - tau u'
==========  ==============  =======  ==========================================================

lambda is the part of m that least squares would lose to the noise of the position; the effort as
instrument loses less. T is the shortest window with lambda below 0.1 %: over longer ones, what the
model lacks (friction near a reversal, the instant of a stop) weighs more than the noise. In a pure
PD loop u' is a combination of x' and x'', and tau is not seen.
"""

from collections.abc import Sequence
import math

import numpy as np

from impulse_control_ros.core.axis_motion import Motion, motion_of, smoothing_of
from impulse_control_ros.core.axis_record import Samples
from impulse_control_ros.core.identification import SYMMETRIC
from impulse_control_ros.core.regression import Fit, fit, within_blocks
from impulse_control_ros.core.weak_form import HOLDS, Windows, windows_of

LEAST_WINDOW = 16  # samples
LONGEST_WINDOW = 1.0  # s
ATTENUATION = 1e-3
LEAST_CLUSTERS = 6
CLEARLY = 0.7  # times
EXACT = 1e-6  # residual: nothing is left to explain
NORMAL_QUARTILE = 0.6745  # median of abs(z)
VISIBLE = 0.1  # independence of the regressor of tau
ONE_WAY = 0.98  # of the windows in one direction: the other is not seen


class AxisModel:
    """
    The symmetric model over ``pieces``, with windows computed once for each length.

    ``held`` is one of `HOLDS`. Without ``has_offset`` there is no constant force.
    """

    def __init__(self, pieces: Sequence[Samples], held: str, has_offset: bool) -> None:
        self.pieces, self.held, self.has_offset = pieces, held, has_offset
        self._windows: dict[float, Windows] = {}
        self._smoothings: list[float] = []
        self._motions: list[Motion] = []
        self._fits: dict[tuple[float, str, bool], Fit | None] = {}

    def windows(self, window: float) -> Windows:
        """Return the windows of ``window`` [s]."""
        if window not in self._windows:
            self._windows[window] = windows_of(self.motions(window), window)
        return self._windows[window]

    def motions(self, window: float) -> list[Motion]:
        """Return the motion of each piece for ``window`` [s], computed once for several."""
        smoothings = [smoothing_of(piece, window) for piece in self.pieces]
        if smoothings != self._smoothings:
            self._smoothings = smoothings
            self._motions = [motion_of(piece, window) for piece in self.pieces]
        return self._motions

    def is_one_way(self, window: float) -> bool:
        """Return whether the motion has one direction only."""
        sides = np.sign(self.windows(window).friction)
        return bool(abs(sides.sum()) >= ONE_WAY * len(sides))

    def place(self, window: float) -> list[int]:
        """
        Return the columns of the regressors that the motion can tell apart.

        In one direction F_c and the offset are one force, which is that of the offset's column.
        """
        if not self.has_offset:
            return [0, 1, 2]
        return [0, 1, 3] if self.is_one_way(window) else [0, 1, 2, 3]

    def fit(self, window: float) -> Fit | None:
        """
        Return the fit at ``window`` [s], or None if there is too little motion for one.

        It lets d vary by block where that makes the error of m clearly less.
        """
        steady = self.fit_of(window)
        if steady is None or not self.varies(window):
            return steady
        varying = self.fit_of(window, varies=True)
        assert varying is not None
        return varying if varying.errors[0] < CLEARLY * steady.errors[0] else steady

    def varies(self, window: float) -> bool:
        """Return whether a damping that varies explains clearly more of the effort."""
        steady, varying = self.fit_of(window), self.fit_of(window, varies=True)
        if steady is None or varying is None:
            return False
        return EXACT < varying.residual < CLEARLY * steady.residual

    def fit_of(self, window: float, varies: bool = False) -> Fit | None:
        """Return the fit with constant d, or with d by block."""
        key = window, self.held, varies
        if key not in self._fits:
            regressors = self.windows(window).symmetric[:, self.place(window)]
            self._fits[key] = self.solved(regressors, window, varies)
        return self._fits[key]

    def solved(self, regressors: np.ndarray, window: float, varies: bool = False) -> Fit | None:
        """Return the fit of other ``regressors`` (k, p), or None if they do not determine it."""
        windows = self.windows(window)
        # 4 clusters at least: Student's distribution of 3 degrees of freedom
        if len(windows.time) < 3 * len(SYMMETRIC) or windows.clusters.max() < 3:
            return None
        try:
            blocks = windows.blocks if varies else None
            return fit(regressors, windows.effort(self.held), windows.clusters, blocks)
        except np.linalg.LinAlgError:
            return None

    def attenuation(self, window: float) -> float:
        """Return lambda."""
        found = self.fit_of(window)
        if found is None or found.own[0] == 0.0:
            return math.inf
        return float(np.mean(self.windows(window).noise ** 2)) / float(found.own[0]) ** 2

    def values(self, window: float) -> tuple[np.ndarray, np.ndarray]:
        """Return values (4,) and covariance (4, 4) of m, d, F_c, offset, 0 where not fitted."""
        values, covariance, found = np.zeros(4), np.zeros((4, 4)), self.fit(window)
        if found is not None:
            place = self.place(window)
            values[place] = found.values
            covariance[np.ix_(place, place)] = found.covariance
        return values, covariance

    def lacking_force(self, window: float) -> float:
        """
        Return the standard deviation [N] of the friction that the model lacks.

        It is what the fit leaves over in the slowest quarter of the windows, where a damping that
        varies leaves little; if d varies, what is left within the blocks of constant d.
        """
        windows = self.windows(window)
        left_over = windows.effort(self.held) - windows.symmetric @ self.values(window)[0]
        if self.varies(window):
            left_over = within_blocks(left_over[:, None], windows.damping, windows.blocks)[:, 0]
        speed = np.abs(windows.damping / windows.offset)
        slow = speed <= np.quantile(speed, 0.25)
        return float(np.median(np.abs(left_over / windows.offset)[slow])) / NORMAL_QUARTILE

    def lengths(self) -> list[float]:
        """Return the windows [s] to choose from, each sqrt(2) times the one before."""
        least = LEAST_WINDOW * max(piece.time_step for piece in self.pieces)
        longest = max(len(piece.position) * piece.time_step for piece in self.pieces)
        most = min(longest / 8.0, LONGEST_WINDOW)
        count = int(2.0 * math.log2(max(most / least, 1.0))) + 1
        return [least * math.sqrt(2.0) ** k for k in range(count)]

    def best_window(self) -> float:
        """Return T [s]; if noise takes more than 0.1 % at any T, that at which it takes least."""
        losses: dict[float, float] = {}
        for window in self.lengths():
            found = self.fit_of(window)
            if found is not None and found.count >= LEAST_CLUSTERS:
                losses[window] = self.attenuation(window)
                if losses[window] < ATTENUATION:
                    return window
        return min(losses, key=losses.__getitem__, default=self.lengths()[0])

    def timing_window(self, window: float) -> float:
        """Return the longest window [s] that keeps 90 % of m's largest share, or ``window``."""
        most, longest = 0.0, window
        for length in self.lengths()[::2]:
            found = self.fit_of(length)
            if found is None or found.count < LEAST_CLUSTERS:
                continue
            most = max(most, float(found.share[0]))
            if found.share[0] < 0.9 * most:
                break
            longest = length
        return longest

    def delay(self, window: float) -> tuple[float, float]:
        """Return tau [s] and its standard error; nan and inf if it is not known to one sample."""
        windows = self.windows(window)
        change = (windows.efforts[:, 2] - windows.efforts[:, 0]) / (2.0 * windows.time_step)
        terms = windows.symmetric[:, self.place(window)]
        found = self.solved(np.column_stack([terms, change]), window)
        if found is None or found.independence[-1] < VISIBLE:
            return math.nan, math.inf
        late, error = float(found.values[-1]), float(found.errors[-1])
        return (late, error) if error < windows.time_step.max() else (math.nan, math.inf)

    def shown_hold(self, window: float) -> str:
        """
        Return the first of `HOLDS` whose timing is that of the motion, within two errors.

        A timing of none of them is an error of the model, and shows nothing.
        """
        late, error = self.delay(window)
        step = float(np.median([piece.time_step for piece in self.pieces]))
        if error > 0.15 * step:
            return self.held
        early = dict(zip(HOLDS, (0.0, 0.5 * step, step), strict=True))
        away = {held: abs(late - early[self.held] + early[held]) for held in HOLDS}
        nearest = min(away.values())
        if nearest > 0.25 * step + 2.0 * error:
            return self.held
        return next(held for held in HOLDS if away[held] <= nearest + 2.0 * error)
