"""
The controller node: joint_states in, joint_commands and impulse_events out.

One command answers each state and carries its stamp; time is the state's, never a clock's. A
state that comes again is answered again with the same bytes, and leaves the memory as it is. A
state that goes back in time, or carries the reset mark, is a plant that started anew: the
guard memory is cleared.
"""

import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from impulse_control_ros.core.design import findings, Level
from impulse_control_ros.core.impulse import ANSWER, control, fresh_memory, GUARDS
from impulse_control_ros.core.kernel import machine_code
from impulse_control_ros.files.experiment import ControllerParameters
from impulse_control_ros.nodes.diagnostics import Diagnostics
from impulse_control_ros.nodes.entry import StopRequest
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.spin import IDLE, main as run_node
from impulse_control_ros.nodes.topics import (
    command_layout,
    event_layout,
    EVENT_QOS,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATES,
    RESET_MARK,
    SERIES_QOS,
    SETPOINT,
    SLOW_QOS,
    state_layout,
)


class Controller(ParameterNode):
    """Answers every joint state with the effort of the control law."""

    finished = False

    def __init__(self, **options: Any) -> None:
        super().__init__('controller', ControllerParameters, **options)
        joint, logger = self.parameters.joint_name, self.get_logger()
        self._state_layout = state_layout(joint, logger)
        self._command_layout = command_layout(joint, logger)
        self._event_layouts = [event_layout(joint, logger, guard) for guard in GUARDS]
        self._memory, self._answer = fresh_memory(), np.zeros(1, ANSWER)
        self._packed = self.parameters.packed()
        self._control = machine_code(
            control, fresh_memory(), self._packed, 0.0, 0.0, np.zeros(1, ANSWER))
        self._seen = b''
        self._sent: tuple[bytes, bytes] = (b'', b'')
        self._stamp = (0, 0)
        self._counts = {'answered': 0, 'impulses': 0, 'repeated': 0, 'rejected': 0}
        self._events = self.create_publisher(JointState, IMPULSE_EVENTS, EVENT_QOS)
        self._commands = self.create_publisher(JointState, JOINT_COMMANDS, SERIES_QOS)
        # publish() without its checks: these are bytes, and the publisher lives as long as we do
        self._publish_command = self._commands.handle.publish_raw
        self.create_subscription(Float64, SETPOINT, self._on_setpoint, SLOW_QOS)
        self.states = self.create_subscription(
            JointState, JOINT_STATES, self.on_state, SERIES_QOS, raw=True)
        Diagnostics(self, self._report)
        self._warn()

    def _start_afresh(self) -> None:
        self._memory = fresh_memory()

    def _warn(self) -> None:
        for finding in findings(self.parameters):
            if finding.level is Level.NOTE:
                self.get_logger().info(finding.text)
            else:
                self.get_logger().warning(finding.text)

    def parameters_changed(self) -> None:
        """Let the next sample be answered with the new gains."""
        self._packed = self.parameters.packed()
        self._warn()

    def _on_setpoint(self, message: Float64) -> None:
        result = self.set_parameters_atomically(
            [Parameter('x_r', Parameter.Type.DOUBLE, message.data)])
        if not result.successful:
            self.get_logger().error(f'setpoint: {result.reason}')

    def on_state(self, raw: bytes) -> None:
        """Answer one joint state, given as CDR."""
        if raw == self._seen:
            self._repeat()
            return
        values = self._state_layout.decode(raw) or self._decode_slowly(raw)
        if values is None:
            return
        sec, nanosec, position, velocity, _ = values
        if not (math.isfinite(position) and math.isfinite(velocity)):
            self._reject(f'a state with position {position}, velocity {velocity}')
            return
        if (sec, nanosec) <= self._stamp:
            self._start_afresh()
            self.get_logger().info('joint_states went back in time: started afresh')
        self._stamp, self._seen = (sec, nanosec), raw
        self._control(self._memory, self._packed, position, velocity, self._answer)
        effort, area, guard = self._answer.item()
        event = b''
        if guard:
            event = self._event_layouts[guard].encode(sec, nanosec, position, velocity, area)
            self._events.publish(event)
            self._counts['impulses'] += 1
        command = self._command_layout.encode(sec, nanosec, effort)
        self._publish_command(command)
        self._sent = (event, command)
        self._counts['answered'] += 1

    def _repeat(self) -> None:
        event, command = self._sent
        if event:
            self._events.publish(event)
        self._commands.publish(command)
        self._counts['repeated'] += 1

    def _decode_slowly(self, raw: bytes) -> tuple[Any, ...] | None:
        """Decode any JointState: of several joints, another byte order, or with the reset mark."""
        joint = self.parameters.joint_name
        try:
            message: Any = deserialize_message(raw, JointState)
            at = list(message.name).index(joint)
            position, velocity = message.position[at], message.velocity[at]
        except ValueError:
            self._reject(f'a state without joint {joint!r}')
            return None
        except IndexError:
            self._reject(f'a state without position or velocity of joint {joint!r}')
            return None
        except Exception as error:  # rclpy raises its own type for bytes that are no message
            self._reject(f'a state that cannot be decoded ({error})')
            return None
        if message.header.frame_id == RESET_MARK:
            self._start_afresh()
        stamp = message.header.stamp
        return stamp.sec, stamp.nanosec, position, velocity, 0.0

    def _reject(self, what: str) -> None:
        self._counts['rejected'] += 1
        self.get_logger().error(f'rejected {what}', throttle_duration_sec=1.0)

    def _report(self) -> tuple[bytes, str, dict[str, object]]:
        level = DiagnosticStatus.WARN if self._counts['rejected'] else DiagnosticStatus.OK
        return level, 'answering' if self._counts['answered'] else 'waiting for states', {
            **self._counts, 'x_r': self.parameters.x_r}

    def poll(self) -> float:
        """Nothing is due by the wall clock."""
        return IDLE

    def close(self) -> None:
        """Wait until what was sent has arrived."""
        for publisher in (self._events, self._commands):
            publisher.wait_for_all_acked(Duration(seconds=1))


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop, 'controller', 'PD and impulses: answers joint_states with joint_commands.',
        lambda _: [Controller])
