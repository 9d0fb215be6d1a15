"""The messages of a controller: commands, impulse events and parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from impulse_control_ros.core.control_law import GUARDS, NO_IMPULSE
from impulse_control_ros.core.impulse_verdicts import NO_VERDICT, VERDICTS
from impulse_control_ros.core.protocol import CommandHeader, NodeHeader
from impulse_control_ros.files.cdr import (
    COMMANDED,
    encode_float64_array,
    FIELDS,
    JointStateLayout,
)
from impulse_control_ros.files.experiment import ControllerParameters, EFFORT_ARRAY
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.topics import (
    EFFORT_COMMANDS,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    RUN_PARAMETERS,
)
from impulse_control_ros.nodes.joint_state_io import verified_layout
from impulse_control_ros.nodes.topics import NEWEST_QOS, Output


class EffortArray:
    """The efforts on effort_commands: those of all ``command_joints``, 0 N but for ours."""

    def __init__(self, node: Node, parameters: ControllerParameters) -> None:
        joints = parameters.command_joints or (parameters.joint_name,)
        self._efforts = [0.0] * len(joints)
        self._ours = joints.index(parameters.joint_name)
        self.output = Output(node, Float64MultiArray, EFFORT_COMMANDS, NEWEST_QOS)

    def send(self, effort: float) -> None:
        """Publish the ``effort`` [N] of our joint."""
        self._efforts[self._ours] = effort
        self.output.send(encode_float64_array(self._efforts))


class Answers:
    """
    The outputs of a controller with the id ``own_id``.

    ``sent`` counts the states answered, ``impulses`` those with an impulse, ``verdicts`` those
    with each of VERDICTS. ``efforts`` is None unless ``command_interface`` is effort_array.
    """

    def __init__(self, node: Node, own_id: str, parameters: ControllerParameters) -> None:
        self.sent = self.impulses = 0
        self.verdicts = [0] * len(VERDICTS)
        self._own_id, self._joint = own_id, parameters.joint_name
        self.parameters = Output(node, ParameterEvent, RUN_PARAMETERS)
        self.events = Output(node, JointState, IMPULSE_EVENTS)
        self.commands = Output(node, JointState, JOINT_COMMANDS)
        as_array = parameters.command_interface == EFFORT_ARRAY
        self.efforts = EffortArray(node, parameters) if as_array else None
        self._last = 0.0, b'', b''
        self.address('', 0)

    def address(self, run: str, episode: int) -> None:
        """Answer the states of a run and episode from now on; ``run`` is '' if foreign."""
        self._run, self._episode = run, episode
        self._plain = self._layout(NO_IMPULSE, NO_VERDICT, COMMANDED)
        # by guard and verdict, of which few occur: event and command
        self._layouts: dict[tuple[int, int], tuple[JointStateLayout, JointStateLayout]] = {}

    def _layout(self, guard: int, verdict: int, fields: Sequence[str]) -> JointStateLayout:
        header = CommandHeader(
            self._run, self._episode, self._own_id, GUARDS[guard], VERDICTS[verdict]
        )
        return verified_layout(self._joint, header.frame_id, fields)

    def tell_parameters(
        self, sec: int, nanosec: int, parameters: Mapping[str, Any], changed: Mapping[str, Any]
    ) -> None:
        """Publish the parameters that take effect at the state of this stamp."""
        node = NodeHeader(self._run, self._own_id).frame_id
        self.parameters.send(encode_parameter_event(sec, nanosec, node, parameters, changed))

    def send(self, sec: int, nanosec: int, effort: float) -> None:
        """Publish a command without an event."""
        self.sent += 1
        self._last = effort, b'', self._plain.encode(sec, nanosec, effort)
        self.repeat()

    def send_event(
        self, sec: int, nanosec: int, effort: float, guard: int, verdict: int, *values: float
    ) -> None:
        """Publish an event (position, velocity, area) and its command."""
        self.sent += 1
        self.impulses += guard != NO_IMPULSE
        self.verdicts[verdict] += 1
        layouts = self._layouts.get((guard, verdict))
        if layouts is None:
            event, command = (self._layout(guard, verdict, one) for one in (FIELDS, COMMANDED))
            layouts = self._layouts[guard, verdict] = event, command
        event, command = layouts
        self._last = (
            effort,
            event.encode(sec, nanosec, *values),
            command.encode(sec, nanosec, effort),
        )
        self.repeat()

    def send_zero(self) -> None:
        """Command 0 N with stamp 0, which ROS reads as no time: it answers no state."""
        self._last = 0.0, b'', self._plain.encode(0, 0, 0.0)
        self.repeat()

    def repeat(self) -> None:
        """Publish the last answer again."""
        effort, event, command = self._last
        if self.efforts:
            self.efforts.send(effort)
        if event:
            self.events.send(event)
        self.commands.send(command)

    def wait(self) -> None:
        """Wait until the sent messages are acknowledged."""
        outputs = [self.events, self.commands, *([self.efforts.output] if self.efforts else [])]
        for output in outputs:
            output.publisher.wait_for_all_acked(Duration(seconds=1))
