"""The messages of a controller: commands, impulse events and parameters."""

from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from sensor_msgs.msg import JointState

from impulse_control_ros.core.control_law import GUARDS, NO_IMPULSE
from impulse_control_ros.core.protocol import CommandHeader, NodeHeader
from impulse_control_ros.files.cdr import COMMANDED, FIELDS
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.topics import IMPULSE_EVENTS, JOINT_COMMANDS, RUN_PARAMETERS
from impulse_control_ros.nodes.joint_state_io import verified_layout
from impulse_control_ros.nodes.topics import Output


class Answers:
    """
    The outputs of a controller with the id ``own_id`` for ``joint``.

    ``sent`` counts the states answered, ``impulses`` those with an impulse.
    """

    def __init__(self, node: Node, own_id: str, joint: str) -> None:
        self.sent = self.impulses = 0
        self._own_id, self._joint = own_id, joint
        self.parameters = Output(node, ParameterEvent, RUN_PARAMETERS)
        self.events = Output(node, JointState, IMPULSE_EVENTS)
        self.commands = Output(node, JointState, JOINT_COMMANDS)
        self._last = b'', b''
        self.address('', 0)

    def address(self, run: str, episode: int) -> None:
        """Answer the states of a run and episode from now on; ``run`` is '' if foreign."""
        self._run = run
        frame_ids = [CommandHeader(run, episode, self._own_id, guard).frame_id for guard in GUARDS]
        self._events, self._commands = (
            [verified_layout(self._joint, frame_id, fields) for frame_id in frame_ids]
            for fields in (FIELDS, COMMANDED)
        )

    def tell_parameters(
        self, sec: int, nanosec: int, parameters: Mapping[str, Any], changed: Mapping[str, Any]
    ) -> None:
        """Publish the parameters that take effect at the state of this stamp."""
        node = NodeHeader(self._run, self._own_id).frame_id
        self.parameters.send(encode_parameter_event(sec, nanosec, node, parameters, changed))

    def send(self, sec: int, nanosec: int, effort: float) -> None:
        """Publish a command without an impulse."""
        command = self._commands[NO_IMPULSE].encode(sec, nanosec, effort)
        self._last = b'', command
        self.sent += 1
        self.commands.send(command)

    def send_impulse(
        self, sec: int, nanosec: int, effort: float, guard: int, *impulse: float
    ) -> None:
        """Publish an ``impulse`` (position, velocity, area) of a guard, and its command."""
        event = self._events[guard].encode(sec, nanosec, *impulse)
        command = self._commands[guard].encode(sec, nanosec, effort)
        self._last = event, command
        self.sent += 1
        self.impulses += 1
        self.events.send(event)
        self.commands.send(command)

    def repeat(self) -> None:
        """Publish the last answer again."""
        event, command = self._last
        if event:
            self.events.send(event)
        self.commands.send(command)

    def send_zero(self) -> None:
        """Command 0 N with stamp 0, which ROS reads as no time: it answers no state."""
        command = self._commands[NO_IMPULSE].encode(0, 0, 0.0)
        self._last = b'', command
        self.commands.send(command)
