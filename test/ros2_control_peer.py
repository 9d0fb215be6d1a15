"""
The peers that ros2_control gives our nodes, in a few lines of rclpy, for machines without it.

They reproduce what was measured with controller_manager, joint_state_broadcaster,
forward_command_controller and JointStateTopicSystem of Jazzy. They step at a pace of their own,
and wait for what they need, so the figures do not depend on the load of the machine.

`Robot` is what a controller of ours meets: states of the broadcaster (frame base_link, reliable,
transient local, several joints, nan for what the hardware does not have), stamped by a manager on
the wall clock; the efforts of a Float64MultiArray, held until the next one, which act ``delay``
later. A share of the states may be lost on the way.

`Manager` is what our plant meets: JointStateTopicSystem publishes a command for each period of the
manager, reliable with depth 1. The effort is nan until a controller is active. The stamps are of
the wall clock, or of /clock in a process that uses simulated time. The manager then waits for
/clock to start, for another period of it, and for a period after each command.
"""

import math
import time

from builtin_interfaces.msg import Time
import numpy as np
from rclpy.qos import DurabilityPolicy, qos_profile_sensor_data, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from impulse_control_ros.core.nonidealities import Actuator
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.protocol import parse_command
from impulse_control_ros.core.simulated_plant import SimulatedPlant
from impulse_control_ros.core.tick import SECOND, to_ns

FINE = 5e-4  # s, a step of the axis
BROADCAST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ASK_AGAIN = 1.0  # s
PAUSE = 0.01  # s between the cycles of a manager on the wall clock


def stamped(message, stamp_ns):
    sec, nanosec = divmod(stamp_ns, SECOND)
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    return message


class Robot:
    """
    An axis of Table I at ``rate`` [Hz] behind ros2_control, and ``command_joints`` of its own.

    Efforts act ``delay`` [s] late; ``lost`` is the share of the states that do not arrive, drawn
    with ``seed``.
    """

    joints = ('elbow', 'axis', 'wrist')
    command_joints = ('wrist', 'axis')

    def __init__(self, client, rate, delay=5e-3, lost=0.0, seed=1):
        self._client, self._steps, self._lost = client, round(1 / (rate * FINE)), lost
        self._random = np.random.default_rng(seed)
        actuator = Actuator(delay=round(delay / FINE))
        self._axis = SimulatedPlant(Plant(x_0=0.0, time_step=FINE, actuator=actuator))
        self._stamp, self._period = time.time_ns(), SECOND // rate
        self.commands = client.listen('/joint_commands', JointState)
        self.arrays = client.listen('/forward_effort_controller/commands', Float64MultiArray, 1)
        self._states = client.node.create_publisher(JointState, '/joint_states', BROADCAST)
        self.effort = 0.0

    @property
    def position(self):
        return self._axis.measured()[0]

    def state(self):
        """Return what the broadcaster says of the present state."""
        position, velocity = self._axis.measured()
        made = JointState(name=[*self.joints])
        made.header.frame_id = 'base_link'
        made.position, made.velocity = [9.0, position, 9.0], [math.nan, velocity, 9.0]
        made.effort = [math.nan] * 3
        return stamped(made, self._stamp)

    def cycle(self):
        """Do a cycle of the manager; return whether an impulse was commanded."""
        guard = ''
        self._stamp += self._period
        if self._random.random() >= self._lost:
            guard = self._answered(self.state())
        for _ in range(self._steps):
            self._axis.step(self.effort)
        return bool(guard)

    def _answered(self, state):
        """Publish a state until its command has arrived, take the effort, return the guard."""
        self.commands.clear()
        asked = -math.inf

        def answer():
            nonlocal asked
            if time.monotonic() > asked + ASK_AGAIN:
                asked = time.monotonic()
                self._states.publish(state)
            found = [one for one in self.commands if one.header.stamp == state.header.stamp]
            efforts = [0.0, found[0].effort[0]] if found else None
            # an array says of no state that it answers it
            return self.arrays and [*self.arrays[-1].data] == efforts and found

        command = self._client.spin_until(answer, 'the command and its effort')[0]
        self.effort = self.arrays[-1].data[1]
        del self.arrays[:-1]
        return parse_command(command.header.frame_id).guard

    def respond(self, x_r, duration):
        """Give the controller a set-point; return errors [m] and impulses of all cycles [bool]."""
        assert self._client.set('controller', x_r=x_r).successful
        errors, impulses = [], []
        for _ in range(round(duration * SECOND / self._period)):
            errors.append(self.position - x_r)
            impulses.append(self.cycle())
        return np.array(errors), np.array(impulses)


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
