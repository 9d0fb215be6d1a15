"""A node's counters on /diagnostics, once per second of wall time."""

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from impulse_control_ros.nodes.topics import DIAGNOSTICS, SLOW_QOS


class Diagnostics:
    """
    Publishes what ``report`` returns: a level, a sentence, and values by name.

    The timer is on the steady clock: simulated time does not stop it.
    """

    def __init__(self, node: Node,
                 report: Callable[[], tuple[bytes, str, Mapping[str, object]]]) -> None:
        self._node, self._report = node, report
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, SLOW_QOS)
        node.create_timer(1.0, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        level, message, values = self._report()
        status = DiagnosticStatus(
            level=level, name=self._node.get_fully_qualified_name(), message=message,
            hardware_id='impulse_control_ros',
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
        array = DiagnosticArray(status=[status])
        array.header.stamp = Clock().now().to_msg()
        self._publisher.publish(array)
