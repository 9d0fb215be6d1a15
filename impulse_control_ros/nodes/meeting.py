"""What the first state of a plant waits for: whom it needs, and that no other plant is there."""

from time import monotonic

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from impulse_control_ros.nodes.graph import publishers, subscribers
from impulse_control_ros.nodes.recorders import Recorders
from impulse_control_ros.nodes.topics import JOINT_STATES, RECORDER_PROGRESS

REPORT = 2.0
SETTLE = 0.5  # a controller may be discovered before another plant is


class Meeting:
    """The peers of a plant ``node`` with these endpoints and ``recorders``."""

    def __init__(self, node: Node, states: Publisher, commands: Subscription,
                 recorders: Recorders) -> None:
        self._node, self._states, self._commands = node, states, commands
        self._recorders = recorders
        self._reported_at = self._incomplete_at = monotonic()

    def complete(self, now: float, recorder_wanted: bool) -> bool:
        """Tell whether all have been there for a while; say now and then who is not."""
        missing = self._missing(recorder_wanted)
        if missing:
            self._incomplete_at = now
            if now >= self._reported_at + REPORT:
                self._reported_at = now
                self._node.get_logger().info(f'waiting for {" and ".join(missing)}')
        return now >= self._incomplete_at + SETTLE

    def _missing(self, recorder_wanted: bool) -> list[str]:
        missing = []
        if not (self._states.get_subscription_count() and self._commands.get_publisher_count()):
            missing.append('a controller')
        if recorder_wanted and not self._recorders:
            missing.append('a recorder')
        if self._states_shared():
            missing.append(f'another plant to leave {self._states.topic_name}; one more can run '
                           'in a namespace (-r __ns:=/NAME) or another ROS_DOMAIN_ID')
        return missing

    def _states_shared(self) -> bool:
        """Tell whether another plant publishes our states: it too hears of recorders."""
        plants = publishers(self._node, JOINT_STATES)
        return len(plants) > 1 and len(
            [name for name in subscribers(self._node, RECORDER_PROGRESS) if name in plants]) > 1
