"""
The plant simulator node: the axis in simulated time, controlled over topics.

Lockstep (the default): the plant publishes state k, and makes sample k + 1 only after the command
with the stamp of state k, so a run depends only on its parameters. Four things can hold the next
sample, in this order: a missing command, a slow recorder, a pause, and the real time factor. Free
running: the plant makes samples by the wall clock and holds the last command. A state is
republished while the next one is held, so a lost message costs little and joining peers see the
state. core/protocol.py has the rules.
"""

import math
from time import monotonic, time_ns
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.core.age import AgeLimit
from impulse_control_ros.core.command_arbiter import CommandArbiter, SOON
from impulse_control_ros.core.plant import DIVERGED
from impulse_control_ros.core.protocol import (
    CommandHeader,
    FOREIGN,
    name_of,
    new_run,
    parse_command,
    parse_node,
    Verdict,
)
from impulse_control_ros.core.recorder_flow_control import RecorderFlowControl
from impulse_control_ros.core.simulated_plant import SimulatedPlant
from impulse_control_ros.core.tick import nanoseconds, SampleClock
from impulse_control_ros.core.wall_clock_pacer import WallClockPacer
from impulse_control_ros.errors import DivergedError, UnreadableError
from impulse_control_ros.files.cdr import COMMANDED, read_header
from impulse_control_ros.files.experiment import PlantParameters
from impulse_control_ros.files.topics import JOINT_COMMANDS, RECORDER_PROGRESS
from impulse_control_ros.nodes.joint_state_io import JointStateReader
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.plant_outputs import PlantOutputs
from impulse_control_ros.nodes.plant_report import PlantReport
from impulse_control_ros.nodes.simulation_control import SimulationControl
from impulse_control_ros.nodes.simulation_interfaces import SimulationInterfaces
from impulse_control_ros.nodes.spin import IDLE, main as run_node
from impulse_control_ros.nodes.topics import LOCKSTEP_QOS, SERIES_QOS, SLOW_QOS
from impulse_control_ros.nodes.waiting_manager import waits_for_time

ANNOUNCE = 1.0  # s between announcements of a waiting plant: a recorder may have been busy
HEARTBEAT = 0.25  # s between repeats of a state held only by the wall clock or a pause


class PlantSimulator(ParameterNode):
    """Publishes the state at every sample; if ``composed``, it does not read commands from DDS."""

    def __init__(self, composed: bool = False, **options: Any) -> None:
        super().__init__('plant_simulator', PlantParameters, **options)
        parameters = self.parameters
        self.run = new_run()
        self.clock = SampleClock(
            parameters.start_ns(time_ns()), nanoseconds(parameters.time_step, 'time_step')
        )
        self.axis = SimulatedPlant(parameters)
        self.outputs = PlantOutputs(self, parameters.joint_name)
        self.arbiter = CommandArbiter(self.run, parameters.lockstep, monotonic())
        self.recorders = RecorderFlowControl(self.clock, parameters.lockstep)
        self._read = JointStateReader(parameters.joint_name, parse_command, COMMANDED).read
        self.pacer = WallClockPacer()
        self.control = SimulationControl(self)
        self._announced = False
        self._published_at = -math.inf
        self._last_tick = parameters.last_tick
        self._report = PlantReport(self)
        SimulationInterfaces(self)
        self.parameters_changed({})
        if not composed:
            # without lockstep a lost command, such as the final 0 N, is not sent again
            qos = LOCKSTEP_QOS if parameters.lockstep else SERIES_QOS
            self.create_subscription(JointState, JOINT_COMMANDS, self.on_command, qos, raw=True)
        self.create_subscription(Header, RECORDER_PROGRESS, self.on_progress, SLOW_QOS, raw=True)

    def parameters_changed(self, changed: dict[str, Any]) -> None:
        """Publish the new parameters, and use them from the next sample on."""
        parameters = self.parameters
        self.axis.change(parameters)
        self.outputs.change(parameters)
        self.arbiter.age = AgeLimit(parameters.max_age)
        self._last_tick = parameters.last_tick
        self.pacer.wall_step = parameters.wall_step
        self.pacer.restart(self.clock.tick, monotonic())
        if parameters.max_age and parameters.lockstep:
            self.get_logger().info('max_age has no effect in lockstep', once=True)
        if self._announced:
            self._tell_parameters(changed)

    def _tell_parameters(self, changed: dict[str, Any]) -> None:
        self._announced = True
        self.outputs.tell_parameters(self.run, self.clock.stamp, self.parameters.flat(), changed)

    # -- the sample -------------------------------------------------------------------------

    def _start(self, now: float) -> float:
        """Publish the first state, unless a recorder is waited for or a pause holds it."""
        waits = self.parameters.wait_for_recorder and not self.recorders
        if not self._announced or (waits and now >= self._published_at + ANNOUNCE):
            self._published_at = now
            self._tell_parameters({})
        if waits or self.control.holds:
            missing = 'a recorder' if waits else 'the call of ~/pause that resumes, or of ~/step'
            self._report.waiting_for(missing, now)
            return 0.02
        start_ns = self.parameters.start_ns(time_ns())
        if start_ns != self.clock.start_ns:
            self.clock.start_at(start_ns)
            self._tell_parameters({})
        self.axis.start()
        self.pacer.restart(0, now)
        self._report.begin(now)
        self._publish_sample()
        return 0.0

    def _step(self) -> None:
        if self.control.reset_wanted:
            self.control.reset_wanted = False
            self.axis.reset()
            self.arbiter.reset()
        else:
            self.axis.step(self.arbiter.effort)
        self._publish_sample()

    def _publish_sample(self) -> None:
        tick, position, velocity, effort, damping, _ = self.axis.state()
        if not abs(position) < DIVERGED > abs(velocity):
            self.fail(DivergedError(position, velocity, self.clock.seconds(1)))
            return
        self.clock.go_to(tick)
        stamp, self._published_at = self.clock.stamp, monotonic()
        self.arbiter.expect(stamp, self._published_at)
        self.outputs.send_state(self.arbiter.header, stamp, *self.axis.measured(), effort)
        self.outputs.send_throttled(self._published_at)
        self.outputs.send_beside(tick, stamp, damping)

    def on_command(self, raw: bytes) -> None:
        """Handle one joint command, given as CDR."""
        try:
            sender, (sec, nanosec, effort) = self._read(raw)
            if not -math.inf < effort < math.inf:
                effort = self._without_effort(sender, effort)
        except UnreadableError as error:
            self._report.reject(error)
            return
        before = self.arbiter.header.controller
        verdict = self.arbiter.take(sender, (sec, nanosec), effort, monotonic())
        if verdict is Verdict.OLD:
            self._report.too_old(self.arbiter.age)
        if verdict is not Verdict.ACTS:
            return
        if sender.author != before:
            self.recorders.hold()
            self.get_logger().info(f'the active controller is {name_of(sender.author)}')
        if self.parameters.lockstep:
            self._proceed()

    def _without_effort(self, sender: CommandHeader, effort: float) -> float:
        """Return the effort that a manager without an active controller answers with, or raise."""
        is_normal = sender.author == FOREIGN and math.isnan(effort)
        if not (is_normal and self.parameters.lockstep):
            raise UnreadableError(f'effort {effort}', is_normal=is_normal)
        return self.arbiter.effort

    def on_progress(self, raw: bytes) -> None:
        """Handle the progress of a recorder, given as CDR."""
        stamp_ns, frame_id = read_header(raw)
        run, recorder = parse_node(frame_id.decode(errors='replace'))
        news = (
            recorder and run == self.run and self.recorders.take(recorder, stamp_ns, monotonic())
        )
        if news:
            self.get_logger().info(f'recorder {recorder} {news}')

    # -- what holds the next sample ---------------------------------------------------------

    @property
    def has_next(self) -> bool:
        """Whether another state follows the present one."""
        return 0 <= self.clock.tick < self._last_tick and not self.control.quitting

    def _proceed(self) -> None:
        """Make the next sample unless something holds it."""
        if self.arbiter.awaiting or self.finished or self.clock.tick >= self.recorders.limit:
            return
        if not self.has_next:
            if self.recorders.have_last:
                self._end()
        elif self.control.reset_wanted or self.control.take_step():
            self._step()

    def poll(self) -> float:
        """Start, pace and republish on the wall clock; return the seconds to the next call."""
        now, tick = monotonic(), self.clock.tick
        if self.arbiter.awaiting and now < self._published_at + SOON:
            return SOON
        for recorder in self.recorders.drop_silent(now, self.parameters.recorder_timeout):
            self.get_logger().warning(f'recorder {recorder} timed out: continuing without it')
        if tick < 0:
            self.finished = self.finished or self.control.quitting
            return self._start(now)
        self._proceed()
        if self.finished or self.clock.tick > tick:
            return 0.0
        self.arbiter.silence.look(now)
        held = self.arbiter.awaiting or not (
            self.recorders.may_step and (self.has_next or self.recorders.have_last)
        )
        patience = self.arbiter.patience if held else HEARTBEAT
        if self.arbiter.silence.seconds >= self.parameters.command_timeout:
            self._nobody_answers(now)
        if now >= self._published_at + patience:
            self._published_at = now
            self.outputs.send_again(self.arbiter.header, self.arbiter.awaiting)
        wait = min(patience, IDLE)
        if self.pacer.wall_step and not (held or self.control.holds):
            wait = min(wait, max(self.pacer.due(self.clock.tick) - monotonic(), 0.0))
        return wait

    def _nobody_answers(self, now: float) -> None:
        """Let another controller take over, and stop waiting for messages that are lost."""
        if self.arbiter.drop_silent(self.parameters.command_timeout):
            silent = self.arbiter.silence.seconds
            self.get_logger().warning(
                f'no command for {silent:.2g} s at {self.clock.seconds()} s:'
                ' any controller may take over'
            )
            self._published_at = -math.inf
        if self.arbiter.awaiting:
            self._report.waiting_for('a controller', now)
            if self.control.quitting:
                self._end()
            else:
                self.arbiter.let_time_pass(waits_for_time(self))
        else:
            self.recorders.let_go()
            if not self.has_next:
                self._end()

    def _end(self) -> None:
        self.finished = True
        self._report.summarize('the run is over')

    def close(self) -> None:
        """Wait until the sent messages are acknowledged."""
        if not self.finished and self.clock.tick >= 0:
            self._report.summarize('stopped')
        self.outputs.wait()


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop,
        'plant_simulator',
        'The axis in simulated time: joint_states out, joint_commands in.',
        lambda _: [PlantSimulator],
        'F_c:=0.5',
    )
