"""
The peers that ros2_control gives our nodes, in a few lines of rclpy, for machines without it.

They reproduce what was measured with controller_manager, joint_state_broadcaster,
forward_command_controller and JointStateTopicSystem of Jazzy. They step at a pace of their own,
and wait for what they need, so the figures do not depend on the load of the machine.

`Robot` is what a controller of ours meets: states of the broadcaster (frame base_link, reliable,
transient local, several joints, nan for what the hardware does not have), stamped by a manager on
the wall clock; the efforts of a Float64MultiArray, held until the next one. The axis below is that
of scripts/ros2_control_loop.py, with its delay and lost states.

`Manager` is what our plant meets: JointStateTopicSystem publishes a command for each period of the
manager, reliable with depth 1. The effort is nan until a controller is active. The stamps are of
the wall clock, or of /clock in a process that uses simulated time. The manager then waits for
/clock to start, for another period of it, and for a period after each command.
"""

import math
import time

from builtin_interfaces.msg import Time
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from impulse_control_ros.core.protocol import parse_command
from impulse_control_ros.core.tick import SECOND, to_ns
from scripts.ros2_control_loop import respond, responses

BROADCAST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ASK_AGAIN = 1.0  # s
PAUSE = 0.01  # s between the cycles of a manager on the wall clock


def stamped(message, stamp_ns):
    sec, nanosec = divmod(stamp_ns, SECOND)
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    return message


class Robot:
    """
    An ``axis`` behind ros2_control, of a `DelayedAxis`, with two joints beside it.

    ``command_joints`` is the order of its effort controller.
    """

    joints = ('elbow', 'axis', 'wrist')
    command_joints = ('wrist', 'axis')

    def __init__(self, client, axis):
        self._client, self._axis, self._start = client, axis, time.time_ns()
        self.commands = client.listen('/joint_commands', JointState)
        self.arrays = client.listen('/forward_effort_controller/commands', Float64MultiArray, 1)
        self._states = client.node.create_publisher(JointState, '/joint_states', BROADCAST)

    def _state(self, position, velocity):
        """Return what the broadcaster says of a state of the axis."""
        made = JointState(name=[*self.joints])
        made.header.frame_id = 'base_link'
        made.position, made.velocity = [9.0, position, 9.0], [math.nan, velocity, 9.0]
        made.effort = [math.nan] * 3
        return stamped(made, self._start + self._axis.cycles * SECOND // self._axis.rate)

    def _answer(self, position, velocity):
        """Publish a state until its command has arrived; return effort and whether it is begun."""
        state = self._state(position, velocity)
        self.commands.clear()
        asked = -math.inf

        def answered():
            nonlocal asked
            if time.monotonic() > asked + ASK_AGAIN:
                asked = time.monotonic()
                self._states.publish(state)
            found = [one for one in self.commands if one.header.stamp == state.header.stamp]
            efforts = [0.0, found[0].effort[0]] if found else None
            # an array says of no state that it answers it
            return self.arrays and [*self.arrays[-1].data] == efforts and found

        command = self._client.spin_until(answered, 'the command and its effort')[0]
        effort = self.arrays[-1].data[1]
        del self.arrays[:-1]
        return effort, bool(parse_command(command.header.frame_id).guard)

    def _set(self, x_r):
        assert self._client.set('controller', x_r=x_r).successful

    def responses(self, count, last):
        """Yield the responses to ``count`` set-points."""
        return responses(self._axis, self._answer, self._set, count, last)

    def respond(self, x_r, last):
        """Give the controller a set-point; return the response."""
        self._set(x_r)
        return respond(self._axis, self._answer, x_r, last)


class Manager:
    """
    A manager of 1 / ``period`` [s] above our plant in /hardware; no controller is active yet.

    Without ``sim_time`` it commands on the wall clock. Its stamps are of the simulated time only
    if ``sim_stamps``, as the hardware has a node of its own.
    """

    def __init__(self, client, period, sim_time=False, sim_stamps=False):
        self._client, self._period = client, round(period * SECOND)
        self._sim_time, self._sim_stamps = sim_time, sim_stamps
        node = client.node
        self.states = []
        self._clock, self._due = 0, 0
        self.effort, self.lost = math.nan, 0  # commands that are yet to be lost
        self._publisher = node.create_publisher(JointState, '/hardware/joint_commands', 1)
        self._subscriptions = [
            node.create_subscription(
                JointState, '/hardware/joint_states', self.states.append, qos_profile_sensor_data
            ),
            node.create_subscription(Clock, '/clock', self._on_clock, qos_profile_sensor_data),
        ]

    def _on_clock(self, message):
        self._clock = to_ns(message.clock.sec, message.clock.nanosec)
        self._due = self._due or self._clock + self._period

    def run_until(self, condition, what):
        """Run the cycles until ``condition`` is true."""

        def cycle():
            if self._sim_time and not 0 < self._due <= self._clock:
                return condition()
            if not self._sim_time:
                time.sleep(PAUSE)
            self._due = self._clock + self._period
            stamp = self._clock if self._sim_stamps else time.time_ns()
            command = stamped(JointState(name=['axis'], effort=[self.effort]), stamp)
            if not self.lost:
                self._publisher.publish(command)
            self.lost = max(0, self.lost - 1)
            return condition()

        self._client.spin_until(cycle, what)

    def close(self):
        """Leave, as a process that ends."""
        self._client.node.destroy_publisher(self._publisher)
        for subscription in self._subscriptions:
            self._client.node.destroy_subscription(subscription)
