"""The reports of a controller: on /diagnostics and in the log."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from impulse_control_ros.core.age import AgeLimit
from impulse_control_ros.core.protocol import name_of, StateHeader
from impulse_control_ros.errors import UnreadableError
from impulse_control_ros.files.topics import EFFORT_COMMANDS, JOINT_COMMANDS, JOINT_STATES
from impulse_control_ros.nodes.diagnostics import Diagnostics


class ControllerReport:
    """
    The reports of ``controller``, a `Controller`.

    ``counts`` has the states without a new answer, by reason, and the withheld efforts.
    """

    def __init__(self, controller: Any) -> None:
        self.counts = dict.fromkeys(
            ('repeated', 'standby', 'other_run', 'ignored', 'old', 'rejected', 'withheld'), 0
        )
        self._ignored: set[str] = set()  # the runs of other plants
        self._controller, self._logger = controller, controller.get_logger()
        Diagnostics(controller, self._progress, self._report)

    def reject(self, error: UnreadableError) -> None:
        """Count and log a state that cannot be read."""
        if error.is_normal:
            self.counts['ignored'] += 1
            self._logger.info(f'ignoring states: {error}', once=True)
        else:
            self.counts['rejected'] += 1
            self._logger.error(f'state rejected: {error}', throttle_duration_sec=5.0)

    def too_old(self, age: AgeLimit) -> None:
        """Count and log a state that is too old."""
        self.counts['old'] += 1
        self._logger.warning(
            f'state ignored: {age.age:.3g} s old, max_age = {age.limit:g} s',
            throttle_duration_sec=5.0,
        )

    def ignore(self, header: StateHeader) -> None:
        """Log that another plant is ignored."""
        if header.run not in self._ignored:
            self._ignored.add(header.run)
            self._logger.warning(
                f'ignoring the states of a second plant (run {header.run or "unknown"})'
            )

    def withhold(self, effort: float, largest: float, position: float, velocity: float) -> None:
        """Log that an ``effort`` [N] above the ``largest`` allowed one is not sent."""
        self.counts['withheld'] += 1
        self._logger.error(
            f'effort {effort:g} N at position {position:g} m, velocity {velocity:g} m/s exceeds '
            f'{largest:g} N: sending 0 N',
            throttle_duration_sec=5.0,
        )

    def _progress(self) -> tuple[int, float]:
        answers, parameters = self._controller.answers, self._controller.parameters
        return answers.sent, answers.sent * parameters.time_step

    def _report(self, rate: float) -> tuple[bytes, str, dict[str, object]]:
        controller, counts = self._controller, self.counts
        answers, states, other = controller.answers, controller.states, controller.active_other
        wrong = controller.rate.wrong(states.stamp, answers.sent)
        if wrong:
            self._logger.error(wrong, throttle_duration_sec=20.0)
        if controller.age.clock_error:
            self._logger.warning(f'{JOINT_STATES} {controller.age.clock_error}', once=True)
        topic = EFFORT_COMMANDS if answers.efforts else JOINT_COMMANDS
        if states.run == '' and controller.count_publishers(topic) > 1:
            self._logger.warning(
                f'several controllers publish {topic}, and a foreign plant applies all '
                'of them: stop all but one',
                throttle_duration_sec=20.0,
            )
        suspended = controller.supervision.suspended
        is_bad = counts['withheld'] or controller.timeout.deserted or wrong
        level = (
            DiagnosticStatus.ERROR
            if is_bad
            else DiagnosticStatus.WARN
            if counts['rejected'] or suspended
            else DiagnosticStatus.OK
        )
        message = wrong or (
            'not active'
            if not controller.active
            else 'answering'
            if rate
            else f'standing by for {name_of(other)}'
            if other
            else 'waiting for states'
        )
        return (
            level,
            f'{message}, {suspended}' if suspended else message,
            {
                'answered': answers.sent,
                'impulses': answers.impulses,
                **counts,
                **controller.supervision.values(),
                'lost': controller.rate.lost(states.stamp, answers.sent),
                'command_subscriptions': answers.commands.publisher.get_subscription_count(),
                'event_subscriptions': answers.events.publisher.get_subscription_count(),
                'x_r': controller.parameters.x_r,
            },
        )
