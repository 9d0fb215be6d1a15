"""The requests of the page: parameter values, undo, services of the plant, recordings, files."""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.client import Client
from std_srvs.srv import SetBool, Trigger

from impulse_control_ros.files.experiment import NODES
from impulse_control_ros.files.parameter_file import base
from impulse_control_ros.files.saved_parameters import write_experiment
from impulse_control_ros.nodes.dashboard.fields import value_of
from impulse_control_ros.nodes.dashboard.peer import Peer

PATIENCE = 3.0  # s for the answer of a service
MOST_CHANGES = 100  # that can be undone
SERVICES: dict[str, tuple[str, Any, dict[str, Any]]] = {
    'pause': ('pause', SetBool, {'data': True}),
    'resume': ('pause', SetBool, {'data': False}),
    'step': ('step', Trigger, {}),
    'reset': ('reset', Trigger, {}),
}
Answer = Callable[[Mapping[str, Any]], None]


@dataclass(frozen=True)
class Waiting:
    """A pending request: ``done`` gets the result of ``future``, or none after ``until`` [s]."""

    future: Any
    done: Callable[[Any], None]
    late: Callable[[], None]
    until: float


class Requests:
    """The requests to ``dashboard``, a `Dashboard`; each is answered with ``refused``, or ''."""

    def __init__(self, dashboard: Any) -> None:
        self._dashboard = dashboard
        self._now = 0.0
        self._waiting: list[Waiting] = []
        # the node's name, and the values before
        self._changes: deque[tuple[str, dict[str, Any]]] = deque(maxlen=MOST_CHANGES)
        self._plant = ''
        self._services: dict[str, Client] = {}

    @property
    def last_change(self) -> str:
        """The values that an undo would set, '' if there are none."""
        if not self._changes:
            return ''
        node, before = self._changes[-1]
        return ', '.join(f'{node} {name} = {value}' for name, value in before.items())

    def reach(self, plant: Peer | None) -> None:
        """Create clients of the services of the present plant, for discovery before their use."""
        name = plant.name if plant else ''
        if name == self._plant:
            return
        for client in self._services.values():
            self._dashboard.destroy_client(client)
        self._plant, self._services = name, {}
        for service, kind, _ in SERVICES.values() if name else ():
            if service not in self._services:
                self._services[service] = self._dashboard.create_client(kind, f'{name}/{service}')

    def take(self, request: Mapping[str, Any], answer: Answer) -> None:
        """Handle a request of a window."""
        what = str(request.get('do'))
        if what == 'set':
            self._set(request, answer)
        elif what == 'undo':
            self._undo(answer)
        elif what in SERVICES:
            self._call(what, answer)
        elif what in ('record', 'stop'):
            recording = self._dashboard.recording
            answer({'refused': recording.start() if what == 'record' else recording.stop()})
        elif what == 'save':
            known = {base(one.name): one.values for one in self._dashboard.peers.values()}
            ours = {name: known[name] for name in NODES if known.get(name)}
            answer(save(str(request.get('file')), ours))
        else:
            answer({'refused': f'unknown request {what!r}'})

    def _set(self, request: Mapping[str, Any], answer: Answer) -> None:
        peer, name = self._dashboard.peers.get(request.get('role')), str(request.get('name'))
        if not peer or name not in peer.values:
            answer({'refused': 'the node is gone'})
            return
        before = peer.values[name]
        value = value_of(str(request.get('text')), before)
        self._send(peer, {name: value}, {name: before}, answer)

    def _undo(self, answer: Answer) -> None:
        if not self._changes:
            answer({'refused': 'there is nothing to undo'})
            return
        node, before = self._changes.pop()
        peers = self._dashboard.peers.values()
        peer = next((one for one in peers if one.name == node), None)
        if peer:
            self._send(peer, before, None, answer)
        else:
            answer({'refused': f'{node} is gone'})

    def _send(
        self, peer: Peer, values: dict[str, Any], before: dict[str, Any] | None, answer: Answer
    ) -> None:
        """Set parameters of a node; ``before`` is what an undo sets, None for an undo itself."""

        def done(refused: str) -> None:
            if not refused and before and before != values:
                self._changes.append((peer.name, before))
            answer({'refused': refused})

        self._wait(peer.set(values), done, answer)

    def _call(self, what: str, answer: Answer) -> None:
        """Call a service of the plant."""
        service, kind, fields = SERVICES[what]
        client = self._services.get(service)
        if not client or not client.service_is_ready():
            answer({'refused': f'the plant offers no service {service}'})
            return

        def done(response: Any) -> None:
            refused = '' if response.success else response.message
            answer({'refused': refused, 'said': response.message})

        self._wait(client.call_async(kind.Request(**fields)), done, answer)

    def _wait(self, future: Any, done: Callable[[Any], None], answer: Answer) -> None:
        def late() -> None:
            answer({'refused': 'the node does not answer'})

        self._waiting.append(Waiting(future, done, late, self._now + PATIENCE))

    def poll(self, now: float) -> None:
        """Answer the requests that have a result, or have waited long enough."""
        self._now, waiting, self._waiting = now, self._waiting, []
        for one in waiting:
            if one.future.done():
                one.done(one.future.result())
            elif now > one.until:
                one.late()
            else:
                self._waiting.append(one)


def save(name: str, values: Mapping[str, Mapping[str, Any]]) -> Mapping[str, str]:
    """Write ``values`` by node and name as an experiment, a new file in the present folder."""
    path = Path(name)
    if path.name != name or path.suffix != '.yaml':
        return {'refused': f'invalid file {name!r}: must be a NAME.yaml, without a folder'}
    if path.exists():
        return {'refused': f'{path.absolute()} exists: choose another name'}
    if not values:
        return {'refused': 'no plant_simulator and no controller is running'}
    try:
        write_experiment(path, values)
    except OSError as error:
        return {'refused': f'{path.absolute()}: {error.strerror}'}
    return {'refused': '', 'said': f'saved {" and ".join(values)} to {path.absolute()}'}
