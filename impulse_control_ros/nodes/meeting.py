"""What the first state of a plant waits for: whom it needs, and that no other plant is there."""

from time import monotonic

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from impulse_control_ros.nodes.graph import plants, publishers
from impulse_control_ros.nodes.recorders import Recorders
from impulse_control_ros.nodes.topics import JOINT_COMMANDS

FIRST_REPORT, REPORT = 2.0, 20.0
SETTLE = 0.5  # a controller may be discovered before another plant is
LEASE = 25.0  # DDS knows by then that a process is dead


class Meeting:
    """
    The peers of a plant ``node`` whose publisher ``states`` has an id among ``own``.

    Another plant is one that publishes our states, or that a controller sends commands to. When
    several wait for each other, the one of the lowest id goes first.
    """

    def __init__(self, node: Node, own: set[bytes], states: Publisher, commands: Subscription,
                 recorders: Recorders) -> None:
        self._node, self._own, self._states, self._commands = node, own, states, commands
        self._recorders = recorders
        self._incomplete_at = self._quiet_since = monotonic()
        self._report_at, self._missing_before = self._incomplete_at + FIRST_REPORT, 0

    def complete(self, now: float, recorder_wanted: bool) -> bool:
        """Tell whether all have been there for a while; say now and then who is not."""
        self._recorders.forget_lost()
        missing = self._missing(now, recorder_wanted)
        if missing:
            self._incomplete_at = now
            if now >= self._report_at:
                self._report_at = now + REPORT
                self._node.get_logger().info(f'waiting for {" and ".join(missing)}')
            if len(missing) != self._missing_before:
                self._missing_before, self._report_at = len(missing), now + FIRST_REPORT
        return now >= self._incomplete_at + SETTLE

    def _missing(self, now: float, recorder_wanted: bool) -> list[str]:
        missing = []
        controllers = self._commands.get_publisher_count()
        if not (self._states.get_subscription_count() and controllers):
            missing.append('a controller')
        if controllers > 1:
            names = publishers(self._node, JOINT_COMMANDS).values()
            missing.append(f'all but one of {controllers} controllers to leave '
                           f'{self._commands.topic_name} ({", ".join(names)})')
        if recorder_wanted and not self._recorders:
            missing.append('a recorder')
        if self._another_plant(now):
            missing.append(f'another plant to leave {self._states.topic_name}; one more can run '
                           'in a namespace (-r __ns:=/NAME) or another ROS_DOMAIN_ID')
        return missing

    def _another_plant(self, now: float) -> bool:
        others = plants(self._node) - self._own
        first = now > self._quiet_since + LEASE and min(self._own) < min(others, default=b'')
        return self.overhears(now) or (bool(others) and not first)

    def overhears(self, now: float) -> bool:
        """Tell whether a controller has just commanded another plant."""
        return now < self._quiet_since + SETTLE

    def hear(self) -> None:
        """Take note of a command that answers no state of ours: it is for another plant."""
        self._quiet_since = monotonic()
