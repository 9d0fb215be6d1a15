"""
Motion that identifies an axis: ramps and steps of the set-point, in both directions.

The loop is a PD (4) with known gains; the axis is unknown. From rest, a step that exceeds by s the
lead that friction and gravity hold gives m v' <= K s - D v, so the speed stays below K s / D for
any mass. The steps therefore begin with a quarter of D v / K, and grow according to the measured
speeds. The ramps begin slowly for the same reason.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
import math

from impulse_control_ros.errors import ExcitationError

SPEEDS = (0.3, 0.6, 0.9)  # of the ramps, as shares of the limit
HEADROOM = 0.7  # share of the limit that a peak is to reach
MARGIN = 0.1  # share of the travel at each end that set-points stay away from
WINDOW = 0.02  # s over which the speed is a mean
STANDS = 0.02  # share of the limit of speed, below which the axis counts as standing
CALM = 0.1  # s that the axis stands before the next move
PATIENCE = 1.0  # s after which the next move begins anyway
GAP = 0.05  # s that a ramp goes on by at most from one set-point to the next, however late it is
RAMP = 1.0  # s that a ramp moves the axis at most
GROWS = 1.5  # times the step before, at most
TRIALS = 12  # steps that search for the largest one
STEPS = (1.0, 0.9, 0.6, 1.0, 0.8, 1.0, 0.7, 1.0)  # shares of it


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The travel from ``low`` to ``high`` [m], and the largest ``speed`` [m/s]."""

    low: float
    high: float
    speed: float

    def require_inside(self, what: str, position: float) -> None:
        """Raise `ExcitationError` unless a ``position`` [m] is inside of the travel."""
        if not self.low <= position <= self.high:
            raise ExcitationError(
                f'{what} {position:g} m is outside of the travel from {self.low:g} to '
                f'{self.high:g} m'
            )

    @property
    def margin(self) -> float:
        """The length [m] at each end that set-points stay away from."""
        return MARGIN * (self.high - self.low)

    @property
    def middle(self) -> float:
        """The middle of the travel [m]."""
        return 0.5 * (self.low + self.high)


class Excitation:
    """
    The set-points of the motion, in answer to the measured states of an axis.

    ``K`` [N/m] and ``D`` [N s/m] are the gains of the loop, ``x_r`` [m] its set-point, to which
    the axis returns at the end, and ``position`` [m] where it is. ``speeds`` has the peak speed
    [m/s] of each move. Raises `ExcitationError` if x_r or the position is outside of the travel.
    """

    def __init__(self, limits: Limits, K: float, D: float, x_r: float, position: float) -> None:
        limits.require_inside('set-point of the controller', x_r)
        limits.require_inside('position', position)
        self.set_point = x_r
        self.speeds: list[float] = []
        self._limits, self._K, self._D, self._home = limits, K, D, x_r
        self._recent: deque[tuple[float, float]] = deque()
        self._time = self._asked = self._elapsed = 0.0
        self._position = self._speed = self._peak = 0.0
        self._lowest, self._highest = math.inf, -math.inf
        # what the set-point leads by when the axis moves slowly down and up
        self._leads = {-1.0: 0.0, 1.0: 0.0}
        self._moves = chain(
            self._rest(),
            self._ramps(),
            self._slow_ramp(limits.middle),
            self._steps(),
            self._slow_ramp(x_r),
        )

    def watch(self, time: float, position: float) -> None:
        """Take a state of ``time`` [s]; raises `ExcitationError` if it is beyond the limits."""
        self._measure(time, position)
        self._require_within_limits()

    def next_set_point(self) -> float | None:
        """
        Return the next set-point [m], or None once the motion is over.

        The loop has taken the one before. Raises `ExcitationError` if the axis does not move.
        """
        self._elapsed = min(self._time - self._asked, GAP)
        self._asked = self._time
        point = next(self._moves, None)
        if point is not None:
            self.set_point = point
        return point

    def _measure(self, time: float, position: float) -> None:
        recent = self._recent
        recent.append((time, position))
        while len(recent) > 2 and time - recent[1][0] >= WINDOW:
            recent.popleft()
        span = time - recent[0][0]
        self._time, self._position = time, position
        self._speed = (position - recent[0][1]) / span if span >= 0.5 * WINDOW else 0.0
        self._peak = max(self._peak, abs(self._speed))
        self._lowest, self._highest = min(self._lowest, position), max(self._highest, position)

    def _require_within_limits(self) -> None:
        self._limits.require_inside('position', self._position)
        if abs(self._speed) > self._limits.speed:
            raise ExcitationError(
                f'speed {abs(self._speed):g} m/s is above the limit of {self._limits.speed:g} m/s'
            )

    # -- moves: each yields set-points, and ends when the next move may begin ---------------

    def _rest(self) -> Iterator[float]:
        """Hold the set-point until the axis has stood for CALM, at most for PATIENCE."""
        began = moved = self._time
        while self._time - moved < CALM and self._time - began < PATIENCE:
            yield self.set_point
            if abs(self._speed) > STANDS * self._limits.speed:
                moved = self._time

    def _begin(self) -> None:
        self._peak, self._lowest, self._highest = 0.0, self._position, self._position

    def _ramp(self, end: float, speed: float, longest: float) -> Iterator[float]:
        """Ramp to ``end`` until the axis has moved for ``longest`` seconds, then let it rest."""
        self._begin()
        start, way, moving = self.set_point, 0.0, math.inf
        side = math.copysign(1.0, end - start)
        while self._time - moving < longest:
            way += speed * self._elapsed
            if way >= abs(end - start):
                yield end
                break
            yield start + side * way
            if moving == math.inf and side * self._speed > 0.5 * speed:
                moving = self._time
        yield from self._rest()
        self.speeds.append(self._peak)

    def _slow_ramp(self, end: float) -> Iterator[float]:
        yield from self._ramp(end, SPEEDS[0] * HEADROOM * self._limits.speed, math.inf)

    def _ramps(self) -> Iterator[float]:
        """Move to and fro, faster and faster."""
        limits, ratio, overshoot = self._limits, 1.0, 0.0
        first = 1.0 if self._position <= limits.middle else -1.0
        for share in SPEEDS:
            for side in (first, -first):
                speed = share * limits.speed / max(ratio / HEADROOM, 1.0)
                margin = max(limits.margin, 1.5 * overshoot * speed)
                end = limits.high - margin if side > 0.0 else limits.low + margin
                start = self.set_point
                for point in self._ramp(end, speed, RAMP):
                    if share == SPEEDS[0]:
                        lead = side * (self.set_point - self._position)
                        self._leads[side] = max(self._leads[side], lead)
                    yield point
                # late set-points make a ramp slow, but the axis follows them
                follows = self._highest - self._lowest >= 0.5 * abs(self.set_point - start)
                if self._peak < 0.5 * speed and not follows:
                    self._refuse_to_go_on(side)
                ratio = max(ratio, self._peak / speed)
                beyond = (
                    self._highest - self.set_point
                    if side > 0.0
                    else (self.set_point - self._lowest)
                )
                overshoot = max(overshoot, beyond / speed)

    def _refuse_to_go_on(self, side: float) -> None:
        lead = self._leads[side]
        raise ExcitationError(
            f'the axis does not follow: a set-point that leads by {lead:g} m, and so '
            f'{self._K * lead:g} N, does not move it; a larger K of the controller or a longer '
            'travel is needed'
        )

    def _steps(self) -> Iterator[float]:
        """Step to and fro: find the largest step, then make some of different sizes."""
        limits = self._limits
        hold = 0.5 * (self._leads[1.0] + self._leads[-1.0])  # against friction
        balance = 0.5 * (self._leads[1.0] - self._leads[-1.0])  # against gravity
        goal = HEADROOM * limits.speed
        excess = max(0.25 * self._D * limits.speed / self._K, 0.01 * limits.margin)
        for _ in range(TRIALS):
            yield from self._step(balance, hold, excess)
            if self._peak > 0.8 * goal:
                break
            excess *= min(max(goal / self._peak, 1.0), GROWS) if self._peak else GROWS
        for share in STEPS:
            yield from self._step(balance, hold, share * excess)

    def _step(self, balance: float, hold: float, excess: float) -> Iterator[float]:
        """Step by ``excess`` [m] more than what holds the axis, and let it rest."""
        limits, position = self._limits, self._position
        side = 1.0 if position <= limits.middle else -1.0
        room = (
            limits.high - limits.margin - position
            if side > 0.0
            else (position - limits.low - limits.margin)
        )
        self._begin()
        # without friction, the axis goes twice as far as the step
        yield position + balance + side * min(hold + excess, 0.5 * room + 0.5 * hold)
        yield from self._rest()
        self.speeds.append(self._peak)
