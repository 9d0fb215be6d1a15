"""The messages of a plant: states, clock, damping and parameters."""

from collections.abc import Mapping
import math
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from impulse_control_ros.core.protocol import NodeHeader, StateHeader
from impulse_control_ros.core.tick import samples_between
from impulse_control_ros.files.cdr import encode_float64, encode_time, WITHOUT_VELOCITY
from impulse_control_ros.files.experiment import PlantParameters
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.topics import (
    CLOCK,
    DAMPING,
    JOINT_STATES,
    RUN_PARAMETERS,
    THROTTLED_STATES,
)
from impulse_control_ros.nodes.joint_state_io import verified_layout
from impulse_control_ros.nodes.topics import Output, SERIES_QOS, SLOW_QOS

THROTTLE = 0.004  # s of wall time between throttled states: curves of 250 points per second


class PlantOutputs:
    """The outputs of the plant ``node`` for ``joint``."""

    def __init__(self, node: Node, joint: str) -> None:
        self.parameters = Output(node, ParameterEvent, RUN_PARAMETERS)
        self.states = Output(node, JointState, JOINT_STATES)
        self.throttled = Output(node, JointState, THROTTLED_STATES, SLOW_QOS)
        self.clock = Output(node, Clock, CLOCK, SERIES_QOS)
        self.damping = Output(node, Float64, DAMPING)
        self._name = node.get_fully_qualified_name()
        self._joint = joint
        self._header: StateHeader | None = None
        self._last = (0, 0), math.nan, math.nan, 0.0
        self._last_clock = b''
        self._raw = b''
        self._throttled_until = -math.inf
        self._clock_every = self._damping_every = 0

    def change(self, parameters: PlantParameters) -> None:
        """Update the rates of clock and damping."""
        self._clock_every = samples_between(parameters.clock_rate, parameters.time_step)
        self._damping_every = parameters.damping_every

    def tell_parameters(
        self,
        run: str,
        stamp: tuple[int, int],
        parameters: Mapping[str, Any],
        changed: Mapping[str, Any],
    ) -> None:
        """Publish the parameters that take effect at the state of this stamp."""
        node = NodeHeader(run, self._name).frame_id
        self.parameters.send(encode_parameter_event(*stamp, node, parameters, changed))

    def send_state(
        self,
        header: StateHeader,
        stamp: tuple[int, int],
        position: float,
        velocity: float,
        effort: float,
    ) -> None:
        """Publish a state; a velocity of nan (not measured) is left empty."""
        self._last = stamp, position, velocity, effort
        if header is not self._header:
            self._header = header
            self._layout, self._layout_without_velocity = (
                verified_layout(self._joint, header.frame_id, *fields)
                for fields in ((), (WITHOUT_VELOCITY,))
            )
        if math.isnan(velocity):
            raw = self._layout_without_velocity.encode(*stamp, position, effort)
        else:
            raw = self._layout.encode(*stamp, position, velocity, effort)
        self._raw = raw
        self.states.send(raw)

    def send_again(self, header: StateHeader, with_clock: bool) -> None:
        """Publish the last state again, and the last clock, which a peer may wait for."""
        self.send_state(header, *self._last)
        if with_clock and self._clock_every:
            self.clock.send(self._last_clock)
        self.throttled.send(self._raw)

    def send_throttled(self, now: float) -> None:
        """Publish the last state for displays too, which every sample would cost a third."""
        if now >= self._throttled_until:
            self._throttled_until = now + THROTTLE
            self.throttled.send(self._raw)

    def send_beside(self, tick: int, stamp: tuple[int, int], damping: float) -> None:
        """Publish clock and damping [N s/m] if they are due at ``tick``."""
        if self._clock_every and tick % self._clock_every == 0:
            self._last_clock = encode_time(*stamp)
            self.clock.send(self._last_clock)
        if self._damping_every and tick % self._damping_every == 0 and tick:
            self.damping.send(encode_float64(damping))

    def wait(self) -> None:
        """Wait until the sent messages are acknowledged."""
        for output in (self.states, self.clock, self.damping, self.parameters):
            output.publisher.wait_for_all_acked(Duration(seconds=1))
