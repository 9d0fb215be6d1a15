"""
The recorder node: joint_states, joint_commands, impulse_events and more into a rosbag2 folder.

Messages are taken raw, and each costs one append to a list; everything else happens in batches:
order by stamp, drop repeats (the plant publishes a state again when its command is late), look
for gaps in the series, write. What is newer than the last state with a command, and with the
event that this tells of, waits for the next batch, so that the bag is in the order of time.

The recorder joins the lockstep by choice: after each batch it publishes on recorder_progress
the stamp of the last state that it has together with these. The plant waits for it (see
plant_simulator.py), so a slow disk slows simulated time and loses nothing. It opens the bag
when plant and controller are there and their parameters are read; what comes earlier is kept.
Parameters of one that comes anew in mid-run are added, with the stamp of the first state that it
answers. A plant that starts anew begins another run: then the bag is finished, and the next one
is ``<bag>-2``.
"""

from datetime import datetime
from itertools import count
import json
from pathlib import Path
from time import monotonic, sleep
from typing import Any
from uuid import uuid4

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from impulse_control_ros import __version__
from impulse_control_ros.core.tick import nanoseconds, SECOND
from impulse_control_ros.files.bag import (
    BagWriter,
    PACKAGE,
    PARAMETERS,
    require_writable,
    ROLES,
    Topic,
)
from impulse_control_ros.files.columns import BagError
from impulse_control_ros.files.experiment import RecorderParameters
from impulse_control_ros.files.timeline import Taken, Timeline
from impulse_control_ros.nodes.diagnostics import Diagnostics
from impulse_control_ros.nodes.graph import plants, publishers
from impulse_control_ros.nodes.parameters import ParameterNode, PeerParameters
from impulse_control_ros.nodes.spin import main as run_node
from impulse_control_ros.nodes.topics import (
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATES,
    message_class,
    qos_keys,
    RECORDER_PROGRESS,
    SERIES_QOS,
    SLOW_QOS,
    WINDOW,
)
from impulse_control_ros.stop import StopRequest

BATCH = 250
BATCH_PERIOD = 0.02
WATCH_PERIOD = 0.5
FLIGHT = 4.0  # DDS sends again what a reader has missed within 3 s
DEFAULT_STEP_NS = 100_000


class Recorder(ParameterNode):
    """Writes what passes by into a bag, and loses nothing."""

    def __init__(self, **options: Any) -> None:
        super().__init__('recorder', RecorderParameters, **options)
        self._name = self.parameters.bag or f'impulse_{datetime.now():%Y_%m_%d-%H_%M_%S}'
        require_writable(Path(self._name))
        self.bag: BagWriter | None = None
        self._timeline = Timeline(DEFAULT_STEP_NS)
        self._bags = 0
        self._batch_at = self._give_up_at = 0.0
        self._identity = f'{self.get_fully_qualified_name()} {uuid4().hex[:8]}'
        self._peers: set[tuple[str, bytes]] = set()
        self._asking: PeerParameters | None = None
        self._silent: set[str] = set()
        self._told: dict[str, dict[str, Any]] = {}
        self._came: set[str] = set()
        self._newcomers: list[tuple[str, dict[str, Any], int]] = []
        self.inboxes: dict[Subscription, list[Taken]] = {}
        self.taken_directly = self.inboxes.keys()
        self._kinds: dict[Subscription, str] = {}
        self._channels: list[int] = []
        # Events before commands: a peer that has matched our commands has matched our events.
        for topic in (IMPULSE_EVENTS, JOINT_COMMANDS, JOINT_STATES):
            self._subscribe(topic, 'sensor_msgs/msg/JointState', JointState, SERIES_QOS)
        events, commands, states = self.inboxes
        for subscription in (events, commands):
            self.inboxes[subscription] = self.inboxes.pop(subscription)
        self._series = (states, commands)
        self._wanted = {self.resolve_topic_name(topic) for topic in self.parameters.topics} - {
            subscription.topic_name for subscription in self.inboxes}
        self._progress = self.create_publisher(Header, RECORDER_PROGRESS, SLOW_QOS)
        # on the steady clock: simulated time may stand still
        self.create_timer(WATCH_PERIOD, self._watch,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._watch()
        Diagnostics(self, self._covered, self._report)

    # -- endpoints --------------------------------------------------------------------------

    def _subscribe(self, topic: str, kind: str, message: type, qos: QoSProfile) -> Subscription:
        made = self.create_subscription(message, topic, unused, qos, raw=True)
        self.inboxes[made] = []
        self._kinds[made] = kind
        return made

    def take(self) -> None:
        """Take what waits in the subscriptions: no executor does, it would drop the info."""
        # commands before the states that they answer: none is there without its state
        for subscription, inbox in reversed(self.inboxes.items()):
            take = subscription.handle.take_message
            while taken := take(subscription.msg_type, True):
                inbox.append(taken)

    def _watch(self) -> None:
        """Look for topics and peers that have appeared on the graph."""
        self._subscribe_wanted()
        peers = self._present_peers()
        if self.bag and not self._asking and peers - self._peers:
            self._came = {name for name, _ in peers - self._peers}
            self._peers, self._asking = peers, PeerParameters(self)

    def _subscribe_wanted(self) -> None:
        for topic, kinds in self.get_topic_names_and_types() if self._wanted else ():
            if topic not in self._wanted:
                continue
            self._wanted.remove(topic)
            try:
                message = message_class(kinds[0])
            except BagError as error:
                self.get_logger().warning(f'{topic} is not recorded: {error}')
                continue
            offers = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
            best_effort = any(qos.reliability == ReliabilityPolicy.BEST_EFFORT for qos in offers)
            latched = offers and all(
                qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offers)
            qos = QoSProfile(
                depth=SERIES_QOS.depth,
                reliability=ReliabilityPolicy.BEST_EFFORT if best_effort
                else ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched
                else DurabilityPolicy.VOLATILE)
            made = self._subscribe(topic, kinds[0], message, qos)
            if self.bag:
                self._channels.append(self._add_topic(made))

    def _present_peers(self) -> set[tuple[str, bytes]]:
        """Return (node, endpoint) of what publishes states and commands; none when not both."""
        peers = set()
        for subscription in self._series:
            ends = publishers(self, subscription.topic_name)
            if not (subscription.get_publisher_count() and ends and all(ends.values())):
                return set()
            peers |= {(name, number) for number, name in ends.items()}
        return peers

    def _forget_early_states(self) -> None:
        """Keep the newest ones of a plant that runs without a controller: it may do so long."""
        states, commands = (self.inboxes[subscription] for subscription in self._series)
        if not commands:
            del states[:-WINDOW]

    # -- the bag ----------------------------------------------------------------------------

    def _ask_peers(self) -> None:
        """Read the peers' parameters; with them open the bag, or add what is new to it."""
        if not self.bag and not self._asking:
            self._peers, self._asking = self._present_peers(), PeerParameters(self)
        asking = self._asking
        if not asking or not asking.poll({name for name, _ in self._peers}):
            self._asking = asking if self._peers else None
            return
        self._asking = None
        for name in asking.silent:
            if name not in self._silent:
                self.get_logger().warning(f'{name} does not tell its parameters; asking on')
        self._silent |= set(asking.silent)
        self._peers = {peer for peer in self._peers if peer[0] not in asking.silent}
        if not self.bag:
            self._open(asking.values)
            return
        for node, values in asking.values.items():
            if node not in self._told:
                self._add_newcomer(node, values, self._timeline.newest)
            elif node in self._came:
                self._newcomers.append((node, values, self._timeline.newest))
        self._told |= asking.values

    def _add_newcomer(self, node: str, values: dict[str, Any], noticed: int) -> None:
        """Add parameters with the stamp of the newcomer's first command, or when it was seen."""
        stamp = (self._timeline.begun or [noticed]).pop(0)
        self._add_parameters(f'{node}:{stamp}', values)

    def _add_newcomers(self, everything: bool) -> None:
        """Add those of one name with another who have sent a command, as far as that is known."""
        timeline = self._timeline
        while self._newcomers and (timeline.begun or (everything and not timeline.numbered)):
            self._add_newcomer(*self._newcomers.pop(0))
        if everything:
            self._newcomers.clear()

    def _open(self, parameters: dict[str, dict[str, Any]]) -> None:
        names = (self._name if number == 1 else f'{self._name}-{number}'
                 for number in count(self._bags + 1))
        folder = next(name for name in names if not (self._bags and Path(name).exists()))
        self._bags += 1
        self.bag = BagWriter(folder, self.parameters.compression)
        self.bag.add_metadata(PACKAGE, {'version': __version__} | {
            role: subscription.topic_name
            for role, subscription in zip(ROLES, self.inboxes, strict=False)})
        self._told = parameters | {self.get_fully_qualified_name(): self.parameters.flat()}
        for node, values in self._told.items():
            self._add_parameters(node, values)
        known: dict[str, Any] = {}
        for values in parameters.values():
            known |= values
        step = known.get('time_step', 0.0)
        self._timeline = Timeline(nanoseconds(step, 'time_step') if step else DEFAULT_STEP_NS,
                                  known.get('joint_name', ''), lambda: len(plants(self)) < 2,
                                  next(iter(publishers(self, JOINT_COMMANDS).values()), ''))
        self._first_at = self._last_at = 0.0
        self._channels = [self._add_topic(subscription) for subscription in self.inboxes]
        self.get_logger().info(f'recording into {folder}')

    def _add_parameters(self, name: str, values: dict[str, Any]) -> None:
        assert self.bag
        self.bag.add_metadata(f'{PARAMETERS}{name}', {
            key: json.dumps(value) for key, value in values.items()})

    def _add_topic(self, subscription: Subscription) -> int:
        infos = self.get_publishers_info_by_topic(subscription.topic_name)
        assert self.bag
        return self.bag.add_topic(Topic(
            name=subscription.topic_name, type=self._kinds[subscription],
            qos=tuple(qos_keys(info.qos_profile) for info in infos)))

    def _drain(self, everything: bool = False) -> bool:
        """Move the inboxes into the bag; returns False when a new run has begun."""
        assert self.bag
        for index, inbox in enumerate(self.inboxes.values()):
            del inbox[:self._timeline.add(index, inbox, everything)]
        over = self._timeline.over
        entries = self._timeline.take(everything or over)
        if entries:
            self._last_at = monotonic()
            self._first_at = self._first_at or self._last_at
        channels = self._channels
        self.bag.write((stamp, channels[index], raw) for stamp, index, raw in entries)
        self._add_newcomers(everything or over)
        return not over

    def _finish(self) -> None:
        """Finish the bag, and say what is in it."""
        assert self.bag
        missing = self._timeline.missing
        self.bag.close({
            'missing': str(missing),
            'repeated': str(self._timeline.repeated), 'foreign': str(self._timeline.foreign),
            'wall_seconds': f'{self._last_at - self._first_at:.6f}'})
        if self.bag.full:
            self.fail(BagError(f'{self.bag.folder}: {self.bag.full.strerror}: recording ends; the '
                               f'bag is finished with its first {self.bag.count} messages'))
        self.get_logger().info(f'{self.bag.folder}: {self.bag.count} messages written, {missing} '
                               f'missing, {self._timeline.repeated} repeats dropped')
        self.bag = None

    def _in_flight(self) -> bool:
        """Tell whether something is on its way: one state at most is yet to be answered."""
        timeline = self._timeline
        return (bool(timeline.awaited) or timeline.newest > timeline.reached + timeline.step_ns
                or timeline.commanded > timeline.newest)  # whose state may be sent again

    # -- by the wall clock ------------------------------------------------------------------

    def poll(self) -> float:
        """Write a batch when it is due, and tell the plant how far the recording is."""
        self.take()
        now = monotonic()
        if now < self._batch_at and len(self.inboxes[self._series[0]]) < BATCH:
            return BATCH_PERIOD
        self._batch_at = now + BATCH_PERIOD
        self._ask_peers()
        if not self.bag:
            self._forget_early_states()
            return BATCH_PERIOD
        awaited = self._timeline.awaited
        if not self._drain() or self.bag.full:
            self._finish()
        else:
            self._tell_progress()
            if self._timeline.awaited != awaited:
                self._give_up_at = now + FLIGHT
            elif awaited and now > self._give_up_at:
                self._timeline.give_up()
        return BATCH_PERIOD

    def _tell_progress(self) -> None:
        message = Header(frame_id=self._identity)
        message.stamp.sec, message.stamp.nanosec = divmod(self._timeline.reached, SECOND)
        self._progress.publish(message)

    def _covered(self) -> tuple[int, float]:
        taken = self._timeline.taken
        return taken, taken * self._timeline.step_ns / SECOND

    def _report(self, _: float) -> tuple[bytes, str, dict[str, object]]:
        timeline = self._timeline
        return DiagnosticStatus.ERROR if timeline.missing else DiagnosticStatus.OK, (
            f'recording {self.bag.folder}' if self.bag else 'waiting for plant and controller'), {
            'written': self.bag.count if self.bag else 0, 'lost': timeline.missing,
            'repeated': timeline.repeated, 'foreign': timeline.foreign}

    def close(self) -> None:
        """Finish the bag with all that has been sent so far."""
        until = monotonic() + FLIGHT
        self.take()
        while self.bag and self._drain() and self._in_flight() and monotonic() < until:
            sleep(BATCH_PERIOD)
            self.take()
        if not self._bags:
            self.get_logger().warning('nothing recorded: plant and controller were not both there')
        while self.bag:
            same = self._drain(everything=True)
            self._finish()
            if not same:
                self._open(self._told)


def unused(_: bytes) -> None:
    """Be the callback of a subscription that no executor serves."""


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(stop, 'recorder', 'Records the run into a rosbag2 folder (MCAP).',
                    lambda _: [Recorder], 'bag:=NAME')
