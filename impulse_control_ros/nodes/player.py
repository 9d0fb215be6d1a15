"""
The replay node: publishes the messages of a bag at the pace of their timestamps.

It publishes raw bytes with the QoS of the recorded publishers, and /clock at the same pace. It
does not wait for subscribers: start it with ``--start-paused`` if they need the first message.
The response of ~/pause has the number of subscribers.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.core.parameter import parameter, Parameters
from impulse_control_ros.core.tick import SECOND, to_stamp
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.cdr import encode_time
from impulse_control_ros.files.experiment import cpu_core_parameter
from impulse_control_ros.files.playback import chosen, in_order, Offer, span_of, start_of, surveyed
from impulse_control_ros.files.topics import CLOCK
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.spin import first_line, IDLE, main as run_node
from impulse_control_ros.nodes.topics import deep_qos, message_class, SERIES_QOS

AT_ONCE = 1000  # messages per poll at most


@dataclass(frozen=True, kw_only=True)
class PlayerParameters(Parameters):
    """Parameters of the node ``replay``."""

    rate: float = parameter(1.0, '', 'bag seconds per wall second', lower=0.0, open_lower=True)
    loop: bool = parameter(False, '', 'whether it begins again at the end')
    clock_rate: float = parameter(
        100.0, 'Hz', 'messages on /clock per wall second; 0 for none', lower=0.0, upper=10_000.0
    )
    cpu_core: int = cpu_core_parameter()


class Player(ParameterNode):
    """Publishes the messages of a bag."""

    def __init__(self, options: argparse.Namespace) -> None:
        given = {'rate': options.rate, 'clock_rate': options.clock, 'loop': options.loop or None}
        super().__init__(
            'replay',
            PlayerParameters,
            parameter_overrides=[
                Parameter(name, value=value) for name, value in given.items() if value is not None
            ],
        )
        self._path = options.bag
        found, times, lacks = surveyed(self._path)
        self._outputs: dict[str, Publisher] = {}
        self._make_outputs(chosen(found, options.topics))
        self._time = (
            None if CLOCK in self._outputs else self.create_publisher(Clock, CLOCK, SERIES_QOS)
        )
        self._rate = self.parameters.rate
        self._paused = options.start_paused
        self._published = 0
        self._refused = Counter[str]()
        self._time_at = 0.0
        self._start_ns, self._end_ns = self._span(times, options.start_offset or 0.0)
        for what in lacks:
            self.get_logger().warning(f'{self._path}: {what}')
        self._begin()
        self.create_service(SetBool, '~/pause', self._on_pause)
        self.get_logger().info(
            ('paused: ' if self._paused else '') + f'{options.bag} from '
            f'{self._start_ns / SECOND:.9f} s, {", ".join(self._outputs)}'
        )

    def _make_outputs(self, offers: Mapping[str, Offer]) -> None:
        """Make the publishers; what cannot be published is left out with a warning."""
        reasons = {}
        for name, offer in offers.items():
            try:
                kind = message_class(offer.kind)
                self._outputs[name] = self.create_publisher(kind, name, self._qos(name, offer))
            except (BagError, NameValidationException, RuntimeError) as error:
                reasons[name] = first_line(error)
        if reasons and not self._outputs:
            told = '; '.join(f'{name}: {reason}' for name, reason in reasons.items())
            raise BagError(f'{self._path}: no topic can be published: {told}')
        for name, reason in reasons.items():
            self.get_logger().warning(f'{name} is left out: {reason}')

    def _qos(self, name: str, offer: Offer) -> QoSProfile:
        try:
            return replayed_qos(offer.qos)
        except BagError as error:
            self.get_logger().warning(f'{name}: {error}: reliable and volatile are taken')
            return replayed_qos({})

    def _span(self, times: Mapping[str, Sequence[np.ndarray]], offset: float) -> tuple[int, int]:
        """Return the first and the last log time [ns] of what is published."""
        ours = [part for name in self._outputs for part in times.get(name, ())]
        if not ours:
            raise BagError(
                f'{self._path}: no message on {", ".join(sorted(self._outputs)) or "any topic"}'
            )
        first, last = span_of(ours)
        strange = sum(int(np.count_nonzero((part < first) | (part > last))) for part in ours)
        if strange:
            self.get_logger().warning(
                f'{strange} messages are left out: their log time is no time, or a year or more '
                'from the others'
            )
        return start_of(first, last, offset), last

    def _begin(self) -> None:
        self._messages = in_order(self._path, set(self._outputs), self._start_ns, self._end_ns)
        self._next = next(self._messages, None)
        self._origin, self._anchor = self._start_ns, monotonic()

    # -- time -------------------------------------------------------------------------------

    def _now(self) -> int:
        """Return the current bag time [ns]."""
        if self._paused:
            return self._origin
        passed = (monotonic() - self._anchor) * self._rate * SECOND
        return self._origin + round(min(passed, self._end_ns - self._origin))

    def parameters_changed(self, changed: dict[str, Any]) -> None:
        """Continue from here at the new rate."""
        self._origin, self._anchor = self._now(), monotonic()
        self._rate = self.parameters.rate

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._origin, self._anchor = self._now(), monotonic()
        self._paused = request.data
        response.success = True
        heard = sum(output.get_subscription_count() for output in self._outputs.values())
        response.message = (
            f'{"paused" if request.data else "playing"} at '
            f'{self._origin / SECOND:.9f} s, subscribers: {heard}'
        )
        return response

    def poll(self) -> float:
        """Publish the messages that are due; return the wall time until the next one."""
        if self._paused:
            return IDLE
        now = self._now()
        for _ in range(AT_ONCE):
            if not self._next or self._next[0] > now:
                break
            _, topic, raw = self._next
            self._publish(topic, raw)
            self._next = next(self._messages, None)
        self._tell_time(now)
        if not self._next:
            self._end()
            return 0.0
        return min(max(self._next[0] - self._now(), 0) / SECOND / self._rate, self._until_time())

    def _publish(self, topic: str, raw: bytes) -> None:
        """Publish a message; one that the middleware refuses is left out."""
        try:
            self._outputs[topic].publish(raw)
            self._published += 1
        except _rclpy.RCLError as error:
            self._refused[topic] += 1
            if self._refused[topic] == 1:
                self.get_logger().warning(
                    f'{topic}: a message of {len(raw)} bytes is left out, as others like it: '
                    f'{first_line(error)}'
                )

    def _until_time(self) -> float:
        return min(max(self._time_at - monotonic(), 0.0), IDLE) if self._time else IDLE

    def _tell_time(self, now: int) -> None:
        rate = self.parameters.clock_rate
        if self._time and rate and monotonic() >= self._time_at:
            self._time.publish(encode_time(*to_stamp(now)))
            self._time_at = max(self._time_at + 1.0 / rate, monotonic())

    def _end(self) -> None:
        if self.parameters.loop:
            self._begin()
        else:
            self.finished = True
            refused = self._refused.total()
            self.get_logger().info(
                f'{self._published} messages published'
                + (f', {refused} left out' if refused else '')
            )

    def close(self) -> None:
        """Wait until the sent messages are acknowledged."""
        for output in self._outputs.values():
            output.wait_for_all_acked(Duration(seconds=1))


def replayed_qos(offered: Mapping[str, Any]) -> QoSProfile:
    """Return the reliability and durability of the recorded publisher, with a deep queue."""
    return deep_qos(
        best_effort=offered.get('reliability') in ('best_effort', 2),
        latched=offered.get('durability') in ('transient_local', 1),
    )


def main(
    stop: StopRequest, description: str, add_options: Callable[[argparse.ArgumentParser], None]
) -> int:
    """Play a bag."""
    return run_node(
        stop,
        'replay',
        description,
        lambda options: [partial(Player, options)],
        'rate:=2.0',
        add_options,
    )
