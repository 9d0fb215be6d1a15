"""One node that the dashboard shows: its parameters and its values on /diagnostics."""

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from time import sleep
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from impulse_control_ros.errors import ImpulseControlError
from impulse_control_ros.files.experiment import is_foreign
from impulse_control_ros.nodes.parameter_client import ParameterClient

SERVE = 0.005  # s; the main thread serves the node
PATIENCE = 3.0  # s for an answer
Loaded = tuple[list[ParameterDescriptor], dict[str, Any]]


class Peer:
    """
    The node of full name ``name``.

    Its parameters are read and set in a thread, because an answer may take seconds or never
    arrive. ``values`` and ``described`` have them by name; ``version`` changes with them.
    """

    def __init__(self, node: Node, name: str) -> None:
        self.name = name
        self.values: dict[str, Any] = {}
        self.described: dict[str, ParameterDescriptor] = {}
        self.version = 0
        self.report: Mapping[str, str] = {}
        self._client = ParameterClient(node, name, lambda: sleep(SERVE), PATIENCE)
        self._worker = ThreadPoolExecutor(1, f'parameters of {name}')
        self._loading: Future[Loaded] | None = None
        self._last: Future[Any] | None = None
        self._loaded: frozenset[bytes] | None = None
        self._wanted: frozenset[bytes] = frozenset()
        self._changed: dict[str, Any] = {}  # since the present load began

    def look(self, ends: frozenset[bytes]) -> None:
        """
        Read the parameters if the node is new or restarted, or has not answered yet.

        ``ends`` are the graph's ids of its publishers: a restarted node has others.
        """
        if self._loading is None:
            if self._loaded != ends:
                self._wanted, self._changed = ends, {}
                self._last = self._loading = self._worker.submit(self._load)
        elif self._loading.done():
            loading, self._loading = self._loading, None
            if not loading.exception():
                self._loaded = self._wanted
                described, self.values = loading.result()
                self.described = {one.name: one for one in described}
                self.version += 1
                self.changed(self._changed)

    def _load(self) -> Loaded:
        names = [name for name in self._client.list() if not is_foreign(name)]
        values = self._client.get(names) if names else {}
        return list(self._client.describe(names)) if names else [], values

    def set(self, values: Mapping[str, Any]) -> Future[str]:
        """Set parameters, all or none; the result is the reason of a refusal, or ''."""
        self._last = made = self._worker.submit(self._set, values)
        return made

    def _set(self, values: Mapping[str, Any]) -> str:
        try:
            self._client.set_atomically(values)
        except ImpulseControlError as error:
            return str(error)
        return ''

    def changed(self, values: Mapping[str, Any]) -> None:
        """Take changed values of the node."""
        self._changed |= values
        ours = {name: value for name, value in values.items() if name in self.described}
        if ours:
            self.values = self.values | ours
            self.version += 1

    def close(self, wait: bool = False) -> bool:
        """Leave the node, unless an answer is still expected; return whether it is left."""
        if not (wait or self._last is None or self._last.done()):
            return False
        self._worker.shutdown(cancel_futures=True)
        self._client.close()
        return True
