"""Pacing of samples by the wall clock, and its timing errors."""

import numpy as np

SLIP = 0.1


class WallClockPacer:
    """
    Schedules samples ``wall_step`` seconds of wall time apart, 0 for as fast as possible.

    A late plant catches up, unless it is more than SLIP seconds late; the schedule then restarts.
    ``missed`` counts the samples that are more than one ``wall_step`` late.
    """

    def __init__(self) -> None:
        self.wall_step = 0.0
        self.missed = 0
        self._since, self._tick = 0.0, 0
        self._errors: list[float] = []

    def restart(self, tick: int, now: float) -> None:
        """Restart the schedule at ``tick`` and ``now`` [s]."""
        self._since, self._tick = now, tick

    def due(self, tick: int) -> float:
        """Return the wall time [s] at which the sample after ``tick`` is due; 0 for at once."""
        return self._since + (tick + 1 - self._tick) * self.wall_step if self.wall_step else 0.0

    def made(self, tick: int, now: float) -> None:
        """Record that the sample after ``tick`` was made at ``now`` [s]."""
        late = now - self.due(tick)
        self._errors.append(late)
        self.missed += late > self.wall_step
        if late > SLIP:
            self.restart(tick, now)

    def report(self) -> dict[str, str]:
        """Return the pacing error since the last report, in microseconds."""
        if not self._errors:
            return {}
        errors, self._errors = np.array(self._errors) * 1e6, []
        return {
            f'pacing_error_{name}_us': f'{value:.1f}'
            for name, value in (
                ('p50', np.percentile(errors, 50)),
                ('p99', np.percentile(errors, 99)),
                ('max', errors.max()),
            )
        }
