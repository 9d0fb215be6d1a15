"""
The recorder node: joint_states, joint_commands, impulse_events and more into a rosbag2 folder.

It takes raw messages in batches; files/sample_joiner.py joins them. After each batch the recorder
publishes on recorder_progress the stamp up to which its samples are complete. The plant waits for
it, so a slow disk slows simulated time but loses nothing. Each run gets its own bag, ``<bag>``,
``<bag>-2`` and so on, once a state and a command of it have arrived.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from itertools import chain, count
import os
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.core.protocol import name_of, new_id, NodeHeader, parse_node, WINDOW
from impulse_control_ros.core.recorder_flow_control import LEAVES
from impulse_control_ros.core.tick import nanoseconds, SECOND, to_stamp
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag import BagWriter, require_writable
from impulse_control_ros.files.cdr import encode_header
from impulse_control_ros.files.experiment import RecorderParameters
from impulse_control_ros.files.run_recording import RunRecording
from impulse_control_ros.files.sample_joiner import PARAMETERS, RecordedPlant, STATES
from impulse_control_ros.files.topics import RECORDER_PROGRESS
from impulse_control_ros.nodes.diagnostics import Diagnostics
from impulse_control_ros.nodes.known_plants import decoded
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.recorded_topics import RecordedTopics, Taken
from impulse_control_ros.nodes.spin import main as run_node
from impulse_control_ros.nodes.topics import Output, SLOW_QOS

BATCH, BATCH_PERIOD = 250, 0.02
EARLY = 20 * WINDOW  # messages; a foreign plant at 1 kHz does not wait for discovery, 10 s at most
WATCH_PERIOD = 0.5
FLIGHT = 6.0  # s to wait for messages in flight at the end; more than files/run_recording.py waits
MOST_RUNS = 10


class Recorder(ParameterNode):
    """Records runs into bags; nodes in this process pass their ``outputs``."""

    def __init__(
        self, outputs: Mapping[str, Sequence[Output]] | None = None, **options: Any
    ) -> None:
        super().__init__('recorder', RecorderParameters, **options)
        bag = os.path.expanduser(self.parameters.bag)
        self._name = bag or f'impulse_{datetime.now():%Y_%m_%d-%H_%M_%S}'
        require_writable(Path(self._name))
        self._id = new_id(self.get_fully_qualified_name())
        self._topics = RecordedTopics(self, self.parameters.topics, outputs or {})
        self.progress = Output(self, Header, RECORDER_PROGRESS, SLOW_QOS)
        self._events: dict[str, dict[str, list[Taken]]] = {}  # the events by run and node
        self._plants: dict[str, Mapping[str, Any]] = {}  # the parameters by run, the newest last
        self._recording: RunRecording | None = None
        self._early: deque[Taken] = deque(maxlen=EARLY)  # before a run is known
        self._bags = 0
        self._batch_at = 0.0
        # on the steady clock, since simulated time may stop
        self.create_timer(
            WATCH_PERIOD, self._topics.find_wanted, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._topics.find_wanted()
        Diagnostics(self, self._covered, self._report)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions except the polled ones, whose times an executor would drop."""
        polled = self._topics.polled if hasattr(self, '_topics') else ()
        return (item for item in super().subscriptions if item not in polled)

    # -- the runs ---------------------------------------------------------------------------

    def _learn(self, taken: Taken) -> None:
        """Keep the parameters of a run, and record it if no other run is recorded."""
        *_, node, values, _ = decoded(taken[1])
        run, name = parse_node(node)
        events = self._events.setdefault(run, {}).setdefault(node, [])
        recording = self._recording if self._recording and run == self._recording.run else None
        if taken[1] not in [known[1] for known in events]:  # a waiting plant repeats them
            if recording:
                recording.joiner.add(*taken)
                events.clear()
            events.append(taken)
        if recording or not describes_plant(values):
            return
        # a plant has no id; for a foreign plant the controller's parameters are used
        if not run or name == name_of(name):
            self._plants.pop(run, None)
            self._plants[run] = values
            if len(self._plants) > MOST_RUNS:
                oldest = next(iter(self._plants))
                del self._plants[oldest], self._events[oldest]
            if self._recording is None:
                self._record(run)
            else:
                self._recording.joiner.other = run

    def _record(self, run: str) -> None:
        """Start to record a run whose parameters are known."""
        values = self._plants[run]
        plant = RecordedPlant(
            run,
            values['joint_name'],
            nanoseconds(values['time_step'], 'time_step'),
            values.get('lockstep', False),
        )
        self._recording = RunRecording(plant, self._make_bag, self._topics.described)
        for taken in (*self._early, *chain(*self._events[run].values())):
            self._recording.joiner.add(*taken)
        self._early.clear()

    def _make_bag(self) -> BagWriter:
        names = (
            self._name if number == 1 else f'{self._name}-{number}'
            for number in count(self._bags + 1)
        )
        folder = next(name for name in names if not (self._bags and Path(name).exists()))
        self._bags += 1
        self.get_logger().info(f'recording into {folder}')
        return BagWriter(folder, self.parameters.compression)

    def _finish(self) -> None:
        """Finish the recording of a run, and log a summary."""
        if self._recording:
            self._tell_progress(LEAVES * SECOND)
            said, bag = self._recording.finish(), self._recording.bag
            if said:
                self.get_logger().info(said)
            if bag and bag.full:
                self.fail(
                    BagError(
                        f'{bag.folder}: {bag.full.strerror}: recording ends; the '
                        f'bag is finished with its first {bag.count} messages'
                    )
                )
        self._recording = None

    # -- by the wall clock ------------------------------------------------------------------

    def _take(self, taken: Taken) -> None:
        if taken[0] == PARAMETERS:
            self._learn(taken)
        elif self._recording:
            self._recording.joiner.add(*taken)
        else:
            self._early.append(taken)

    def poll(self) -> float:
        """Write a batch if it is due, and publish the progress of the recording."""
        taken, now = self._topics.take(), monotonic()
        for one in taken:
            self._take(one)
        recording = self._recording
        if recording and (now >= self._batch_at or len(taken) >= BATCH):
            self._batch_at = now + BATCH_PERIOD
            recording.write()
            recording.look()
            self._tell_progress(recording.joiner.reached)
            if recording.bag and recording.bag.full:
                self._finish()
            elif recording.is_quiet and recording.joiner.other in self._plants:
                self._finish()
                self._record(recording.joiner.other)
        return BATCH_PERIOD

    def _tell_progress(self, reached: int) -> None:
        assert self._recording
        frame_id = NodeHeader(self._recording.run, self._id).frame_id
        self.progress.send(encode_header(*to_stamp(reached), frame_id))

    def _covered(self) -> tuple[int, float]:
        if not self._recording:
            return 0, 0.0
        joiner = self._recording.joiner
        return joiner.counts['states'], joiner.counts['states'] * joiner.plant.step_ns / SECOND

    def _report(self, _: float) -> tuple[bytes, str, dict[str, object]]:
        recording = self._recording
        counts = recording.joiner.counts if recording else {}
        bag = recording.bag if recording else None
        early = sum(channel == STATES for channel, *_ in self._early)
        return (
            DiagnosticStatus.ERROR if counts.get('missing') else DiagnosticStatus.OK,
            (f'recording {bag.folder}' if bag else 'waiting for plant and controller'),
            {
                'received': recording.joiner.heard if recording else early,
                'written': bag.count if bag else 0,
                'lost': counts.get('missing', 0),
                'repeated': counts.get('repeated', 0),
                'foreign': counts.get('foreign', 0),
            },
        )

    def close(self) -> None:
        """Finish the bag with everything sent so far."""
        until = monotonic() + FLIGHT
        self._batch_at = 0.0
        self.poll()
        # a plant that goes on sends more: only what has been answered by now is waited for
        command = self._recording.joiner.newest_command if self._recording else 0
        while self._recording and monotonic() < until:
            self.poll()
            if not (self._recording and self._recording.joiner.in_flight(command)):
                break
            sleep(BATCH_PERIOD)
        self._finish()
        if not self._bags:
            self.get_logger().warning('nothing recorded: no plant, or no controller, was found')


def describes_plant(values: Mapping[str, Any]) -> bool:
    """Return whether parameters have what a recording needs, as other nodes may use the topic."""
    return isinstance(values.get('joint_name'), str) and isinstance(values.get('time_step'), float)


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop,
        'recorder',
        'Records the run into a rosbag2 folder (MCAP).',
        lambda _: [Recorder],
        'bag:=NAME',
    )
