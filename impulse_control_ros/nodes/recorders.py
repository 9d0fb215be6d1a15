"""
The plant's view of the recorders: how far each is, and so how far simulated time may go.

A recorder joins the lockstep by itself: it publishes on recorder_progress the stamp up to which
it has states and commands (frame_id: its name, a space, and what no other has). The plant stays
at most WINDOW samples ahead of the slowest, and after a handshake was asked for (an endpoint may
be new) it goes on only when every recorder has the present state and its command. That is flow
control over ordinary topics: DDS alone would drop (keep last) or fail the publish (keep all), and
tell the sender neither.
"""

from collections import Counter
from collections.abc import Callable

from rclpy.node import Node
from std_msgs.msg import Header

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.nodes.graph import publishers, subscribers
from impulse_control_ros.nodes.topics import JOINT_STATES, RECORDER_PROGRESS, SLOW_QOS, WINDOW

ENDLESS = 2**62


class Recorders:
    """
    The joined recorders of a plant; samples may be made while the tick is below ``limit``.

    ``tick`` returns the plant's present tick and ``tick_at`` the tick of a stamp in ns. Without
    ``lockstep`` they are known, but hold nothing.
    """

    def __init__(self, node: Node, tick: Callable[[], int], tick_at: Callable[[int], int],
                 lockstep: bool) -> None:
        self.limit = ENDLESS
        self._lockstep = lockstep
        self.handshaking = False
        self._node, self._tick, self._tick_at = node, tick, tick_at
        self._reached: dict[str, int] = {}
        node.create_subscription(Header, RECORDER_PROGRESS, self._on_progress, SLOW_QOS)

    def __len__(self) -> int:
        return len(self._reached)

    def have(self, tick: int) -> bool:
        """Tell whether every recorder has the state at ``tick`` and its command."""
        return not self._lockstep or min(self._reached.values(), default=ENDLESS) >= tick

    def shake_hands(self) -> None:
        """Hold the plant until every recorder has the present state and its command."""
        self.handshaking = bool(self._reached)
        self._update()

    def forget_lost(self) -> None:
        """Drop those that have left the graph; of one name those that were silent longest."""
        alive = publishers(self._node, RECORDER_PROGRESS).values()
        if '' in alive:
            return
        left = Counter(map(name_of, self._reached))
        left.subtract(alive)
        for recorder in list(self._reached):  # in the order of when each was last heard
            name = name_of(recorder)
            if left[name] > 0:
                left[name] -= 1
                del self._reached[recorder]
                self._node.get_logger().warning(
                    f'recorder {name} has left: the run goes on without it')
        self._update()

    def _on_progress(self, message: Header) -> None:
        recorder, tick = message.frame_id, self._tick_at(
            message.stamp.sec * SECOND + message.stamp.nanosec)
        if recorder not in self._reached:
            if name_of(recorder) not in subscribers(self._node, JOINT_STATES):
                return  # of another plant's states, or not yet discovered: it comes again
            self._node.get_logger().info(f'recorder {name_of(recorder)} joined the lockstep')
        self._reached.pop(recorder, None)
        # A stamp ahead of ours is of an earlier run, and 0 of a recorder that starts anew.
        self._reached[recorder] = tick if 0 <= tick <= self._tick() else -1
        self.handshaking = self.handshaking or self._reached[recorder] < 0
        self._update()

    def _update(self) -> None:
        if self.handshaking and self.have(max(0, self._tick())):
            self.handshaking = False
        if self._lockstep:
            slowest = min(self._reached.values(), default=ENDLESS)
            self.limit = slowest if self.handshaking else slowest + WINDOW


def name_of(recorder: str) -> str:
    """Return the full name of a recorder's node."""
    return recorder.split(' ')[0]
