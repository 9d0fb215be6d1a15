"""The plants whose parameters a controller has received, and the findings about them."""

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.serialization import deserialize_message

from impulse_control_ros.core.design import check_delay, check_gains, Finding, Level
from impulse_control_ros.core.protocol import name_of, parse_node
from impulse_control_ros.files.experiment import axis_of, ControllerParameters, require_agreement
from impulse_control_ros.files.parameter_event import decode_parameter_event

MOST = 10
NAME = ''  # key of the plant's full name, among its parameters


def decoded(raw: bytes) -> tuple[Any, ...]:
    """Return (sec, nanosec, node, parameters, changed) of an event on run_parameters."""
    return decode_parameter_event(raw, lambda event: deserialize_message(event, ParameterEvent))


class KnownPlants:
    """The parameters of our plants by run; empty for a foreign plant."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._values: dict[str, dict[str, Any]] = {}
        self._said: list[Finding] = []
        self._said_of_delay: list[Finding] = []
        self._adopted = ''

    def on_event(self, raw: bytes) -> None:
        """Handle an event on run_parameters, given as CDR."""
        *_, node, values, _ = decoded(raw)
        run, name = parse_node(node)
        if run and name == name_of(name):  # a controller has an id
            self._values.pop(run, None)
            self._values[run] = {**values, NAME: name}
            if len(self._values) > MOST:
                del self._values[next(one for one in self._values if one != self._adopted)]

    def __contains__(self, run: str) -> bool:
        return run in self._values

    def is_free_running(self, run: str | None) -> bool:
        """Return whether the plant of a run does not wait for commands."""
        return not self._values.get(run or '', {}).get('lockstep', False)

    def adopt(self, run: str, gains: ControllerParameters) -> None:
        """Log which plant was found; raise `ParameterError` if the parameters disagree."""
        values = self._values.get(run, {})
        name = values.get(NAME, 'a foreign plant: assuming our joint_name and time_step')
        require_agreement(name, values, gains.flat())
        self._adopted = run
        self._logger.info(f'found {name}')
        self.advise(run, gains)

    def advise(self, run: str | None, gains: ControllerParameters) -> None:
        """Log the findings on ``gains`` for the plant of a run, each once."""
        values: Mapping[str, Any] = self._values.get(run or '', {})
        before, self._said = self._said, check_gains(gains, axis_of(values))
        if values and gains.max_age:
            text = f'max_age has no effect on the states of {values[NAME]}: set it there'
            self._said.append(Finding(level=Level.NOTE, text=text))
        self._log(self._said, before)

    def advise_for_delay(self, gains: ControllerParameters, delay: int) -> None:
        """Log the findings on ``gains`` for a learnt delay [samples], each once."""
        before, self._said_of_delay = self._said_of_delay, check_delay(gains, delay)
        self._log(self._said_of_delay, before)

    def _log(self, findings: list[Finding], before: list[Finding]) -> None:
        for finding in findings:
            if finding in before:
                continue
            # rclpy allows one severity per call site
            if finding.level is Level.NOTE:
                self._logger.info(finding.text)
            elif finding.level is Level.WARNING:
                self._logger.warning(finding.text)
            else:
                self._logger.error(finding.text)
