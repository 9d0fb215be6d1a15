"""
The controller node: joint_states in, joint_commands and impulse_events out.

One command answers each state and carries its stamp, and the guard that fired as its frame_id;
time is the state's, never a clock's. A state that comes again is answered again with the same
bytes, and leaves the memory as it is. A state that goes back in time, or carries the mark of a
start or a reset, clears the guard memory.
The first state of a plant is held until the plant has told its parameters, if it has any: a
controller for another time step or joint ends there.

A plant that does not wait for commands (lockstep: false, or one that tells no such parameter)
goes on with the last one, so it is commanded 0 N when its states stay away for state_timeout of
wall time, and when the controller leaves. An effort that is not finite, or above effort_limit,
never leaves: 0 N is sent in its place. All three clear the guard memory.

A second controller of a plant stands by, see nodes/standby.py: the plant goes on without its
commands. A state that has no stamp, or that of the one before, is rejected.
"""

from collections.abc import Mapping
import math
import sys
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from impulse_control_ros.core.axis import Axis
from impulse_control_ros.core.careful import control_carefully, fresh_watch, packed_law
from impulse_control_ros.core.design import Finding, findings, Level
from impulse_control_ros.core.impulse import ANSWER, fresh_memory, NO_IMPULSE
from impulse_control_ros.core.kernel import machine_code
from impulse_control_ros.core.parameter import ParameterError
from impulse_control_ros.core.tick import nanoseconds, SECOND
from impulse_control_ros.files.cdr import RESET_MARK, WITHOUT_VELOCITY
from impulse_control_ros.files.experiment import axis_of, ControllerParameters, require_agreement
from impulse_control_ros.nodes.diagnostics import Diagnostics
from impulse_control_ros.nodes.graph import own_publisher, plants, publishers
from impulse_control_ros.nodes.managed import ManagedNode
from impulse_control_ros.nodes.parameters import PeerParameters
from impulse_control_ros.nodes.spin import IDLE, main as run_node
from impulse_control_ros.nodes.standby import SILENCE, Standby
from impulse_control_ros.nodes.topics import (
    command_layouts,
    decode_any,
    event_layouts,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATES,
    SERIES_QOS,
    SETPOINT,
    SLOW_QOS,
    state_layout,
    UnreadableError,
)
from impulse_control_ros.stop import StopRequest

LEAST_ANSWERED, RATE_TOLERANCE = 100, 0.2
NEVER = (2**31, 0)  # later than any stamp: the first state counts as one that goes back


class Controller(ManagedNode):
    """Answers every joint state with the effort of the control law."""

    def __init__(self, **options: Any) -> None:
        super().__init__('controller', ControllerParameters, **options)
        joint, logger = self.parameters.joint_name, self.get_logger()
        self._state_layout = state_layout(joint, logger)
        self._bare_layout = state_layout(joint, logger, fields=WITHOUT_VELOCITY)
        self._command_layouts = command_layouts(joint, logger)
        self._event_layouts = event_layouts(joint, logger)
        self._memory, self._answer = fresh_memory(), np.zeros(1, ANSWER)
        self._watch = fresh_watch()
        self._pack()
        self._control = machine_code(
            control_carefully, fresh_memory(), fresh_watch(), self._packed, self._care, 0.0, 0.0,
            np.zeros(1, ANSWER))
        self._seen = b''
        self._sent: tuple[bytes, bytes] = (b'', b'')
        self._stamp = self._first = NEVER
        self._answered_before = self._lost_before = self._sent_besides = 0
        self._step_ns = nanoseconds(self.parameters.time_step, 'time_step')
        self._plant: PeerParameters | None = None
        self._plant_known = False
        self._held = self._met = b''
        self._passed = (0, 0)
        self._findings: list[Finding] = []
        self._axis: Axis | None = None
        self._counts = {'answered': 0, 'impulses': 0, 'repeated': 0, 'rejected': 0, 'withheld': 0}
        self._runs_freely = False
        self._heard, self._quiet_since, self._deserted = 0, 0.0, False
        self._events = self.create_publisher(JointState, IMPULSE_EVENTS, SERIES_QOS)
        self._commands, own = own_publisher(self, JointState, JOINT_COMMANDS, SERIES_QOS)
        self.standby = Standby(self, own)
        # publish() without its checks: these are bytes, and the publisher lives as long as we do
        self._publish_command = self._commands.handle.publish_raw
        self.create_subscription(Float64, SETPOINT, self._on_setpoint, SLOW_QOS)
        self.states = self.create_subscription(
            JointState, JOINT_STATES, self.on_state, SERIES_QOS, raw=True)
        Diagnostics(self, self._progress, self._report)
        if self.parameters.managed:
            self.manage()
        self._warn()

    def _warn(self) -> None:
        """Say what is unwise now, once."""
        before, self._findings = self._findings, findings(self.parameters, self._axis)
        for finding in self._findings:
            if finding in before:
                continue
            # rclpy takes one severity for each call
            if finding.level is Level.NOTE:
                self.get_logger().info(finding.text)
            elif finding.level is Level.WARNING:
                self.get_logger().warning(finding.text)
            else:
                self.get_logger().error(finding.text)

    # -- the plant --------------------------------------------------------------------------

    def trust(self, plant: str, axis: Mapping[str, Any]) -> None:
        """Answer from now on the ``plant`` with these parameters, or raise `ParameterError`."""
        require_agreement(plant, axis, self.parameters.flat())
        self._axis = axis_of(axis)
        self._plant_known, self._runs_freely = True, not axis.get('lockstep', False)
        # in lockstep nobody takes over before the state has come again
        self.standby.patience = max(SILENCE, axis.get('command_timeout', SILENCE))
        self.get_logger().info(f'answering {plant}')
        self._warn()

    def _meet_plant(self) -> None:
        """Ask the plant for its parameters; then answer the state that was held meanwhile."""
        self._plant = self._plant or PeerParameters(self)
        if not self._plant.poll(publishers(self, JOINT_STATES).values()):
            return
        try:
            for plant, axis in self._plant.values.items():
                self.trust(plant, axis)
        except ParameterError as error:
            self.fail(error)
            return
        for plant in self._plant.silent:
            self.get_logger().warning(f'{plant} does not tell its parameters: joint and time step '
                                      'are taken to be ours')
            self._runs_freely = True
        self._plant_known, self._plant, self._met = True, None, self._held
        self.on_state(self._held)

    def _start_afresh(self, sec: int, nanosec: int, mark: bool, raw: bytes) -> bool:
        """
        Clear the guard memory; returns False for a state that is not to be answered now.

        It is of a plant that is to be met anew, or of a second one beside the one we know.
        """
        follows = self._stamp != NEVER and (
            (sec - self._stamp[0]) * SECOND + nanosec - self._stamp[1] == self._step_ns)
        if self._stamp != NEVER and not follows and len(plants(self)) > 1:
            self.get_logger().warning(
                f'two plants publish {self.states.topic_name}: the state at {sec}.{nanosec:09d} s '
                'is not answered', throttle_duration_sec=5.0)
            return False
        if self._stamp == NEVER:
            passed, self._passed = self._passed, (sec, nanosec)
            if (mark or (sec, nanosec) < passed) and raw != self._met and not self.standby.alone:
                self._plant_known = False  # it may be another one than that we stood by for
                return False
            if self.standby.passes((sec, nanosec), self._runs_freely, mark):
                return False
        self._memory, self._watch = fresh_memory(), fresh_watch()
        if self._stamp == NEVER:
            self._first, self._answered_before = (sec, nanosec), self._counts['answered']
        elif not follows:
            self.get_logger().info(f'joint_states went from {self._stamp[0]}.{self._stamp[1]:09d} '
                                   f's to {sec}.{nanosec:09d} s: started afresh')
            self._lost_before = self._lost()
            self._stamp, self._plant_known = NEVER, False
        return self._plant_known

    def _lost(self) -> int:
        """Return the number of states that are missing between the first and the last."""
        span, answered = self._series()
        return self._lost_before + max(0, span // self._step_ns + 1 - answered if answered else 0)

    def _series(self) -> tuple[int, int]:
        """Return the time [ns] from the first to the last state, and how many were answered."""
        if self._stamp == NEVER:
            return 0, 0
        span = (self._stamp[0] - self._first[0]) * SECOND + self._stamp[1] - self._first[1]
        return span, self._counts['answered'] - self._answered_before

    def _wrong_rate(self) -> str:
        """Say that states come at another rate than time_step: impulses then have another area."""
        span, answered = self._series()
        ratio = span / self._step_ns / (answered - 1) if answered >= LEAST_ANSWERED else 1.0
        if abs(ratio - 1.0) <= RATE_TOLERANCE:
            return ''
        step = self.parameters.time_step
        text = (f'states come every {ratio * step:g} s in the mean, where time_step = {step:g} s: '
                'it is wrong, or states are lost')
        self.get_logger().error(text, throttle_duration_sec=20.0)
        return text

    def activated(self) -> None:
        """Answer from now on, as at a start."""
        self._forget()

    def _forget(self) -> None:
        """Let the next state be the first one."""
        self._lost_before, self._stamp = self._lost(), NEVER
        self._heard, self._deserted = 0, False

    def deactivated(self) -> None:
        """Leave no effort behind."""
        if self._runs_freely and self._stamp != NEVER:
            self._command_zero()

    def _give_way(self) -> None:
        """Stand by where another controller answers."""
        if self.standby.gives_way(self._counts['answered'] + self._sent_besides):
            self._forget()

    # -- the sample -------------------------------------------------------------------------

    def parameters_changed(self) -> None:
        """Let the next sample be answered with the new gains."""
        self._pack()
        self._warn()

    def _pack(self) -> None:
        self._packed, self._care = packed_law(self.parameters)
        self._largest = self.parameters.effort_limit or sys.float_info.max

    def _on_setpoint(self, message: Float64) -> None:
        result = self.set_parameters_atomically(
            [Parameter('x_r', Parameter.Type.DOUBLE, message.data)])
        if not result.successful:
            self.get_logger().error(f'setpoint: {result.reason}')

    def on_state(self, raw: bytes) -> None:
        """Answer one joint state, given as CDR."""
        if not self.active:
            return
        if raw == self._seen and not self.standby.stands_by:
            self._repeat()
            return
        if not self._plant_known:
            self._held = raw
            return
        self._give_way()
        values = self._state_layout.decode(raw)
        if values is not None and math.isfinite(values[2]) and math.isfinite(values[3]):
            sec, nanosec, position, velocity, _ = values
            mark = False
        else:
            try:
                sec, nanosec, mark, position, velocity = self._decoded(raw)
            except UnreadableError as error:
                self._reject(f'a state {error}')
                return
        if (sec, nanosec) == self._stamp and not mark or (sec, nanosec) == (0, 0):
            self._reject(f'a state with the stamp {sec}.{nanosec:09d} s: '
                         + ('so has the one before' if sec or nanosec else 'that is none'))
            return
        if ((sec, nanosec) <= self._stamp or mark) and not self._start_afresh(
                sec, nanosec, mark, raw):
            self._held = b'' if self._plant_known else raw
            return
        self._stamp, self._seen = (sec, nanosec), raw
        self._control(self._memory, self._watch, self._packed, self._care, position, velocity,
                      self._answer)
        effort, area, guard, velocity = self._answer.item()
        if not abs(effort) <= self._largest:  # nor is NaN
            self._withhold(effort, position, velocity)
            effort, guard = 0.0, NO_IMPULSE
        event = b''
        if guard:
            event = self._event_layouts[guard].encode(sec, nanosec, position, velocity, area)
            self._events.publish(event)
            self._counts['impulses'] += 1
        command = self._command_layouts[guard].encode(sec, nanosec, effort)
        self._publish_command(command)
        self._sent = (event, command)
        self._counts['answered'] += 1

    def _decoded(self, raw: bytes) -> tuple[int, int, bool, float, float]:
        """Return (sec, nanosec, whether marked, position, velocity) of any state, or raise."""
        bare = self._bare_layout.decode(raw)
        if bare is not None:
            sec, nanosec, position, _ = bare
            frame_id, velocity = '', None
        else:
            sec, nanosec, frame_id, position, velocity = decode_any(
                raw, self.parameters.joint_name, ('position',), ('velocity',))
        if self.parameters.velocity_source == 'estimated':
            velocity = None
        if not (math.isfinite(position) and (velocity is None or math.isfinite(velocity))):
            raise UnreadableError(f'with position {position}, velocity {velocity}')
        return (sec, nanosec, frame_id == RESET_MARK, position,
                math.nan if velocity is None else velocity)

    def _repeat(self) -> None:
        self._counts['repeated'] += 1
        if self._runs_freely:  # it does not ask: who sends the same for ever has stopped
            return
        event, command = self._sent
        if event:
            self._events.publish(event)
        self._commands.publish(command)
        self._sent_besides += 1

    def _withhold(self, effort: float, position: float, velocity: float) -> None:
        """Account for an ``effort`` that is not sent."""
        self._memory, self._watch = fresh_memory(), fresh_watch()
        self._counts['withheld'] += 1
        self.get_logger().error(
            f'0 N is sent: the effort for position {position:g} m, velocity {velocity:g} m/s is '
            f'{effort:g}; allowed is [-{self._largest:g}, {self._largest:g}] [N]',
            throttle_duration_sec=5.0)

    def _reject(self, what: str) -> None:
        self._counts['rejected'] += 1
        self.get_logger().error(f'rejected {what}', throttle_duration_sec=5.0)

    def _progress(self) -> tuple[int, float]:
        answered = self._counts['answered']
        return answered, answered * self.parameters.time_step

    def _report(self, rate: float) -> tuple[bytes, str, dict[str, object]]:
        wrong = self._wrong_rate()
        level = (DiagnosticStatus.ERROR if self._counts['withheld'] or self._deserted or wrong
                 else DiagnosticStatus.WARN if self._counts['rejected'] else DiagnosticStatus.OK)
        return level, wrong or (
            'not active' if not self.active else 'standing by' if self.standby.stands_by
            else 'answering' if rate else 'waiting for states'), {
            **self._counts, 'lost': self._lost(), 'x_r': self.parameters.x_r}

    def poll(self) -> float:
        """Meet the plant, and look whether its states stay away."""
        if self._held and not self._plant_known:
            self.standby.serve()
            self._meet_plant()
            return 0.02
        self._give_way()
        timeout = self.parameters.state_timeout
        if not (self._runs_freely and timeout and self.active) or self.standby.stands_by:
            return IDLE
        self._watch_states(monotonic(), timeout)
        return min(IDLE, timeout / 4)

    def _watch_states(self, now: float, timeout: float) -> None:
        """Command 0 N once the last answer is ``timeout`` old, and again as often."""
        if self._heard != self._counts['answered']:
            self._heard, self._quiet_since = self._counts['answered'], now
            if self._deserted:
                self.get_logger().info('states are back: answering again')
            self._deserted = False
        elif self._heard and now >= self._quiet_since + timeout:
            self._quiet_since = now
            self._command_zero()
            if not self._deserted:
                self.get_logger().error(f'no state for {timeout:g} s: 0 N is commanded')
            self._deserted = True

    def _command_zero(self) -> None:
        """Command 0 N in answer to no state: with stamp 0, which ROS reads as no time."""
        self._memory, self._watch = fresh_memory(), fresh_watch()
        self._commands.publish(self._command_layouts[NO_IMPULSE].encode(0, 0, 0.0))
        self._sent_besides += 1

    def close(self) -> None:
        """Leave no effort behind, and wait until what was sent has arrived."""
        if self.active:
            self.deactivated()
        for publisher in (self._events, self._commands):
            publisher.wait_for_all_acked(Duration(seconds=4))


def main(stop: StopRequest) -> int:
    """Run the node."""
    return run_node(
        stop, 'controller', 'PD and impulses: answers joint_states with joint_commands.',
        lambda _: [Controller], 'K:=12.0')
