"""
The floors of lockstep.py: processes that exchange the raw messages of the nodes, and do no more.

    python benchmarks/floors.py {composed,ping,echo} STEPS [--best-effort] [--udp] [--core N]

``ping`` publishes a state for each command and prints the steps per second, ``echo`` answers until
it is interrupted. ``composed`` publishes and takes both on one thread.
"""

import argparse
import signal
import time
from typing import Any

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_rmw_implementation_identifier
from sensor_msgs.msg import JointState

from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.topics import SERIES_DEPTH
from impulse_control_ros.nodes.transport import place_on_core, prefer_udp

STATE = JointStateLayout('axis', 'run:0123abcd.0 /controller#01ab').encode(1, 0, 0.5, 0.0, 0.0)
COMMAND = JointStateLayout('axis', 'run:0123abcd.0 /controller#01ab', ('effort',)).encode(
    1, 0, 5.0
)
RESEND = 0.02  # s
NUMBER = slice(8, 12)  # the nanoseconds of the stamp, which tell a command from a repeated one


class End:
    """A node with a publisher of one topic and a subscription of the other."""

    def __init__(self, name: str, out: str, into: str, best_effort: bool, message: bytes) -> None:
        self.node = rclpy.create_node(name)
        self._publisher = self.node.create_publisher(
            JointState, out, QoSProfile(depth=SERIES_DEPTH)
        )
        self.subscription = self.node.create_subscription(
            JointState,
            into,
            self.on_message,
            QoSProfile(
                depth=SERIES_DEPTH,
                reliability=ReliabilityPolicy.BEST_EFFORT
                if best_effort
                else ReliabilityPolicy.RELIABLE,
            ),
            raw=True,
        )
        self.publish = self._publisher.publish
        self._head, self._tail = message[: NUMBER.start], message[NUMBER.stop :]

    def send(self, number: bytes) -> None:
        """Publish the message with this number."""
        self.publish(self._head + number + self._tail)

    def on_message(self, raw: bytes) -> None:
        """Answer it."""
        self.send(raw[NUMBER])

    @property
    def matched(self) -> bool:
        """Whether the other end is there."""
        return bool(
            self._publisher.get_subscription_count()
            and self.subscription.handle.get_publisher_count()
        )


class Ping(End):
    """The end that counts: it sends the next state once the command of the last is there."""

    count = 0

    def on_message(self, raw: bytes) -> None:
        """Send the next state, unless the command is one that comes again."""
        if raw[NUMBER] == self._number:
            self.count += 1
            self.send(self._number)

    @property
    def _number(self) -> bytes:
        return self.count.to_bytes(4, 'little')

    def send_again(self) -> None:
        """Send the last state again."""
        self.send(self._number)


def wait_for(*ends: End) -> None:
    """Wait until the ends are matched."""
    while not all(end.matched for end in ends):
        time.sleep(0.01)


def composed(steps: int) -> float:
    """Return the steps per second of one thread that publishes and takes."""
    plant = End('plant', 'joint_states', 'joint_commands', False, STATE)
    controller = End('controller', 'joint_commands', 'joint_states', False, COMMAND)
    wait_for(plant, controller)
    began = time.perf_counter()
    for _ in range(steps):
        plant.publish(STATE)
        with controller.subscription.handle:
            controller.subscription.handle.take_message(JointState, True)
        controller.publish(COMMAND)
        with plant.subscription.handle:
            plant.subscription.handle.take_message(JointState, True)
    rate = steps / (time.perf_counter() - began)
    for end in (plant, controller):
        end.node.destroy_node()
    return rate


def ping(steps: int, best_effort: bool) -> float:
    """Return the steps per second of two processes: this one, and an echo."""
    end = Ping('plant', 'joint_states', 'joint_commands', best_effort, STATE)
    wait_for(end)
    executor = EventsExecutor()
    executor.add_node(end.node)
    began = time.perf_counter()
    due = 0.0
    while end.count < steps:
        before = end.count
        executor.spin_once(timeout_sec=RESEND)
        now = time.perf_counter()
        if end.count > before:
            due = now + RESEND
        elif now >= due:
            end.send_again()
            due = now + RESEND
    rate = steps / (time.perf_counter() - began)
    executor.shutdown()
    end.node.destroy_node()
    return rate


def echo(best_effort: bool) -> None:
    """Answer until SIGINT."""
    stopped: list[Any] = []
    signal.signal(signal.SIGINT, lambda *_: stopped.append(True))
    end = End('controller', 'joint_commands', 'joint_states', best_effort, COMMAND)
    executor = EventsExecutor()
    executor.add_node(end.node)
    while not stopped:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    end.node.destroy_node()


def main() -> None:
    """Be one of the processes."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('role', choices=('composed', 'ping', 'echo'))
    parser.add_argument('steps', type=int)
    parser.add_argument('--best-effort', action='store_true', help='readers are best effort')
    parser.add_argument('--udp', action='store_true', help='the transport of our nodes')
    parser.add_argument('--core', type=int, default=-1)
    options = parser.parse_args()
    place_on_core(options.core)
    if options.udp:
        prefer_udp(get_rmw_implementation_identifier())
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    if options.role == 'echo':
        echo(options.best_effort)
    elif options.role == 'ping':
        print(ping(options.steps, options.best_effort))
    else:
        print(composed(options.steps))
    rclpy.shutdown()


if __name__ == '__main__':
    main()
