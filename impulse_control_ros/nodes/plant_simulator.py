"""
The plant simulator node: the axis in simulated time, closed over topics.

Lockstep (the default): state k is published, and sample k + 1 is made only after the command
that carries the stamp of state k; so a run is a function of its parameters alone. What can hold
the next sample, in this order: the command, a pause, a recorder that is behind, and the real
time factor. Free running: samples are made by the wall clock with the last command held; one of
stamp 0 answers no state and acts at once.
"""

import math
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from impulse_control_ros.core.axis import DIVERGED, DivergedError
from impulse_control_ros.core.tick import nanoseconds, stamp, ticks
from impulse_control_ros.files.cdr import (
    COMMANDED,
    encode_float64,
    encode_time,
    RESET_MARK,
    WITHOUT_VELOCITY,
)
from impulse_control_ros.files.experiment import PlantParameters
from impulse_control_ros.nodes.diagnostics import Diagnostics
from impulse_control_ros.nodes.graph import own_publisher, publishers
from impulse_control_ros.nodes.meeting import Meeting
from impulse_control_ros.nodes.pace import Pace
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.recorders import ENDLESS, Recorders
from impulse_control_ros.nodes.simulated_axis import SimulatedAxis
from impulse_control_ros.nodes.simulation_control import SimulationControl
from impulse_control_ros.nodes.simulation_interfaces import SimulationInterfaces
from impulse_control_ros.nodes.spin import IDLE, main as run_node
from impulse_control_ros.nodes.topics import (
    CLOCK,
    command_layouts,
    DAMPING,
    decode_any,
    JOINT_COMMANDS,
    JOINT_STATES,
    SERIES_QOS,
    state_layout,
    UnreadableError,
)
from impulse_control_ros.stop import StopRequest

HANDSHAKE = 0.1


class PlantSimulator(ParameterNode):
    """Publishes the axis' state at every sample of simulated time."""

    def __init__(self, **options: Any) -> None:
        super().__init__('plant_simulator', PlantParameters, **options)
        parameters = self.parameters
        self._step_ns = nanoseconds(parameters.time_step, 'time_step')
        self._start_ns = nanoseconds(parameters.start_time, 'start_time')
        joint, logger = parameters.joint_name, self.get_logger()
        self._layouts = {mark: state_layout(joint, logger, mark) for mark in ('', RESET_MARK)}
        self._layouts_without_velocity = {
            mark: state_layout(joint, logger, mark, WITHOUT_VELOCITY) for mark in self._layouts}
        self._command_layouts = command_layouts(joint, logger)
        self._lockstep = parameters.lockstep
        self.tick = -1
        self._axis = SimulatedAxis(parameters)
        self._stamp = self._answered = (-1, 0)
        self._message = b''
        self._awaiting = False
        self._effort = 0.0
        self.paused = False
        self.quitting = False
        self._steps_left = 0
        self._reset_wanted = False
        self._asked_at = monotonic()
        self._pace = Pace()
        self._recorders = Recorders(
            self, lambda: self.tick, lambda stamp_ns: (stamp_ns - self._start_ns) // self._step_ns,
            self._lockstep)
        self._counts = {'accepted': 0, 'late': 0, 'stale': 0, 'foreign': 0, 'rejected': 0}
        self.parameters_changed()
        self._create_endpoints()

    def _create_endpoints(self) -> None:
        self._states, own = own_publisher(self, JointState, JOINT_STATES, SERIES_QOS)
        # publish() without its checks: these are bytes, and the publisher lives as long as we do
        self._publish_message = self._states.handle.publish_raw
        self._clock_topic = self.create_publisher(Clock, CLOCK, SERIES_QOS)
        self._damping = self.create_publisher(Float64, DAMPING, SERIES_QOS)
        self.commands = self.create_subscription(
            JointState, JOINT_COMMANDS, self.on_command, SERIES_QOS, raw=True)
        self._meeting = Meeting(self, own, self._states, self.commands, self._recorders)
        SimulationControl(self)
        SimulationInterfaces(self)
        Diagnostics(self, self._progress, self._report)
        self._accepted_before = 0
        self._known_troubles: set[str] = set()
        self._began = self._moving_since = 0.0

    def parameters_changed(self) -> None:
        """Let the next sample be made with the new parameters."""
        parameters = self.parameters
        self._axis.change(parameters)
        self._last_tick = (ticks(parameters.duration, parameters.time_step)
                           if parameters.duration else ENDLESS)
        self._clock_every = self._every(parameters.clock_rate)
        varying = parameters.damping.kind != 'constant'
        self._damping_every = self._every(parameters.damping_rate) if varying else 0
        self._pace.wall_step = (parameters.time_step / parameters.real_time_factor
                                if parameters.real_time_factor else 0.0)
        self._pace.restart(self.tick)

    def _every(self, rate: float) -> int:
        """Return the number of samples between messages at ``rate`` [Hz]; 0 for none."""
        return max(1, round(1.0 / (rate * self.parameters.time_step))) if rate else 0

    # -- the sample -------------------------------------------------------------------------

    def _step(self) -> None:
        self._axis.step(self._effort)
        self._publish_sample()

    def _reset_state(self) -> None:
        self._reset_wanted = False
        self._axis.reset()
        self._effort = 0.0
        self._publish_sample(RESET_MARK)

    def _publish_sample(self, mark: str = '') -> None:
        tick, position, velocity, effort, damping, _ = self._axis.state()
        if not abs(position) < DIVERGED > abs(velocity):
            self.fail(DivergedError(position, velocity, self.seconds(1)))
            return
        self.tick = tick
        self._stamp = sec, nanosec = stamp(tick, self._start_ns, self._step_ns)
        self._message = self._encoded(mark, *self._axis.measured(), effort)
        self._awaiting = self._lockstep
        self._publish_state()
        if self._clock_every and tick % self._clock_every == 0:
            self._clock_topic.publish(encode_time(sec, nanosec))
        if self._damping_every and tick % self._damping_every == 0 and tick:
            self._damping.publish(encode_float64(damping))

    def _encoded(self, mark: str, position: float, velocity: float, effort: float) -> bytes:
        """Return the state as CDR; a velocity that is not measured is an empty field."""
        if math.isnan(velocity):
            return self._layouts_without_velocity[mark].encode(*self._stamp, position, effort)
        return self._layouts[mark].encode(*self._stamp, position, velocity, effort)

    def _publish_state(self) -> None:
        self._asked_at = monotonic()
        self._publish_message(self._message)

    # -- what comes in ----------------------------------------------------------------------

    def on_command(self, raw: bytes) -> None:
        """Take one joint command, given as CDR."""
        for layout in self._command_layouts:
            values = layout.decode(raw)
            if values is not None:
                sec, nanosec, effort = values
                break
        else:
            try:
                sec, nanosec, _, effort = decode_any(raw, self.parameters.joint_name, COMMANDED)
            except UnreadableError as error:
                self._reject(f'a command {error}')
                return
        if self.tick <= 0 and (sec, nanosec) not in ((0, 0), self._stamp):
            self._meeting.hear()
        if not math.isfinite(effort):
            self._reject(f'a command with effort {effort}')
        elif (sec, nanosec) == (0, 0) and self.tick >= 0 and not self._lockstep:
            self._effort = effort
        elif (sec, nanosec) > self._stamp:
            self._counts['foreign'] += 1
        elif (sec, nanosec) <= self._answered or (
                self._lockstep and (sec, nanosec) < self._stamp):
            self._counts['stale'] += 1
        else:
            self._answered = (sec, nanosec)
            self._counts['accepted'] += 1
            self._awaiting = False
            self._effort = effort
            if self._lockstep:
                self._proceed()
            elif (sec, nanosec) < self._stamp:
                self._counts['late'] += 1

    def _reject(self, what: str) -> None:
        self._counts['rejected'] += 1
        self.get_logger().error(f'rejected {what}', throttle_duration_sec=5.0)

    # -- what holds the next sample ---------------------------------------------------------

    def _proceed(self) -> None:
        """Make the next sample unless something holds it."""
        if self._awaiting or self.finished or self.tick >= self._recorders.limit:
            return
        if self.tick >= self._last_tick or self.quitting:
            if self._recorders.have(self.tick):
                self._end()
        elif self._reset_wanted:
            self._reset_state()
        elif self._may_step():
            self._step()

    def _may_step(self) -> bool:
        """Ask pause and pace, and account for the step when both agree."""
        if self.paused and not self._steps_left:
            return False
        if self._pace.wall_step and not self._steps_left:
            now = monotonic()
            if now < self._pace.due(self.tick):
                return False
            self._pace.made(self.tick, now)
        self._steps_left = max(0, self._steps_left - 1)
        return True

    def poll(self) -> float:
        """Do what is due by the wall clock: start, publish again, pace."""
        now = monotonic()
        if self._awaiting and now < self._asked_at + self.parameters.command_timeout:
            return IDLE
        if self.tick < 0:
            return self._start_when_matched(now)
        if self.quitting and self._awaiting:  # nobody may be there to send what is late
            self._end()
        tick = self.tick
        if not self._awaiting:
            self._proceed()
        if self.finished or self.tick > tick:
            return 0.0
        if self._lockstep and now >= self._asked_at + self._patience():
            self._ask_again(now)
        if self._pace.wall_step and not (self._awaiting or self.paused):
            return min(max(self._pace.due(self.tick) - monotonic(), 0.0), IDLE)
        return min(self._patience(), IDLE)

    def _patience(self) -> float:
        """Return the wall time [s] after which the state is published again."""
        return (HANDSHAKE if self._recorders.handshaking and not self._awaiting
                else self.parameters.command_timeout)

    def _start_when_matched(self, now: float) -> float:
        if not self._meeting.complete(now, self.parameters.wait_for_recorder):
            return 0.02
        self._began = self._moving_since = now
        self._axis.start()
        self._pace.restart(0)
        self._publish_sample(RESET_MARK)
        self.get_logger().info(f'running from {self.seconds()} s')
        return 0.0

    def _ask_again(self, now: float) -> None:
        """Publish the state once more: its command is late, or an endpoint may be new."""
        self._asked_at = now
        if self._awaiting and self.tick == 0 and self._meeting.overhears(now):
            self._wait_for_another()
            return
        if self._awaiting:
            self._counts['late'] += 1
            self.get_logger().warning(
                f'no command for the state at {self.seconds()} s: published again',
                throttle_duration_sec=5.0)
            self._recorders.shake_hands()
        elif self._recorders:
            self._recorders.forget_lost()
        if self._awaiting or self._recorders.handshaking:
            self._publish_state()

    def _wait_for_another(self) -> None:
        """Go back before the first state: it was made before another plant was discovered."""
        self.tick, self._stamp, self._awaiting = -1, (-1, 0), False
        self.get_logger().warning(
            f'{self.commands.topic_name} answers another plant: waiting for it to leave')

    def _end(self) -> None:
        self.finished = True
        self._say_how_it_went('the run is over')

    def _say_how_it_went(self, what: str) -> None:
        wall = monotonic() - self._began
        simulated = self.tick * self.parameters.time_step
        counts = ', '.join(f'{value} {name}' for name, value in (
            {'steps': self.tick} | self._counts
            | {'lost': self._lost(), 'missed deadlines': self._pace.missed}
        ).items())
        self.get_logger().info(
            f'{what} at {self.seconds()} s: {simulated:g} s in {wall:.3f} s of wall '
            f'time ({simulated / max(wall, 1e-9):.2f} times real time); {counts}')

    # -- services and reports ---------------------------------------------------------------

    def seconds(self, ahead: int = 0) -> str:
        """Return the stamp of the state ``ahead`` samples from the present one, in seconds."""
        sec, nanosec = stamp(max(0, self.tick + ahead), self._start_ns, self._step_ns)
        return f'{sec}.{nanosec:09d}'

    def reset(self) -> bool:
        """Let the next state be the start; False where there is no next state."""
        self._reset_wanted = 0 <= self.tick < self._last_tick
        return self._reset_wanted

    def pause(self, paused: bool) -> None:
        """Hold the next sample, or go on."""
        self.paused, self._steps_left = paused, 0
        self._moving_since = math.inf if paused else monotonic()
        self._pace.restart(self.tick)

    def step(self, samples: int) -> bool:
        """Make so many samples more while paused; False where it is not."""
        if self.paused:
            self._steps_left += samples
        return self.paused

    def quit(self) -> None:
        """Let the run end at the present state; at once where there is none yet."""
        self.quitting = True
        self.finished = self.tick < 0

    def _lost(self) -> int:
        """Return the number of states, but the present one, that no command has answered."""
        return max(0, self.tick - self._counts['accepted'])

    def _progress(self) -> tuple[int, float]:
        return self.tick, self.tick * self.parameters.time_step

    def _report(self, rate: float) -> tuple[bytes, str, dict[str, object]]:
        troubles = self._troubles(rate)
        for name in troubles.keys() - self._known_troubles:
            self.get_logger().warning(troubles[name])
        self._known_troubles = set(troubles)
        held = [name for name, holds in (
            ('a command', self._awaiting), ('resume', self.paused),
            ('a recorder', self.tick >= self._recorders.limit)) if holds]
        message = 'running' if rate else 'waiting for ' + (' and '.join(held) or 'peers')
        level = DiagnosticStatus.OK if rate and not troubles else DiagnosticStatus.WARN
        return level, '; '.join((message, *troubles.values())), {
            'recorders': len(self._recorders), 'missed_deadlines': self._pace.missed,
            **self._pace.report(), **self._counts, 'lost': self._lost()}

    def _troubles(self, rate: float) -> dict[str, str]:
        """Say what is wrong with a run of ``rate`` samples per wall second, by its name."""
        controllers, factor = self.commands.get_publisher_count(), rate * self.parameters.time_step
        names = publishers(self, JOINT_COMMANDS).values() if controllers > 1 else ()
        accepted, self._accepted_before = self._accepted_before, self._counts['accepted']
        wanted = self.parameters.real_time_factor
        return {name: text for name, is_so, text in (
            ('unheard', not self._lockstep and rate > 0 and self._accepted_before == accepted,
             f'no command for a second at {self.seconds()} s: {self._effort:g} N is held'),
            ('controllers', controllers > 1,
             f'{controllers} controllers publish {self.commands.topic_name}: of the commands of '
             f'{" and ".join(names)} for a state the first acts'),
            ('slow', 0.0 < factor < 0.9 * wanted and monotonic() > self._moving_since + 2.0,
             f'{factor:.2f} times real time is less than real_time_factor = {wanted:g}')) if is_so}

    def close(self) -> None:
        """Wait until what was sent has arrived."""
        if not self.finished and self.tick >= 0:
            self._say_how_it_went('stopped')
        self._states.wait_for_all_acked(Duration(seconds=1))
        self._clock_topic.wait_for_all_acked(Duration(seconds=1))


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop, 'plant_simulator',
        'The axis in simulated time: joint_states out, joint_commands in.',
        lambda _: [PlantSimulator], 'F_c:=0.5')
