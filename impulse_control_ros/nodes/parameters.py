"""
ROS parameters from the parameter classes: declared, described and validated in one place.

rclpy checks type and range before any callback, with reasons that name no value; so the set is
checked here first, as a whole, and rclpy's own path is taken only by a set that is right. What
has been set is applied in the post-set callback, as one new immutable value.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from itertools import chain
import re
import sys
from time import monotonic
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.subscription import Subscription
from rclpy.task import Future

from impulse_control_ros.core.parameter import (
    build,
    declared,
    ParameterError,
    Parameters,
    refusal,
    Spec,
)
from impulse_control_ros.files.experiment import is_foreign, sections

TYPES = {float: Parameter.Type.DOUBLE, int: Parameter.Type.INTEGER, bool: Parameter.Type.BOOL,
         str: Parameter.Type.STRING, tuple: Parameter.Type.STRING_ARRAY}
PATIENCE = 5.0
ASK_AGAIN = 1.0  # a response is lost when the server has not yet matched its client
NODE_OF_RULE = re.compile(r'(\w+):[^:=]+:=')


def override_keys(arguments: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the sources of parameters on a command line, and the nodes that they name."""
    for flag, value in zip(arguments, arguments[1:], strict=False):
        if flag == '--params-file':
            yield value, list(sections(value))
        elif flag in ('-p', '--param') and NODE_OF_RULE.match(value):
            yield f'{flag} {value}', [value.split(':')[0]]


def missed_by(keys: Sequence[str], names: Sequence[str]) -> list[str]:
    """
    Return the nodes of full ``names`` that the node ``keys`` of a parameter file miss.

    These are the ones that a key is named like but not for, or all when no key is for any.
    """
    reached = [name for name in names if any(is_for(key, name) for key in keys)]
    alike = {key.rsplit('/', 1)[-1] for key in keys}
    return [name for name in names if name not in reached
            and (not reached or name.rsplit('/', 1)[-1] in alike)]


def is_for(key: str, name: str) -> bool:
    """Tell whether the node ``key`` of a parameter file is for the node of full ``name``."""
    pattern = re.escape('/' + key.lstrip('/'))
    pattern = pattern.replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'/\w+')
    return re.fullmatch(pattern, name) is not None


def descriptor(default: Any, spec: Spec) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows."""
    unit = f' [{spec.unit}]' if spec.unit else ''
    made = ParameterDescriptor(
        type=TYPES[type(default)].value, description=spec.description + unit,
        additional_constraints=spec.allowed(type(default)), read_only=spec.read_only)
    if spec.lower is not None or spec.upper is not None:
        largest = sys.float_info.max if isinstance(default, float) else 2**63 - 1
        lower = -largest if spec.lower is None else spec.lower
        upper = largest if spec.upper is None else spec.upper
        if isinstance(default, float):
            made.floating_point_range = [FloatingPointRange(from_value=lower, to_value=upper)]
        else:
            made.integer_range = [IntegerRange(from_value=int(lower), to_value=int(upper))]
    return made


class ParameterNode(Node):
    """
    A node whose parameters are those of one class; ``self.parameters`` is its present value.

    Raises `ParameterError` at birth for an override that is unknown, of a wrong type or out of
    bounds. Subclasses react to a new set in `parameters_changed`. ``finished`` tells that the
    node has nothing more to do, and ``failure`` why where that is no good end.
    """

    finished = False
    failure: Exception | None = None

    def __init__(self, name: str, kind: type[Parameters], **options: Any) -> None:
        self.taken_directly: Collection[Subscription] = ()
        super().__init__(name, **options)
        self._kind = kind
        try:
            self.parameters = self._declare()
        except ParameterError as error:
            self.destroy_node()
            raise ParameterError(f'{name}: {error}') from None
        self.add_on_set_parameters_callback(self._refuse)
        self.add_post_set_parameters_callback(self._apply)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Yield the subscriptions that an executor serves: all but those ``taken_directly``."""
        return (item for item in super().subscriptions if item not in self.taken_directly)

    def fail(self, reason: Exception) -> None:
        """End the node, and its process, for ``reason``."""
        self.failure, self.finished = reason, True

    def _declare(self) -> Any:
        # rclpy declares no override of an empty list, for it has no type
        given = {name: () if item.value is None else item.value
                 for name, item in self._parameter_overrides.items() if not is_foreign(name)}
        values = build(self._kind, given)
        for name, default, spec in declared(self._kind):
            value = values.flat()[name]
            self.declare_parameter(name, list(value) if isinstance(value, tuple) else value,
                                   descriptor(default, spec), ignore_override=True)
        return values

    def _merged(self, parameters: Iterable[Parameter]) -> Any:
        ours = {item.name: item.value for item in parameters if not is_foreign(item.name)}
        for name, _, spec in declared(self._kind):
            if spec.read_only and name in ours:
                raise refusal(name, ours[name], f'{self.parameters.flat()[name]!r}: read-only, '
                              'it is set where the node is started')
        return build(self._kind, self.parameters.flat() | ours)

    def _refuse(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._merged(parameters)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        self.parameters = self._merged(parameters)
        self.parameters_changed()

    def parameters_changed(self) -> None:
        """React to a new ``self.parameters``."""

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all or none; an integer given for a float is taken as a float."""
        try:
            merged = self._merged(parameter_list).flat()
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically([
            item if is_foreign(item.name)
            else Parameter(item.name, TYPES[type(merged[item.name])], merged[item.name])
            for item in parameter_list])


class PeerParameters:
    """
    All parameters of other nodes, read over their services without blocking.

    Call `poll` until it returns True; then ``values`` holds what the nodes that answered told,
    by full name and parameter, and ``silent`` names the others.
    """

    def __init__(self, node: Node) -> None:
        self.values: dict[str, dict[str, Any]] = {}
        self.silent: list[str] = []
        self._node, self._until, self._over = node, 0.0, False
        self._clients: dict[str, tuple[Client, Client]] = {}
        self._ask_at: dict[str, float] = {}

    def poll(self, peers: Collection[str]) -> bool:
        """Go on asking ``peers``, full names of nodes, '' for one that is not yet known."""
        now = monotonic()
        if not self._clients:
            if not peers or '' in peers:
                return False
            self._until = now + PATIENCE
            self._clients = {peer: self._client_pair(peer) for peer in peers}
        for peer, (names, values) in self._clients.items():
            if (peer not in self.values and now >= self._ask_at.get(peer, 0.0)
                    and names.service_is_ready() and values.service_is_ready()):
                self._ask_at[peer] = now + ASK_AGAIN
                names.call_async(ListParameters.Request()).add_done_callback(
                    partial(self._on_names, peer))
        self.silent = [peer for peer in self._clients if peer not in self.values]
        if self.silent and now < self._until:
            return False
        for client in chain.from_iterable(self._clients.values()):
            self._node.destroy_client(client)
        self._over = True
        return True

    def _client_pair(self, peer: str) -> tuple[Client, Client]:
        return (self._node.create_client(ListParameters, f'{peer}/list_parameters'),
                self._node.create_client(GetParameters, f'{peer}/get_parameters'))

    def _on_names(self, peer: str, future: Future) -> None:
        if self._over:  # the answer was on its way when the clients were destroyed
            return
        names = list(future.result().result.names)
        self._clients[peer][1].call_async(GetParameters.Request(names=names)).add_done_callback(
            partial(self._on_values, peer, names))

    def _on_values(self, peer: str, names: Sequence[str], future: Future) -> None:
        values = future.result().values
        if len(values) == len(names):  # else one has been undeclared meanwhile
            self.values[peer] = dict(zip(
                names, map(parameter_value_to_python, values), strict=True))
