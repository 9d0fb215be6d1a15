"""
What a display keeps of a run in progress, of bounded size however long the run is.

======  ===========  ====  ====================================================================
symbol  name         unit  equation
======  ===========  ====  ====================================================================
e       error        m     x - x_r
u_PD    feedback     N     -K e - D v (4), within effort_limit
J       area         N s   area of an impulse (2)
v+      after        m/s   v + J / m, the velocity after an impulse
======  ===========  ====  ====================================================================
"""

from collections import deque
from collections.abc import Mapping
from itertools import islice
import math
from typing import Any

from impulse_control_ros.core.tick import SECOND

SAMPLES, IMPULSES = 3000, 2000  # kept
EARLY = 4000  # impulses kept until a state of their run is there
SIMULATED = 10**7 * SECOND  # stamps from here on are of a wall clock
SPAN = 1.0  # s over which rates are taken
LAW = {'m', 'K', 'D', 'x_r', 'effort_limit'}
SAMPLE = ('time', 'position', 'setpoint', 'error', 'velocity', 'effort', 'feedback')
IMPULSE = ('time', 'position', 'error', 'velocity', 'after', 'area', 'guard')


class Rows:
    """The last ``most`` rows of named columns; ``count`` includes those dropped since."""

    def __init__(self, names: tuple[str, ...], most: int) -> None:
        self._names = names
        self._rows: deque[tuple[Any, ...]] = deque(maxlen=most)
        self.count = 0

    def append(self, *row: Any) -> None:
        """Add a row."""
        self._rows.append(row)
        self.count += 1

    def clear(self) -> None:
        """Forget all rows."""
        self._rows.clear()
        self.count = 0

    def columns(self, since: int) -> dict[str, list[Any]]:
        """Return the kept rows after the first ``since`` ones, by column."""
        first = max(0, len(self._rows) - (self.count - since))
        rows = list(islice(self._rows, first, None))
        return {name: [row[at] for row in rows] for at, name in enumerate(self._names)}


class Rate:
    """The slope of a quantity over time, from its last values over `SPAN`."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, float]] = deque(maxlen=100)

    def add(self, time: float, value: float) -> None:
        """Add a value at ``time`` [s]; times closer than a tenth of the span are skipped."""
        points = self._points
        if points and time < points[-1][0]:
            points.clear()
        if not points or time >= points[-1][0] + SPAN / 10:
            points.append((time, value))
        while len(points) > 2 and points[1][0] <= time - SPAN:
            points.popleft()

    def value(self, now: float = -math.inf) -> float:
        """Return the slope: 0 before there are two values, or if none has come lately."""
        if len(self._points) < 2 or now > self._points[-1][0] + 2 * SPAN:
            return 0.0
        (first, before), (last, now) = self._points[0], self._points[-1]
        return (now - before) / (last - first)


class LiveRun:
    """
    The newest part of a run.

    ``law`` has the controller's parameters by name, or lacks some of `LAW` for a foreign one.
    ``episode`` counts the runs begun: rows of one before are gone. By guard, ``fired`` has the
    number of impulses, and ``last`` the time [s] and the area [N s] of the last one.
    """

    def __init__(self) -> None:
        self.law: Mapping[str, Any] = {}
        self.samples, self.impulses = Rows(SAMPLE, SAMPLES), Rows(IMPULSE, IMPULSES)
        self.episode = 0
        self.fired: dict[str, int] = {}
        self.last: dict[str, tuple[float, float]] = {}
        self.speed, self.impulse_rate = Rate(), Rate()
        self._run: str | None = None
        self._stamp = self._impulse_stamp = self._origin = 0
        self._early: deque[tuple[Any, ...]] = deque(maxlen=EARLY)

    def add_state(
        self, wall: float, run: str, stamp: int, position: float, velocity: float, effort: float
    ) -> None:
        """Add a state at ``stamp`` [ns], received at ``wall`` [s]; a repeated one is skipped."""
        if run != self._run or stamp < self._stamp:
            self._begin(run, stamp)
        elif stamp == self._stamp:
            return
        self._stamp = stamp
        time = (stamp - self._origin) / SECOND
        self.speed.add(wall, time)
        self.impulse_rate.add(time, sum(self.fired.values()))
        setpoint = self.law.get('x_r', math.nan)
        error = self._error(position)
        self.samples.append(
            time, position, setpoint, error, velocity, effort, self.feedback(error, velocity)
        )

    def _begin(self, run: str, stamp: int) -> None:
        self._run, self.episode = run, self.episode + 1
        self._origin = stamp if stamp > SIMULATED else 0
        self.samples.clear()
        self.impulses.clear()
        self.fired, self.last, self._impulse_stamp = {}, {}, 0
        self.speed, self.impulse_rate = Rate(), Rate()
        early, self._early = self._early, deque(maxlen=EARLY)
        for impulse in early:
            self.add_impulse(*impulse)

    @property
    def knows_law(self) -> bool:
        """Whether u_PD can be computed."""
        return self.law.keys() >= LAW

    def _error(self, position: float) -> float:
        """Return the error [m] of a position; of a foreign law, from 0."""
        return position - float(self.law.get('x_r', 0.0))

    def feedback(self, error: float, velocity: float) -> float:
        """Return u_PD [N] of an error and a velocity; nan for an unknown law."""
        if not self.knows_law:
            return math.nan
        limit = self.law['effort_limit'] or math.inf
        return min(max(-self.law['K'] * error - self.law['D'] * velocity, -limit), limit)

    def add_impulse(
        self, run: str, stamp: int, position: float, velocity: float, area: float, guard: str
    ) -> None:
        """
        Add an impulse at ``stamp`` [ns]; a repeated one is skipped.

        One of another run waits for a state of that run.
        """
        if run != self._run:
            self._early.append((run, stamp, position, velocity, area, guard))
            return
        if stamp == self._impulse_stamp:
            return
        self._impulse_stamp = stamp
        self.fired[guard] = self.fired.get(guard, 0) + 1
        error = self._error(position)
        after = velocity + area / self.law.get('m', math.nan)
        time = (stamp - self._origin) / SECOND
        self.last[guard] = time, area
        self.impulses.append(time, position, error, velocity, after, area, guard)
