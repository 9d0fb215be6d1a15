"""QoS profiles, message classes, and publishers of raw messages."""

from collections.abc import Callable
from importlib import import_module
import re
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from impulse_control_ros.core.tick import to_stamp
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.topics import RUN_PARAMETERS, SERIES_DEPTH, SLOW_DEPTH

UNDISCOVERED = '_NODE_NAME_UNKNOWN_'  # the node of an endpoint that is discovered before it
INTERFACE = re.compile(r'^(\w+)/(msg|srv|action)/(\w+)$')
SERIES_QOS = QoSProfile(depth=SERIES_DEPTH)  # at most one message a sample
SLOW_QOS = QoSProfile(depth=SLOW_DEPTH)
NEWEST_QOS = QoSProfile(depth=1)  # a queue of old efforts would delay the loop
LATCHED_QOS = QoSProfile(depth=SLOW_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# plant and controller resend lost messages; best effort also matches any driver
LOCKSTEP_QOS = QoSProfile(depth=SERIES_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)


def writer_qos(topic: str) -> QoSProfile:
    """Return the QoS that our publisher of a run's topic offers."""
    return LATCHED_QOS if topic == RUN_PARAMETERS else SERIES_QOS


def deep_qos(best_effort: bool, latched: bool) -> QoSProfile:
    """Return a QoS with a deep queue and the two policies that peers must agree on."""
    return QoSProfile(
        depth=SERIES_DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def publishers_of(node: Node, topic: str) -> list[TopicEndpointInfo]:
    """Return the publishers of ``topic`` whose nodes are discovered."""
    found = node.get_publishers_info_by_topic(topic)
    return [one for one in found if one.node_name != UNDISCOVERED]


class Output:
    """A publisher of messages as CDR, optionally with readers in this process."""

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile | None = None) -> None:
        self.publisher = node.create_publisher(kind, topic, qos or writer_qos(topic))
        # publish() without its checks: the data are bytes, and this object keeps the publisher
        # alive
        self.send: Callable[[bytes], None] = self.publisher.handle.publish_raw
        self._readers: list[Callable[[bytes], None]] = []

    def connect(self, reader: Callable[[bytes], None]) -> None:
        """Pass each message to ``reader`` too, after it is published."""
        self._readers.append(reader)
        publish, readers = self.publisher.handle.publish_raw, self._readers

        def send_to_one(raw: bytes) -> None:
            publish(raw)
            reader(raw)

        def send_to_all(raw: bytes) -> None:
            publish(raw)
            for read in readers:
                read(raw)

        self.send = send_to_one if len(readers) == 1 else send_to_all


def qos_keys(qos: QoSProfile) -> dict[str, Any]:
    """Return the nine keys of rosbag2's ``offered_qos_profiles``, version 9."""

    def duration(value: Any) -> dict[str, int]:
        sec, nanosec = to_stamp(value.nanoseconds)
        return {'sec': sec, 'nsec': nanosec}

    return {
        'history': qos.history.short_key,
        'depth': qos.depth,
        'reliability': qos.reliability.short_key,
        'durability': qos.durability.short_key,
        'deadline': duration(qos.deadline),
        'lifespan': duration(qos.lifespan),
        'liveliness': qos.liveliness.short_key,
        'liveliness_lease_duration': duration(qos.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': qos.avoid_ros_namespace_conventions,
    }


def message_class(kind: str) -> type:
    """
    Return the class of a type; raises `BagError` if it is not installed.

    Besides pkg/msg/Name, that is pkg/srv/Name_Event and what belongs to an action, as
    pkg/action/Name_FeedbackMessage.
    """
    try:
        package, folder, name = INTERFACE.findall(kind)[0]
        interface = getattr(import_module(f'{package}.{folder}'), name.partition('_')[0])
        return getattr(import_module(interface.__module__), name)
    except (LookupError, ImportError, AttributeError):
        raise BagError(f'message type {kind!r} is not installed') from None
