"""
The controller node: joint_states in, joint_commands, impulse_events, effort_commands out.

core/protocol.py selects the states that the controller answers. A command carries the stamp of its
state; the control law takes time from the states, never from a clock. A plant that does not wait
for commands (foreign, or with ``lockstep: false``) holds the last command. The controller
therefore commands 0 N when no state arrives for ``state_timeout``, and when it ends. It also sends
0 N instead of an effort that is not finite or exceeds ``effort_limit``. All three cases clear the
memory of the guards.
"""

import math
from time import monotonic
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.core.age import Age, AgeLimit
from impulse_control_ros.core.control_law import NO_IMPULSE
from impulse_control_ros.core.free_running import StateRate, StateTimeout
from impulse_control_ros.core.impulse_verdicts import NO_VERDICT
from impulse_control_ros.core.protocol import name_of, new_id, parse_state, Reply, StateHeader
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.core.state_arbiter import StateArbiter
from impulse_control_ros.core.tick import nanoseconds, seconds, to_ns
from impulse_control_ros.errors import ParameterError, UnreadableError
from impulse_control_ros.files.cdr import read_header
from impulse_control_ros.files.experiment import ControllerParameters
from impulse_control_ros.files.topics import JOINT_STATES, RUN_PARAMETERS, SETPOINT
from impulse_control_ros.nodes.answers import Answers
from impulse_control_ros.nodes.controller_report import ControllerReport
from impulse_control_ros.nodes.joint_state_io import JointStateReader
from impulse_control_ros.nodes.known_plants import KnownPlants
from impulse_control_ros.nodes.lifecycle import ManagedNode
from impulse_control_ros.nodes.spin import IDLE, main as run_node
from impulse_control_ros.nodes.supervision_report import SupervisionReport
from impulse_control_ros.nodes.topics import LATCHED_QOS, LOCKSTEP_QOS, SLOW_QOS

INF = math.inf


class Controller(ManagedNode):
    """Answers joint states by the control law; if ``composed``, it reads none from DDS."""

    def __init__(self, composed: bool = False, **options: Any) -> None:
        super().__init__('controller', ControllerParameters, **options)
        self.id = new_id(self.get_fully_qualified_name())
        self.plants = KnownPlants(self.get_logger())
        self.answers = Answers(self, self.id, self.parameters)
        self._law = SampledController(self.parameters)
        self._reader = JointStateReader(
            self.parameters.joint_name, parse_state, ('position',), ('velocity',)
        )
        self._seen = b''
        self.active_other = ''
        self._untold: dict[str, Any] | None = None
        step_ns = nanoseconds(self.parameters.time_step, 'time_step')
        self.states = StateArbiter(self.id, step_ns, monotonic())
        self.rate, self.timeout = StateRate(step_ns), StateTimeout()
        self.age = AgeLimit(self.parameters.max_age)
        self.create_subscription(Float64, SETPOINT, self._on_setpoint, SLOW_QOS)
        if not composed:
            self.create_subscription(
                ParameterEvent, RUN_PARAMETERS, self.plants.on_event, LATCHED_QOS, raw=True
            )
            self.create_subscription(
                JointState, JOINT_STATES, self.on_state, LOCKSTEP_QOS, raw=True
            )
        self.supervision = SupervisionReport(self, self._law)
        self._report = ControllerReport(self)
        if self.parameters.lifecycle:
            self.manage()
        self.plants.advise(None, self.parameters)

    # -- the sample -------------------------------------------------------------------------

    def on_state(self, raw: bytes) -> None:
        """Handle one joint state, given as CDR."""
        if not self.active:
            return
        try:
            header, (sec, nanosec, position, velocity) = self._reader.read(raw)
            if not (-INF < position < INF and -INF < velocity < INF):
                self._require_measured(position, velocity)
            stamp = to_ns(sec, nanosec)
            if not self.states.follows(header, stamp) and (
                not self._is_to_answer(header, stamp, raw)
            ):
                return
        except UnreadableError as error:
            self._reject(raw, error)
            return
        if self._untold is not None:
            self.answers.tell_parameters(sec, nanosec, self.parameters.flat(), self._untold)
            self._untold = None
        effort, area, guard, velocity, verdict, ratio = self._law.answer(position, velocity)
        if not abs(effort) <= self._law.largest:  # also true for NaN
            self._law.forget()
            self._report.withhold(effort, self._law.largest, position, velocity)
            effort, guard, verdict = 0.0, NO_IMPULSE, NO_VERDICT
        if guard or verdict:
            self.answers.send_event(sec, nanosec, effort, guard, verdict, position, velocity, area)
            if verdict:
                self.supervision.judged(verdict, ratio)
        else:
            self.answers.send(sec, nanosec, effort)

    def _require_measured(self, position: float, velocity: float) -> None:
        """Raise `UnreadableError` for unusable values; a velocity of nan is estimated."""
        estimated = self.parameters.velocity_source == 'estimated' or math.isnan(velocity)
        if not (math.isfinite(position) and estimated):
            raise UnreadableError(f'position {position}, velocity {velocity}')

    def _is_to_answer(self, header: StateHeader, stamp: int, raw: bytes) -> bool:
        """Return whether a state needs a new answer; republished states are answered here."""
        if header.run and header.run not in self.plants:
            return False  # republished until the plant's parameters have arrived
        if not header.run and not stamp:
            raise UnreadableError('no stamp')
        if not header.run and self._is_too_old(stamp):
            return False
        before, last = self.states.run, self.states.stamp
        lockstep = not self.plants.is_free_running(header.run)
        reply = self.states.judge(header, stamp, lockstep)
        if not header.run:
            if reply is Reply.REPEAT and raw != self._seen:
                raise UnreadableError(f'same stamp as the previous state, {seconds(stamp)} s')
            self._seen = raw
        if self.states.run != before:
            self.active_other = ''  # it controls another run
            if not self._adopt(header.run):
                return False
        if reply is Reply.ANSWER_AFRESH:
            if stamp < last and self.states.run == before:
                self.get_logger().info(
                    f'joint_states stamps went back from {seconds(last)} s to '
                    f'{seconds(stamp)} s: memory cleared'
                )
            self.rate.begin(stamp, self.answers.sent, last)
            self._begin(header, stamp)
        elif reply is not Reply.ANSWER:
            self._pass_over(reply, header)
        return reply in (Reply.ANSWER, Reply.ANSWER_AFRESH)

    def _is_too_old(self, stamp: int) -> bool:
        """Return whether a state of a foreign plant counts as lost."""
        if not self.age.limit:
            return False
        is_old = self.age.judge(stamp, self.get_clock().now().nanoseconds) is Age.OLD
        if is_old:
            self._report.too_old(self.age)
        return is_old

    def _adopt(self, run: str) -> bool:
        """Answer a plant from now on; end the node if the parameters disagree."""
        try:
            self.plants.adopt(run, self.parameters)
        except ParameterError as error:
            self.fail(error)
        return not self.finished

    def _reject(self, raw: bytes, error: UnreadableError) -> None:
        """Report a state that cannot be read, perhaps because its plant has another joint."""
        run = parse_state(read_header(raw)[1].decode(errors='replace')).run
        if run in self.plants and self.states.run is None and not self._adopt(run):
            return
        self._report.reject(error)

    def _begin(self, header: StateHeader, stamp: int) -> None:
        """Start with an empty memory at this state."""
        self._law.forget()
        self.supervision.begin()
        self.answers.address(header.run, header.episode)
        self._untold = {}
        if self.active_other:
            self.get_logger().info(
                f'taking over at {seconds(stamp)} s: {name_of(self.active_other)} is silent'
            )
            self.active_other = ''

    def _pass_over(self, reply: Reply, header: StateHeader) -> None:
        """Handle a state that needs no new answer."""
        if reply is Reply.REPEAT:
            self._report.counts['repeated'] += 1
            # one of our free-running plants repeats its state only for new peers
            if not (header.run and self.plants.is_free_running(header.run)):
                self.answers.repeat()
        elif reply is Reply.STAND_BY:
            self._report.counts['standby'] += 1
            if header.controller != self.active_other:
                self.active_other = header.controller
                self.timeout.forget()
                self.get_logger().info(
                    f'{name_of(header.controller)} is the active controller: standing by'
                )
        elif reply is Reply.OTHER_RUN:
            self._report.counts['other_run'] += 1
            self._report.ignore(header)

    # -- parameters, lifecycle, reports -----------------------------------------------------

    def parameters_changed(self, changed: dict[str, Any]) -> None:
        """Use the new gains from the next sample on."""
        self._law.change(self.parameters)
        self.supervision.parameters_changed()
        self.age = AgeLimit(self.parameters.max_age)
        if self._untold != {} and self.states.run is not None:
            self._untold = {**(self._untold or {}), **changed}
        self.plants.advise(self.states.run, self.parameters)

    def _on_setpoint(self, message: Float64) -> None:
        result = self.set_parameters_atomically(
            [Parameter('x_r', Parameter.Type.DOUBLE, message.data)]
        )
        if not result.successful:
            self.get_logger().error(f'setpoint: {result.reason}')

    def activated(self) -> None:
        """Answer from now on, with an empty memory."""
        self.states.start_afresh()
        self.timeout.forget()

    def deactivated(self) -> None:
        """Command 0 N to a free-running plant."""
        if self.states.is_answering and self.plants.is_free_running(self.states.run):
            self._command_zero()

    def _command_zero(self) -> None:
        self._law.forget()
        self.answers.send_zero()

    def poll(self) -> float:
        """Command 0 N if states stop arriving from a plant that does not wait for commands."""
        timeout, now = self.parameters.state_timeout, monotonic()
        self.states.silence.look(now)
        self.supervision.look()
        if not (
            timeout
            and self.active
            and self.states.is_answering
            and self.plants.is_free_running(self.states.run)
        ):
            return IDLE
        was_deserted = self.timeout.deserted
        if self.timeout.is_due(self.answers.sent, now, timeout):
            self._command_zero()
            if not was_deserted:
                self.get_logger().error(f'no state for {timeout:g} s: commanding 0 N')
        elif was_deserted and not self.timeout.deserted:
            self.get_logger().info('states received again: resuming control')
        return min(IDLE, timeout / 4)

    def close(self) -> None:
        """Deactivate, and wait until the sent messages are acknowledged."""
        if self.active:
            self.deactivated()
        self.answers.wait()


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop,
        'controller',
        'PD and impulses: answers joint_states with joint_commands.',
        lambda _: [Controller],
        'K:=12.0',
    )
