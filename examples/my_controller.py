"""
A PD controller of your own, which imports nothing of impulse_control_ros.

plant_simulator waits for a command with the stamp of its newest state. This node sends one for
each state. Start the plant first, then this file:
ros2 run impulse_control_ros plant_simulator --ros-args -p F_c:=0.0 -p duration:=5.0
"""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState


class MyController(Node):
    """Answers each joint state with the effort u = -K (x - x_r) - D v."""

    def __init__(self) -> None:
        super().__init__('my_controller')
        for name, default in (('K', 10.0), ('D', 2.0), ('x_r', 0.0)):
            self.declare_parameter(name, default)
        self._commands = self.create_publisher(JointState, 'joint_commands', 10)
        self.create_subscription(JointState, 'joint_states', self._on_state, 10)

    def _on_state(self, state: JointState) -> None:
        K, D, x_r = (self.get_parameter(name).value for name in ('K', 'D', 'x_r'))
        command = JointState(name=state.name)
        command.header.stamp = state.header.stamp
        command.effort = [-K * (state.position[0] - x_r) - D * state.velocity[0]]
        self._commands.publish(command)


if __name__ == '__main__':
    rclpy.init()
    try:
        rclpy.spin(MyController())
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()
