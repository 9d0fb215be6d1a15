"""
The dashboard node: it collects the states, events and parameters of a run.

It publishes nothing. The plant is the node that publishes joint_states, the controller the one
that publishes joint_commands, ours or foreign. Both may start, end and restart at any time.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import parameter_value_to_python
from rclpy.subscription import Subscription

from impulse_control_ros.core.live_run import LiveRun
from impulse_control_ros.core.parameter import parameter, Parameters
from impulse_control_ros.core.protocol import name_of
from impulse_control_ros.core.tick import to_ns
from impulse_control_ros.files.experiment import cpu_core_parameter
from impulse_control_ros.files.topics import (
    DIAGNOSTICS,
    JOINT_COMMANDS,
    JOINT_STATES,
    PARAMETER_EVENTS,
)
from impulse_control_ros.nodes.dashboard.fields import law_of
from impulse_control_ros.nodes.dashboard.frames import Frames
from impulse_control_ros.nodes.dashboard.inputs import best_effort, Inputs
from impulse_control_ros.nodes.dashboard.peer import Peer
from impulse_control_ros.nodes.dashboard.recording import Recording
from impulse_control_ros.nodes.dashboard.requests import Requests
from impulse_control_ros.nodes.dashboard.server import Server
from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.topics import publishers_of, SLOW_QOS

PERIOD = 0.02  # s
LOOK = 0.5  # s between looks at the graph
SILENT = 3.0  # s after the last report of a recorder, which has ended then
ROLES = {'plant': JOINT_STATES, 'controller': JOINT_COMMANDS}
BAGS = Path('runs')
LEVELS = {DiagnosticStatus.WARN: 'warning', DiagnosticStatus.ERROR: 'error'}


@dataclass(frozen=True, kw_only=True)
class DashboardParameters(Parameters):
    """Parameters of the node ``dashboard``."""

    joint_name: str = parameter(
        '', '', 'joint to show; empty for that of the nodes', read_only=True
    )
    cpu_core: int = cpu_core_parameter()


class Dashboard(ParameterNode):
    """
    Shows a run on a page in the browser, and tunes its nodes.

    ``peers`` has the nodes found, by role; ``remappings`` are the rules that a recorder shares.
    """

    def __init__(self, host: str, port: int, token: str, remappings: list[str]) -> None:
        super().__init__('dashboard', DashboardParameters)
        self.run, self.inputs = LiveRun(), Inputs(self)
        self.peers: dict[str, Peer] = {}
        self._recorders: dict[str, tuple[float, Mapping[str, str]]] = {}
        self._left: list[Peer] = []  # whose last answer is still expected
        self._active = ''
        self._look_at = 0.0
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_report, SLOW_QOS)
        self.create_subscription(
            ParameterEvent, PARAMETER_EVENTS, self._on_changed, best_effort(1000)
        )
        self.recording = Recording(BAGS, remappings)
        self.requests = Requests(self)
        frames = Frames(self)
        self.server = Server(host, port, token, frames.next, self.requests.take, BAGS)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions except the polled ones, which no executor serves."""
        polled = self.inputs.polled if hasattr(self, 'inputs') else ()
        return (item for item in super().subscriptions if item not in polled)

    def poll(self) -> float:
        """Take the new messages, look at the graph, and serve the page for a while."""
        now = monotonic()
        if now >= self._look_at:
            self._look_at = now + LOOK
            self._look()
        self._take(now)
        self.recording.poll()
        self.requests.poll(now)
        self.server.serve(PERIOD)
        return 0.0

    def _take(self, now: float) -> None:
        for header, (sec, nanosec, position, velocity, effort) in self.inputs.states():
            self._active = header.controller
            self.run.add_state(now, header.run, to_ns(sec, nanosec), position, velocity, effort)
        for header, (sec, nanosec, position, velocity, area) in self.inputs.events():
            if header.guard or not header.verdict:  # else it only judges an earlier impulse
                self.run.add_impulse(
                    header.run, to_ns(sec, nanosec), position, velocity, area, header.guard
                )

    def values(self, role: str) -> Mapping[str, Any]:
        """Return the parameters of the node of a role, by name; none if there is no such node."""
        return self.peers[role].values if role in self.peers else {}

    def reports(self) -> dict[str, Mapping[str, str]]:
        """Return the diagnostics of plant, controller and recorders, by role and name."""
        now = monotonic()
        self._recorders = {name: one for name, one in self._recorders.items() if one[0] > now}
        return {
            **{f'{role} {peer.name}': peer.report for role, peer in self.peers.items()},
            **{f'recorder {name}': report for name, (_, report) in self._recorders.items()},
        }

    def _look(self) -> None:
        """Find plant and controller, and read the parameters of those that are new."""
        self.inputs.choose()
        for role, topic in ROLES.items():
            self._find(role, topic)
        self._left = [peer for peer in self._left if not peer.close()]
        self.requests.reach(self.peers.get('plant'))
        self.run.law = law_of(self.values('controller'))
        joints = [self.values(role).get('joint_name') for role in ('controller', 'plant')]
        self.inputs.read_joint(self.parameters.joint_name or next(filter(None, joints), 'axis'))

    def _find(self, role: str, topic: str) -> None:
        """Keep the node of a role while it publishes the topic, but take the active controller."""
        ends: dict[str, set[bytes]] = {}
        for info in publishers_of(self, topic):
            name = f'{info.node_namespace.rstrip("/")}/{info.node_name}'
            ends.setdefault(name, set()).add(bytes(info.endpoint_gid))
        peer = self.peers.get(role)
        name = peer.name if peer and peer.name in ends else min(ends, default='')
        active = name_of(self._active)
        if role == 'controller' and active in ends:
            name = active
        if peer and peer.name != name:
            self._left.append(self.peers.pop(role))
        if name and role not in self.peers:
            self.peers[role] = Peer(self, name)
        if name:
            self.peers[role].look(frozenset(ends[name]))

    def _on_report(self, array: DiagnosticArray) -> None:
        for status in array.status:
            values = {item.key: item.value for item in status.values}
            report = {'message': status.message, 'level': LEVELS.get(status.level, 'ok'), **values}
            for peer in self.peers.values():
                if status.name == peer.name:
                    peer.report = report
            if 'written' in report:
                self._recorders[status.name] = monotonic() + SILENT, report

    def _on_changed(self, event: ParameterEvent) -> None:
        for peer in self.peers.values():
            if event.node == peer.name:
                peer.changed(
                    {
                        item.name: parameter_value_to_python(item.value)
                        for item in (*event.new_parameters, *event.changed_parameters)
                    }
                )
        self.run.law = law_of(self.values('controller'))

    def close(self) -> None:
        """Finish a recording, and close the connections of the page."""
        self.recording.close()
        self.server.close()
        for peer in (*self.peers.values(), *self._left):
            peer.close(wait=True)
