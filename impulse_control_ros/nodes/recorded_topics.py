"""The topics that a recorder records: discovered on the graph, and read in batches."""

from collections.abc import Iterable, Mapping, Sequence
from time import time_ns

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag import Topic
from impulse_control_ros.files.topics import DAMPING, FLOAT64, offered_on, SERIES
from impulse_control_ros.nodes.topics import (
    deep_qos,
    message_class,
    Output,
    qos_keys,
    writer_qos,
)

Taken = tuple[int, bytes, int]  # channel, message, publish time [ns]


class RecordedTopics:
    """
    The series and the other ``wanted`` topics of the recorder ``node``.

    The series come from ``outputs`` of nodes in this process, by topic, or else from DDS.
    ``inbox`` has the received messages with their channel in the bag.
    """

    def __init__(
        self, node: Node, wanted: Iterable[str], outputs: Mapping[str, Sequence[Output]]
    ) -> None:
        self.inbox: list[Taken] = []
        self.polled: dict[Subscription, int] = {}
        self._node = node
        self._kinds: dict[str, str] = {}
        self._wanted = {node.resolve_topic_name(topic) for topic in wanted}
        for topic, kind in SERIES.items():
            self._add(topic, kind, outputs.get(topic, ()), writer_qos(topic))
        if node.resolve_topic_name(DAMPING) in self._wanted:  # its type is known
            self._add(DAMPING, FLOAT64, outputs.get(DAMPING, ()), writer_qos(DAMPING))
        self._in_process = len(self._kinds) if outputs else 0

    def _add(self, topic: str, kind: str, outputs: Sequence[Output], qos: QoSProfile) -> None:
        name, channel = self._node.resolve_topic_name(topic), len(self._kinds) + 1
        self._wanted.discard(name)
        if not outputs:
            made = self._node.create_subscription(
                message_class(kind), topic, unused, qos, raw=True
            )
            self.polled[made] = channel
        self._kinds[name] = kind
        append = self.inbox.append
        for output in outputs:
            output.connect(lambda raw: append((channel, raw, time_ns())))

    def find_wanted(self) -> None:
        """Subscribe to the wanted topics that have appeared on the graph."""
        for topic, kinds in self._node.get_topic_names_and_types() if self._wanted else ():
            if topic not in self._wanted:
                continue
            offers = [info.qos_profile for info in self._node.get_publishers_info_by_topic(topic)]
            best_effort = any(qos.reliability == ReliabilityPolicy.BEST_EFFORT for qos in offers)
            latched = bool(offers) and all(
                qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offers
            )
            try:
                self._add(topic, kinds[0], (), deep_qos(best_effort, latched))
            except BagError as error:
                self._wanted.discard(topic)
                self._node.get_logger().warning(f'{topic} is not recorded: {error}')

    def take(self) -> list[Taken]:
        """Return the messages since the last call, in order for each topic."""
        for subscription, channel in self.polled.items():
            take = subscription.handle.take_message
            while taken := take(subscription.msg_type, True):
                self.inbox.append((channel, taken[0], taken[1]['source_timestamp']))
        taken, self.inbox[:] = self.inbox[:], []
        return taken

    def described(self, first: int) -> list[Topic]:
        """Return the topics from number ``first`` on, as a bag describes them."""
        return [
            Topic(
                name=name,
                type=kind,
                qos=tuple(
                    [offered_on(name.rsplit('/', 1)[-1])]
                    if number < self._in_process
                    else (
                        qos_keys(info.qos_profile)
                        for info in self._node.get_publishers_info_by_topic(name)
                    )
                ),
            )
            for number, (name, kind) in enumerate(self._kinds.items())
            if number >= first
        ]


def unused(_: bytes) -> None:
    """Do nothing: the callback of a subscription that no executor serves."""
