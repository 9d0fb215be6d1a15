"""The reports of a plant: on /diagnostics and in the log."""

from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from impulse_control_ros.core.age import AgeLimit
from impulse_control_ros.errors import UnreadableError
from impulse_control_ros.files.topics import JOINT_COMMANDS
from impulse_control_ros.nodes.diagnostics import Diagnostics

FIRST_REPORT, REPORT = 2.0, 20.0  # s
SETTLE = 2.0  # s before a slow run is reported


class PlantReport:
    """The reports of ``plant``, a `PlantSimulator`."""

    def __init__(self, plant: Any) -> None:
        self._plant = plant
        self._began = self._moving_since = monotonic()
        self._waiting, self._said_at = '', 0.0
        self._accepted_before = self._rejected = 0
        self._known: set[str] = set()
        Diagnostics(plant, self._progress, self._report)

    def begin(self, now: float) -> None:
        """Record and log the first state."""
        self._began = self._moving_since = now
        self._plant.get_logger().info(
            f'running from {self._plant.clock.seconds()} s (run {self._plant.run})'
        )

    def waiting_for(self, what: str, now: float) -> None:
        """Log ``what`` the plant is waiting for, every REPORT seconds."""
        if what != self._waiting:
            self._waiting, self._said_at = what, now - REPORT + FIRST_REPORT
        elif now >= self._said_at + REPORT:
            self._said_at = now
            self._plant.get_logger().info(f'waiting for {what}')

    def reject(self, error: UnreadableError) -> None:
        """Count and log an invalid command."""
        logger = self._plant.get_logger()
        if error.is_normal:
            self._plant.arbiter.counts['ignored'] += 1
            logger.info(f'ignoring commands: {error}', once=True)
        else:
            self._rejected += 1
            logger.error(f'command rejected: {error}', throttle_duration_sec=5.0)

    def too_old(self, age: AgeLimit) -> None:
        """Log a command that is too old."""
        self._plant.get_logger().warning(
            f'command ignored: {age.age:.3g} s old, max_age = {age.limit:g} s',
            throttle_duration_sec=5.0,
        )

    def summarize(self, what: str) -> None:
        """Log a summary of the run."""
        plant, wall = self._plant, monotonic() - self._began
        simulated = plant.clock.elapsed
        counts = ', '.join(
            f'{value} {name}'
            for name, value in (
                {'steps': plant.clock.tick}
                | self._counts
                | {'missed deadlines': plant.pacer.missed}
            ).items()
        )
        plant.get_logger().info(
            f'{what} at {plant.clock.seconds()} s: {simulated:g} s in {wall:.3f} s of wall '
            f'time ({simulated / max(wall, 1e-9):.2f} times real time); {counts}'
        )

    @property
    def _counts(self) -> dict[str, int]:
        """The commands by outcome, and the number of unanswered states."""
        arbiter, tick = self._plant.arbiter, self._plant.clock.tick
        # a foreign controller need not answer every state
        lost = 0 if arbiter.is_foreign else max(0, tick - arbiter.counts['accepted'])
        return arbiter.counts | {'rejected': self._rejected, 'lost': lost}

    def _progress(self) -> tuple[int, float]:
        return self._plant.clock.tick, self._plant.clock.elapsed

    def _report(self, rate: float) -> tuple[bytes, str, dict[str, object]]:
        plant, arbiter = self._plant, self._plant.arbiter
        troubles = self._troubles(rate)
        for name in troubles.keys() - self._known:
            plant.get_logger().warning(troubles[name])
        self._known = set(troubles)
        held = [
            name
            for name, holds in (
                ('a command', arbiter.awaiting),
                ('resume', plant.control.paused),
                ('a recorder', not plant.recorders.may_step),
            )
            if holds
        ]
        message = 'running' if rate else 'waiting for ' + (' and '.join(held) or 'peers')
        level = DiagnosticStatus.OK if rate and not troubles else DiagnosticStatus.WARN
        return (
            level,
            '; '.join((message, *troubles.values())),
            {
                'run': plant.run,
                'controller': arbiter.header.controller,
                'recorders': len(plant.recorders),
                'missed_deadlines': plant.pacer.missed,
                **plant.pacer.report(),
                **self._counts,
            },
        )

    def _troubles(self, rate: float) -> dict[str, str]:
        """Return the problems of a run at ``rate`` samples per wall second, by name."""
        plant, now = self._plant, monotonic()
        if plant.control.paused or not rate:
            self._moving_since = now
        factor = rate * plant.parameters.time_step
        accepted, self._accepted_before = self._accepted_before, plant.arbiter.counts['accepted']
        wanted = plant.parameters.real_time_factor
        free = not plant.parameters.lockstep
        return {
            name: text
            for name, is_so, text in (
                (
                    'unheard',
                    free and rate > 0 and self._accepted_before == accepted,
                    f'no command for 1 s at {plant.clock.seconds()} s: '
                    f'holding {plant.arbiter.effort:g} N',
                ),
                (
                    'clock',
                    bool(plant.arbiter.age.clock_error),
                    f'{JOINT_COMMANDS} {plant.arbiter.age.clock_error}',
                ),
                (
                    'slow',
                    0.0 < factor < 0.9 * wanted and now > self._moving_since + SETTLE,
                    f'too slow: {factor:.2f} times real time, real_time_factor = {wanted:g}',
                ),
            )
            if is_so
        }
