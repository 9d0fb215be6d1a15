"""
The messages that a dashboard reads, raw and best effort: states and impulse events.

No executor serves these subscriptions: `take` reads the messages since the last call, and of the
states only the newest. Our plant also publishes throttled states for displays, because a reader of
every state would cost a composed run a third of its speed.
"""

from collections.abc import Iterator
import math
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from impulse_control_ros.core.protocol import parse_command, parse_state
from impulse_control_ros.errors import UnreadableError
from impulse_control_ros.files.cdr import FIELDS
from impulse_control_ros.files.topics import (
    IMPULSE_EVENTS,
    JOINT_STATES,
    SERIES_DEPTH,
    THROTTLED_STATES,
)
from impulse_control_ros.nodes.joint_state_io import JointStateReader

NEWEST = 25  # states taken at once at most
Taken = tuple[Any, tuple[Any, ...]]  # header, and (sec, nanosec, position, velocity, effort)


def best_effort(depth: int) -> QoSProfile:
    """Return the QoS of a reader that no writer waits for."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


class Inputs:
    """The subscriptions of ``node``; ``lost`` counts the events that did not arrive."""

    def __init__(self, node: Node) -> None:
        self.polled: set[Subscription] = set()
        self.lost = 0
        self._node = node
        self._topic, self._joint = '', ''
        self._events = self._subscribe(IMPULSE_EVENTS, SERIES_DEPTH)
        self._last_event = 0
        self._states: Subscription | None = None
        self.read_joint('axis')

    def _subscribe(self, topic: str, depth: int) -> Subscription:
        made = self._node.create_subscription(
            JointState, topic, unused, best_effort(depth), raw=True
        )
        self.polled.add(made)
        return made

    def read_joint(self, joint: str) -> None:
        """Read the values of ``joint`` from now on."""
        if joint != self._joint:
            self._joint = joint
            self._state_reader = JointStateReader(joint, parse_state, ('position',), FIELDS[1:])
            self._event_reader = JointStateReader(joint, parse_command, FIELDS)

    def choose(self) -> None:
        """Read the throttled states where a plant publishes them, else all states."""
        topic = THROTTLED_STATES if self._node.count_publishers(THROTTLED_STATES) else JOINT_STATES
        if topic != self._topic:
            self._topic = topic
            if self._states:
                self.polled.discard(self._states)
                self._node.destroy_subscription(self._states)
            self._states = self._subscribe(topic, NEWEST)

    def states(self) -> Iterator[Taken]:
        """Yield the newest states of the joint."""
        for raw, _ in messages(self._states) if self._states else ():
            try:
                header, values = self._state_reader.read(raw)
            except UnreadableError:
                continue  # of another joint; the node says which are there
            if math.isfinite(values[2]):
                yield header, values

    def events(self) -> Iterator[Taken]:
        """Yield the impulse events of the joint."""
        for raw, info in messages(self._events):
            number = info['publication_sequence_number']
            self.lost += max(0, number - self._last_event - 1) if self._last_event else 0
            self._last_event = number
            try:
                yield self._event_reader.read(raw)
            except UnreadableError:
                continue


def messages(subscription: Subscription) -> Iterator[tuple[bytes, dict[str, Any]]]:
    """Yield the messages that have arrived, with their message info."""
    take = subscription.handle.take_message
    while taken := take(subscription.msg_type, True):
        yield taken


def unused(_: bytes) -> None:
    """Do nothing: the callback of a subscription that no executor serves."""
