"""Who is at the other end of a topic, as far as the graph tells."""

from collections.abc import Iterable

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impulse_control_ros.nodes.topics import JOINT_STATES, RECORDER_PROGRESS

NAME_UNKNOWN = '_NODE_NAME_UNKNOWN_'  # rmw's, of an endpoint whose node is not yet discovered


def full_name(end: TopicEndpointInfo) -> str:
    """Return the full name of an endpoint's node, '' while it is unknown."""
    if end.node_name == NAME_UNKNOWN:
        return ''
    return f'{end.node_namespace.rstrip("/")}/{end.node_name}'


def publishers(node: Node, topic: str) -> list[str]:
    """Return the nodes that publish a topic, one entry a publisher."""
    return names(node.get_publishers_info_by_topic(topic))


def publisher_ids(node: Node, topic: str) -> set[bytes]:
    """Return the ids of the publishers of a topic."""
    return {bytes(end.endpoint_gid) for end in node.get_publishers_info_by_topic(topic)}


def subscribers(node: Node, topic: str) -> list[str]:
    """Return the nodes that subscribe to a topic, one entry a subscription."""
    return names(node.get_subscriptions_info_by_topic(topic))


def plants(node: Node) -> set[bytes]:
    """Return the ids of what publishes our states and is a plant: its node hears of recorders."""
    hearing = set(subscribers(node, RECORDER_PROGRESS)) - {''}
    return {bytes(end.endpoint_gid) for end in node.get_publishers_info_by_topic(JOINT_STATES)
            if full_name(end) in hearing}


def names(ends: Iterable[TopicEndpointInfo]) -> list[str]:
    """Return the full names of the nodes of endpoints."""
    return [full_name(end) for end in ends]
