"""
Whether a controller answers its plant, or stands by because another one does.

Who stands by listens to the commands of the others. A plant in lockstep publishes a state again
that nobody has answered: who stands by takes over when it comes again and no command is heard. So
does who comes into a run, for the one that answers may not be discovered yet. A plant that
runs freely does not ask: there it is silence over some states. Where several stand by, the one
of the lowest id is the first, the next one waits once more.

Two that answer at a time are told apart by who came later: a process that was stopped for a while
stands by where there is another one, and one that has just begun to answer listens, for the other
may not have been discovered yet. Of two such ones the one of the higher id gives way first.
"""

from time import monotonic

from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from impulse_control_ros.nodes.graph import publishers
from impulse_control_ros.nodes.topics import JOINT_COMMANDS, JOINT_STATES, SERIES_QOS

SILENCE = 1.0  # s of wall time
LOOK_PERIOD = 0.1
SETTLE = 4.0  # s; DDS repeats a lost discovery after 3 s
MARGIN = 10  # commands more than ours that tell of another one


class Standby:
    """
    The controllers besides ``node``, whose publisher of commands has an id among ``own``.

    ``stands_by`` tells whether another one answers, which is never so for one that is to be
    ``alone``; ``patience`` [s] is how long the others wait for a command before they take over.
    """

    def __init__(self, node: Node, own: set[bytes]) -> None:
        self.stands_by, self.alone, self.patience = False, False, SILENCE
        self._node, self._own = node, own
        self._passed: tuple[int, int] | None = None
        self._again, self._passed_at, self._asked_at, self._look_at = 0, 0.0, 0.0, 0.0
        self._silence = 0.0
        self._ear: Subscription | None = None
        self._served_at = self._listens_since = monotonic()
        self._heard = self._sent_before = self._looks = 0
        self._settled_at = 0.0
        self._doubtful = self._said = False

    def passes(self, stamp: tuple[int, int], freely: bool, begins: bool) -> bool:
        """
        Tell whether to pass by a state of a plant that may run ``freely``.

        In lockstep a run ``begins`` with one controller only.
        """
        if self.alone:
            return False
        now = monotonic()
        # a time without states is no silence: there was nothing to answer
        self._silence += min(now - self._passed_at, 0.5 * SILENCE)
        self._passed_at = now
        if stamp != self._passed:
            self._passed, self._asked_at, self._again = stamp, now, 0
        elif now > self._asked_at + 0.5 * self.patience:  # nor is it one that waited here
            self._asked_at = now
            self._again += 1
        if now >= self._look_at or self._again or not self.stands_by:
            self._look_at = now + LOOK_PERIOD
            self._look(now, freely, freely or begins)
        return self.stands_by

    def _look(self, now: float, freely: bool, at_once: bool) -> None:
        others, stood_by = self._others(), self.stands_by
        turn, possible = self._turn(others), bool(others) or not at_once
        if possible:
            ear = self._listen(now, 0)
            if now < self._listens_since + SETTLE and (
                    ear.get_publisher_count() < len(others) + len(self._own)):
                self._silence = 0.0  # it may not be heard yet
        self.stands_by = possible and (
            self._silence < (1 + turn) * SILENCE if freely else self._again <= turn)
        if self.stands_by:
            self._say(others)
            return
        self._listen_no_more()
        self._settled_at = now + SETTLE
        if stood_by:
            self._said = False
            self._node.get_logger().info('no other controller answers: taking over')

    def _turn(self, others: dict[bytes, str]) -> int:
        return sum(number < min(self._own, default=b'') for number in others)

    def _say(self, others: dict[bytes, str]) -> None:
        if not self._said and others and all(others.values()):  # a name is discovered later
            self._said = True
            self._node.get_logger().warning(
                f'{" and ".join(others.values())} is another controller of '
                f'{self._node.resolve_topic_name(JOINT_STATES)}: standing by')

    def _others(self) -> dict[bytes, str]:
        return {number: name for number, name in publishers(self._node, JOINT_COMMANDS).items()
                if number not in self._own}

    def _listen(self, now: float, sent: int) -> Subscription:
        if self._ear is None:
            self._listens_since, self._silence = now, 0.0
            self._heard, self._sent_before, self._looks = 0, sent, 0
            self._ear = self._node.create_subscription(
                JointState, JOINT_COMMANDS, self._hear, SERIES_QOS, raw=True)
        return self._ear

    def _hear(self, _: bytes) -> None:
        self._heard += 1
        self._silence, self._again = 0.0, 0

    def _listen_no_more(self) -> None:
        if self._ear is not None:
            self._node.destroy_subscription(self._ear)
            self._ear = None

    def serve(self) -> None:
        """Take note that the process runs."""
        now = monotonic()
        self._doubtful = self._doubtful or now > self._served_at + self.patience
        self._served_at = now

    def gives_way(self, sent: int) -> bool:
        """Stand by from now on where another one answers; ``sent`` is the number of commands."""
        self.serve()
        doubtful, self._doubtful = self._doubtful, False
        if self.stands_by or self.alone:
            return False
        others = self._others() if doubtful or self._hears_another(sent) else {}
        if others:
            self.stands_by, self._settled_at = True, 0.0
            self._listen_no_more()
            self._say(others)
        return bool(others)

    def _hears_another(self, sent: int) -> bool:
        """Tell whether there are more commands than our own, while we may have come later."""
        now = self._served_at
        if not self._settled_at or now < self._look_at:
            return False
        self._look_at = now + LOOK_PERIOD
        others = self._others()
        if others:
            self._listen(now, sent)
            ours = sent - self._sent_before
            if self._heard > ours + MARGIN:  # our own are heard too
                self._looks += 1
                self._heard, self._sent_before = 0, sent
                return self._looks > (0 if self._turn(others) else 2)
            if ours <= 3 * MARGIN:
                return False  # too few to tell
            self._looks, self._heard, self._sent_before = 0, 0, sent
        if now >= self._settled_at:
            self._settled_at = 0.0
            self._listen_no_more()
        return False
