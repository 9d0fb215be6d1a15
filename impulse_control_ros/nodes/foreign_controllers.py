"""The controllers that are not ours, as a plant in lockstep discovers them."""

from rclpy.node import Node

from impulse_control_ros.files.topics import IMPULSE_EVENTS, JOINT_COMMANDS


class ForeignControllers:
    """
    The foreign nodes that publish commands for the plant ``node``.

    A controller manager that uses simulated time waits for a period of it before it commands.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._heard: set[bytes] = set()

    def hear(self) -> None:
        """Record that those who are discovered now have commanded."""
        self._heard = self._endpoints()[0]

    @property
    def wait_for_time(self) -> bool:
        """Whether one has never commanded, and no controller of ours could."""
        foreign, ours = self._endpoints()
        return not ours and not foreign <= self._heard

    def _endpoints(self) -> tuple[set[bytes], set[bytes]]:
        """Return the publishers of commands: foreign ones, and ours, which publish events too."""
        find = self._node.get_publishers_info_by_topic
        nodes = {(end.node_namespace, end.node_name) for end in find(IMPULSE_EVENTS)}
        found: tuple[set[bytes], set[bytes]] = set(), set()
        for end in find(JOINT_COMMANDS):
            is_ours = (end.node_namespace, end.node_name) in nodes
            found[is_ours].add(bytes(end.endpoint_gid))
        return found
