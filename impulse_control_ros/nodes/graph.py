"""Who is at the other end of a topic, as far as the graph tells."""

from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impulse_control_ros.nodes.topics import JOINT_STATES, RECORDER_PROGRESS

NAME_UNKNOWN = '_NODE_NAME_UNKNOWN_'  # rmw's, of an endpoint whose node is not yet discovered


def full_name(end: TopicEndpointInfo) -> str:
    """Return the full name of an endpoint's node, '' while it is unknown."""
    if end.node_name == NAME_UNKNOWN:
        return ''
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'


def publishers(node: Node, topic: str) -> dict[bytes, str]:
    """Return the nodes that publish a topic, by the id of the publisher."""
    return {bytes(end.endpoint_gid): full_name(end)
            for end in node.get_publishers_info_by_topic(topic)}


def own_publisher(node: Node, kind: type[Any], topic: str, qos: QoSProfile,
                  ) -> tuple[Publisher, set[bytes]]:
    """Create a publisher; returns it and its id, which rclpy does not tell."""
    while True:
        others = publishers(node, topic).keys()
        publisher = node.create_publisher(kind, topic, qos)
        own = publishers(node, topic).keys() - others
        if len(own) < 2:
            return publisher, own
        # another's was discovered in between: which is ours?
        node.destroy_publisher(publisher)


def subscribers(node: Node, topic: str) -> set[str]:
    """Return the nodes that subscribe to a topic."""
    return {full_name(end) for end in node.get_subscriptions_info_by_topic(topic)}


def plants(node: Node) -> set[bytes]:
    """Return the ids of what publishes our states and is a plant: its node hears of recorders."""
    hearing = subscribers(node, RECORDER_PROGRESS) - {''}
    return {number for number, name in publishers(node, JOINT_STATES).items() if name in hearing}
