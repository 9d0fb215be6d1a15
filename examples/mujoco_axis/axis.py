"""
An axis in MuJoCo, shown as the driver of a robot shows one: it knows nothing of this package.

joint_states of three joints at 1 kHz by the wall clock, MuJoCo steps in between; the effort of
the newest joint_commands is held. Time is the axis' own: a process that is late by more than a
sample stands still meanwhile, and does not make up for it.
"""

from pathlib import Path
from time import monotonic, time_ns

import mujoco
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

MODEL = Path(__file__).with_name('axis.xml')
PERIOD_NS = 1_000_000
SECOND = 10**9


class MujocoAxis(Node):
    """Publishes all joints of the model, and moves those that have a motor."""

    def __init__(self) -> None:
        super().__init__('mujoco_axis')
        self._model = mujoco.MjModel.from_xml_path(str(MODEL))
        self._data = mujoco.MjData(self._model)
        mujoco.mj_resetDataKeyframe(self._model, self._data, 0)
        self._steps = round(PERIOD_NS / SECOND / self._model.opt.timestep)
        self._motors = {self._model.actuator(i).name: i for i in range(self._model.nu)}
        self._state = JointState(name=[self._model.joint(i).name for i in range(self._model.njnt)])
        self._stamp = time_ns()
        self._publisher = self.create_publisher(JointState, 'joint_states', 1000)
        self.create_subscription(JointState, 'joint_commands', self._on_command, 1000)

    def _on_command(self, command: JointState) -> None:
        for name, effort in zip(command.name, command.effort, strict=False):
            if name in self._motors:
                self._data.ctrl[self._motors[name]] = effort

    def publish(self) -> None:
        """Publish the state of now, with the effort of the sample before."""
        state, data = self._state, self._data
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(self._stamp, SECOND)
        state.position, state.velocity = data.qpos.tolist(), data.qvel.tolist()
        state.effort = data.qfrc_actuator.tolist()
        self._publisher.publish(state)

    def step(self) -> None:
        """Go on by one sample, with the effort of now."""
        mujoco.mj_step(self._model, self._data, nstep=self._steps)
        self._stamp += PERIOD_NS


def run(node: MujocoAxis, executor: EventsExecutor) -> None:
    """Make samples by the wall clock until ROS shuts down."""
    period = PERIOD_NS / SECOND
    due = monotonic()
    while rclpy.ok():
        node.publish()
        due = max(due + period, monotonic())
        while (left := due - monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        node.step()


def main() -> None:
    """Run the node until Ctrl-C."""
    rclpy.init()
    node, executor = MujocoAxis(), EventsExecutor()
    executor.add_node(node)
    try:
        run(node, executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        if rclpy.ok():  # else Ctrl-C came while it published
            raise
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
