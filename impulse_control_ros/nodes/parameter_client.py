"""
A client of the parameter services of one node, ours or any other.

A server's response is lost when it has not discovered this client yet. An unanswered request is
therefore sent again: setting values twice is the same as setting them once.
"""

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
import math
from time import monotonic
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParametersAtomically,
)
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.errors import NodeError, RefusedError

SERVICES = {
    ListParameters: 'list_parameters',
    DescribeParameters: 'describe_parameters',
    GetParameters: 'get_parameters',
    SetParametersAtomically: 'set_parameters_atomically',
}
ASK_AGAIN = 0.3  # s
ANY_VALUE = 'true or false, a number of 64 bits, a string, or a list of one of these'


def node_names(node: Node, with_hidden: bool = False) -> list[str]:
    """Return the full names of the nodes that ``node`` has discovered, in order."""
    return sorted(
        f'{namespace.rstrip("/")}/{name}'
        for name, namespace in node.get_node_names_and_namespaces()
        if with_hidden or not name.startswith('_')
    )


def nodes_found(names: Sequence[str]) -> str:
    """Return what an error tells about the nodes on the graph."""
    return f'the nodes found are {", ".join(names)}' if names else 'no node was found'


class ParameterClient:
    """
    The parameters of the node of full name ``target``, as seen by ``node``.

    ``serve`` serves ``node`` for a moment, as ``partial(executor.spin_once, timeout_sec=0.05)``
    does; where another thread serves it, ``serve`` sleeps for a moment. Methods raise `NodeError`
    if there is no answer within ``timeout`` [s].
    """

    def __init__(
        self, node: Node, target: str, serve: Callable[[], object], timeout: float = 5.0
    ) -> None:
        self.target, self.timeout = target, timeout
        self._node, self._serve = node, serve
        self._clients: dict[type, Client] = {
            kind: node.create_client(kind, f'{target}/{name}') for kind, name in SERVICES.items()
        }

    def list(self, prefixes: Sequence[str] = ()) -> Sequence[str]:
        """Return the names of all parameters, or of those with one of the ``prefixes``, sorted."""
        return sorted(self._answer(ListParameters, prefixes=[*prefixes]).result.names)

    def describe(self, names: Iterable[str]) -> Sequence[ParameterDescriptor]:
        """Return the descriptors of parameters; none at all if the node lacks one of them."""
        return [*self._answer(DescribeParameters, names=[*names]).descriptors]

    def get(self, names: Iterable[str]) -> dict[str, Any]:
        """Return values by name; None for a parameter that has no value or does not exist."""
        names = [*names]
        values = self._answer(GetParameters, names=names).values
        if len(values) == len(names):
            return dict(zip(names, map(parameter_value_to_python, values), strict=True))
        if len(names) == 1:
            return {names[0]: None}
        # a node answers nothing if one of the parameters has no value
        return {name: value for one in names for name, value in self.get([one]).items()}

    def set_atomically(self, values: Mapping[str, Any]) -> None:
        """
        Set all ``values`` or none; None deletes a parameter.

        Integers for a parameter of type double become floats. Read-only parameters that have the
        value already are left out. Raises `ParameterError` for a value that no parameter can have,
        and `RefusedError` with the node's reason.
        """
        known = {one.name: one for one in self.describe(values)}
        made = [parameter_of(name, value, known.get(name)) for name, value in values.items()]
        fixed = [name for name, one in known.items() if one.read_only]
        before = self.get(fixed) if fixed else {}
        changed = [one for one in made if one.name not in before or before[one.name] != one.value]
        if not changed:
            return
        result = self._answer(
            SetParametersAtomically, parameters=[one.to_parameter_msg() for one in changed]
        ).result
        if not result.successful:
            raise RefusedError(result.reason + self._not_declared(values, result.reason))

    def _not_declared(self, names: Iterable[str], reason: str) -> str:
        """Return what is missing in a reason; that of rclpy names no undeclared parameter."""
        known = {*self.list()}
        unknown = [name for name in names if name not in known and name not in reason]
        return f' (not declared: {", ".join(unknown)})' if unknown else ''

    def close(self) -> None:
        """Destroy the clients of the services."""
        for client in self._clients.values():
            self._node.destroy_client(client)

    def _answer(self, kind: type[Any], **request: Any) -> Any:
        """Return the response of a service; raises `NodeError`."""
        client, calls = self._clients[kind], []
        asked, end = -math.inf, monotonic() + self.timeout
        try:
            while (now := monotonic()) < end:
                if now >= asked + ASK_AGAIN and client.service_is_ready():
                    asked = now
                    calls.append(client.call_async(kind.Request(**request)))
                self._serve()
                for call in calls:
                    if call.done():
                        return call.result()
        finally:
            for call in calls:
                client.remove_pending_request(call)
        raise self._no_answer(bool(calls))

    def _no_answer(self, asked: bool) -> NodeError:
        within = f'within {self.timeout:g} s'
        if self.target in node_names(self._node, with_hidden=True):
            what = 'does not answer' if asked else 'offers no parameter services'
            return NodeError(f'{self.target} {what} {within}')
        others = nodes_found(node_names(self._node))
        return NodeError(f'Node not found: {self.target} {within}; {others}')


def parameter_of(name: str, value: Any, known: ParameterDescriptor | None) -> Parameter:
    """Return a parameter with the type that ``known`` describes where the value fits it."""
    kind = Parameter.Type(known.type) if known else Parameter.Type.NOT_SET
    value = value.tolist() if isinstance(value, array) else value
    if kind is Parameter.Type.DOUBLE and type(value) is int:
        value = float(value)
    if isinstance(value, list):
        floats = kind is Parameter.Type.DOUBLE_ARRAY or float in map(type, value)
        if floats and {int, float}.issuperset(map(type, value)):
            value = [float(item) for item in value]
        if not value and kind.value >= ParameterType.PARAMETER_BYTE_ARRAY:
            return Parameter(name, kind, value)
    items = value if isinstance(value, list) else [value]
    try:
        if all(-(2**63) <= item < 2**63 for item in items if type(item) is int):
            return Parameter(name, value=value)
    except TypeError:
        pass
    raise refusal(name, value, ANY_VALUE)
