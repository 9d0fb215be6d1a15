"""
``excite``: moves an axis for identification by set-points only.

It turns the impulses of the controller off and publishes the set-points of core/excitation.py on
``setpoint``, in answer to joint_states. Before each set-point it waits until run_parameters shows
that the controller has taken the last one. At the end it restores ``x_r`` and ``impulses``.
It stops when a limit is exceeded, when no states arrive, or when the user interrupts it. The
set-point is then the position of the axis, impulses stay off, and the exit status is 1.
"""

import argparse
from dataclasses import dataclass
from functools import partial
import math
from time import monotonic
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.duration import Duration
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.core.excitation import Excitation, Limits
from impulse_control_ros.core.parameter import parameter, Parameters
from impulse_control_ros.core.protocol import name_of, parse_node
from impulse_control_ros.core.tick import SECOND, to_ns
from impulse_control_ros.errors import ExcitationError, UnreadableError, UsageError
from impulse_control_ros.files.experiment import cpu_core_parameter
from impulse_control_ros.files.topics import JOINT_STATES, RUN_PARAMETERS, SETPOINT
from impulse_control_ros.nodes.joint_state_io import JointStateReader
from impulse_control_ros.nodes.known_plants import decoded
from impulse_control_ros.nodes.parameter_requests import Requests
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.spin import IDLE, main as run_node
from impulse_control_ros.nodes.topics import LATCHED_QOS, SLOW_QOS

# only the newest state: set-points in answer to queued states would come in a burst
NEWEST_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
PERIOD = SECOND // 50  # ns between two set-points, by the stamps of the states
WAITS = 0.01  # s between two polls of a pending response
ASKED = ('K', 'D', 'x_r', 'impulses', 'joint_name')
DESCRIPTION = """\
Move an axis for identification, with ramps at three speeds and steps, in both directions, by the
set-point of a running controller. Impulses are off during the motion. Record the motion."""


@dataclass(frozen=True, kw_only=True)
class ExciteParameters(Parameters):
    """Parameters of the node ``excite``."""

    state_timeout: float = parameter(
        2.0, 's', 'wall time without a state after which the motion stops', lower=0.01
    )
    discovery_timeout: float = parameter(
        30.0, 's', 'wall time that the controller and its states are waited for', lower=0.01
    )
    cpu_core: int = cpu_core_parameter()


class Excite(ParameterNode):
    """Moves the axis of a controller of ours within limits."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__('excite', ExciteParameters)
        self._limits = limits_of(options)
        self._controller = options.controller
        namespace = self.get_namespace().rstrip('/')
        self._full_name = f'/{options.controller}'.replace('//', '/')
        if not options.controller.startswith('/'):
            self._full_name = f'{namespace}{self._full_name}'
        self._requests = Requests(self, options.controller)
        self._set_point = self.create_publisher(Float64, SETPOINT, SLOW_QOS)
        self._before: dict[str, Any] = {}
        self._motion: Excitation | None = None
        self._moves = self._is_over = False
        self._position = math.nan
        self._first = self._last = self._told_at = 0
        self._told, self._taken = math.nan, True
        self._heard = self._published = monotonic()
        self._asked = False
        self.get_logger().info(f'waiting for {self._controller} and joint_states')

    # -- answers of the controller ----------------------------------------------------------

    def _listen(self, response: Any) -> None:
        """Listen to the states of the controller's joint."""
        values = map(parameter_value_to_python, response.values)
        self._before = dict(zip(ASKED, values, strict=True))
        self._reader = JointStateReader(self._before['joint_name'], str, ('position',))
        self.create_subscription(JointState, JOINT_STATES, self._on_state, NEWEST_QOS, raw=True)
        self.create_subscription(
            ParameterEvent, RUN_PARAMETERS, self._on_parameters, LATCHED_QOS, raw=True
        )

    def _begin(self) -> None:
        self._moves = True
        limits = self._limits
        self.get_logger().info(
            f'impulses are off; moving within {limits.low:g} to {limits.high:g} m at up to '
            f'{limits.speed:g} m/s'
        )

    def _finish(self) -> None:
        assert self._motion is not None
        speeds, self.finished = self._motion.speeds, True
        self.get_logger().info(
            f'{len(speeds)} moves in {(self._last - self._first) / SECOND:.3g} s at up to '
            f'{max(speeds):.3g} m/s; x_r and impulses are restored'
        )

    # -- states -----------------------------------------------------------------------------

    def _on_state(self, raw: bytes) -> None:
        """Answer a state with a set-point."""
        try:
            _, (sec, nanosec, position) = self._reader.read(raw)
        except UnreadableError as error:
            if not error.is_normal:
                self.get_logger().warning(f'joint_states: {error}', throttle_duration_sec=5.0)
            return
        stamp = to_ns(sec, nanosec)
        if not math.isfinite(position) or stamp == self._last or self.finished:
            return
        self._heard, self._position = monotonic(), position
        try:
            self._move(stamp, position)
        except ExcitationError as error:
            self._stop(error)

    def _move(self, stamp: int, position: float) -> None:
        if stamp < self._last:
            raise ExcitationError('the stamps of joint_states went back')
        self._last = stamp
        if self._motion is None:
            K, D, x_r, *_ = self._before.values()
            self._motion, self._told = Excitation(self._limits, K, D, x_r, position), x_r
            self._requests.set({'impulses': False}, self._begin)
        if not self._moves:
            return
        self._first = self._first or stamp
        self._motion.watch((stamp - self._first) / SECOND, position)
        if not self._taken or stamp < self._told_at + PERIOD:
            return
        point = self._motion.next_set_point()
        self._told_at = stamp
        if point is None:
            self._moves, self._is_over = False, True
            before = {name: self._before[name] for name in ('x_r', 'impulses')}
            self._requests.set(before, self._finish)
        elif point != self._told:
            self._told, self._taken, self._published = point, False, monotonic()
            self._set_point.publish(Float64(data=point))

    def _on_parameters(self, raw: bytes) -> None:
        """Note that the controller has taken the set-point."""
        *_, node, _, changed = decoded(raw)
        if name_of(parse_node(node)[1]) == self._full_name:
            self._taken = self._taken or changed.get('x_r') == self._told

    # -- the end ----------------------------------------------------------------------------

    def _stop(self, reason: ExcitationError | str) -> None:
        """End with an error, and hold the axis where it is if it was moved."""
        if self._motion is None:
            self.fail(ExcitationError(str(reason)))
            return
        if self._is_over:
            self.fail(ExcitationError(f'{reason}: impulses and x_r may not be restored'))
            return
        at = min(max(self._position, self._limits.low), self._limits.high)
        self._set_point.publish(Float64(data=at))
        self._moves = False
        self.fail(
            ExcitationError(
                f'{reason}: stopped; the controller holds {at:g} m, and its impulses are off'
            )
        )

    def poll(self) -> float:
        """Make the next request; stop if the controller or the states are missing."""
        patience, now = self.parameters.discovery_timeout, monotonic()
        limit = self.parameters.state_timeout if self._last else patience
        try:
            if not self._asked and self._set_point.get_subscription_count():
                self._asked = True
                self._requests.get(ASKED, self._listen)
            self._requests.poll(patience)
            if now > self._heard + limit:
                missing = (
                    'state on joint_states' if self._before else (f'answer of {self._controller}')
                )
                raise ExcitationError(f'no {missing} for {limit:g} s')
            if self._moves and not self._taken and now > self._published + limit:
                raise ExcitationError(f'{self._controller} took no set-point for {limit:g} s')
        except ExcitationError as error:
            self._stop(error)
        return IDLE if self._before and not self._requests.pending else WAITS

    def close(self) -> None:
        """Stop a motion that is interrupted, and wait until its set-point is acknowledged."""
        if not self.finished:
            self._stop('interrupted')
        self._set_point.wait_for_all_acked(Duration(seconds=1))


def limits_of(options: argparse.Namespace) -> Limits:
    """Return the limits; raises `UsageError`."""
    (low, high), speed = options.travel, options.max_speed
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UsageError(f'--travel {low:g} {high:g}: LOW must be below HIGH, both finite [m]')
    if not 0.0 < speed < math.inf:
        raise UsageError(f'--max-speed {speed:g}: must be > 0 and finite [m/s]')
    return Limits(low=low, high=high, speed=speed)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that are not ROS arguments."""
    parser.add_argument(
        '--travel',
        metavar=('LOW', 'HIGH'),
        nargs=2,
        type=float,
        required=True,
        help='the positions [m] that the axis stays between',
    )
    parser.add_argument(
        '--max-speed',
        metavar='V',
        type=float,
        required=True,
        help='the speed [m/s] that the axis stays below, as a mean over 20 ms',
    )
    parser.add_argument(
        '--controller',
        metavar='NODE',
        default='controller',
        help='the controller to use (default: %(default)s)',
    )


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop,
        'excite',
        DESCRIPTION,
        lambda options: [partial(Excite, options)],
        'state_timeout:=5.0',
        add_options,
    )
