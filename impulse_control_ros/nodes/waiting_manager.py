"""A controller manager that waits for the time of a plant in lockstep."""

from rclpy.node import Node

from impulse_control_ros.files.topics import CLOCK, IMPULSE_EVENTS, JOINT_COMMANDS
from impulse_control_ros.nodes.topics import publishers_of


def waits_for_time(plant: Node) -> bool:
    """
    Return whether a foreign node may command ``plant`` once time passes, and none of ours may.

    A manager that uses simulated time waits for a period of it before its first command, and
    after a command that was lost. It reads /clock; a controller of ours also publishes events.
    """
    if not plant.count_subscribers(CLOCK):
        return False
    commanders, ours = (
        {(end.node_namespace, end.node_name) for end in publishers_of(plant, topic)}
        for topic in (JOINT_COMMANDS, IMPULSE_EVENTS)
    )
    return bool(commanders) and not commanders & ours
