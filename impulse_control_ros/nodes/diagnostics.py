"""A node's counters on /diagnostics, once per second of wall time."""

from collections.abc import Callable, Mapping
from time import monotonic

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from impulse_control_ros.files.topics import DIAGNOSTICS
from impulse_control_ros.nodes.topics import SLOW_QOS


class Diagnostics:
    """
    Publishes what ``report`` returns: a level, a sentence, and values by name.

    ``progress`` returns (steps, simulated seconds) so far; `Diagnostics` adds their rates per
    second of wall time. The timer uses the steady clock, so simulated time does not stop it.
    """

    def __init__(
        self,
        node: Node,
        progress: Callable[[], tuple[int, float]],
        report: Callable[[float], tuple[bytes, str, Mapping[str, object]]],
    ) -> None:
        self._node, self._progress, self._report = node, progress, report
        self._before = (monotonic(), *progress())
        self._publisher = node.create_publisher(DiagnosticArray, DIAGNOSTICS, SLOW_QOS)
        node.create_timer(1.0, self._publish, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _publish(self) -> None:
        before, self._before = self._before, (monotonic(), *self._progress())
        wall, steps, seconds = (now - then for now, then in zip(self._before, before, strict=True))
        rate = max(0.0, steps / wall)  # a new run starts from zero
        level, message, values = self._report(rate)
        rates = {
            'steps': self._before[1],
            'steps_per_second': f'{rate:.1f}',
            'real_time_factor': f'{max(0.0, seconds / wall):.3f}',
        }
        status = DiagnosticStatus(
            level=level,
            name=self._node.get_fully_qualified_name(),
            message=message,
            hardware_id='impulse_control_ros',
            values=[
                KeyValue(key=key, value=str(value))
                for key, value in (rates | dict(values)).items()
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = Clock().now().to_msg()
        self._publisher.publish(array)
