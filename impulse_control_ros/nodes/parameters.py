"""
ROS parameters from the parameter classes: declared, described and validated in one place.

rclpy checks type and range before any callback, with reasons that name no value; so the set is
checked here first, as a whole, and rclpy's own path is taken only by a set that is right. What
has been set is applied in the post-set callback, as one new immutable value.
"""

from collections.abc import Collection, Iterable, Iterator
import sys
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.subscription import Subscription
from rclpy.task import Future

from impulse_control_ros.core.parameter import build, declared, ParameterError, Parameters, Spec

TYPES = {float: Parameter.Type.DOUBLE, int: Parameter.Type.INTEGER, bool: Parameter.Type.BOOL,
         str: Parameter.Type.STRING, tuple: Parameter.Type.STRING_ARRAY}
FOREIGN = ('use_sim_time', 'start_type_description_service')
FOREIGN_PREFIX = 'qos_overrides.'


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


def is_foreign(name: str) -> bool:
    """Tell whether a parameter belongs to rclpy itself."""
    return name in FOREIGN or name.startswith(FOREIGN_PREFIX)


class ParameterNode(Node):
    """
    A node whose parameters are those of one class; ``self.parameters`` is its present value.

    Raises `ParameterError` at birth for an override that is unknown, of a wrong type or out of
    bounds. Subclasses react to a new set in `parameters_changed`.
    """

    def __init__(self, name: str, kind: type[Parameters], **options: Any) -> None:
        self.taken_directly: Collection[Subscription] = ()
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        self._kind = kind
        try:
            self.parameters = self._declare()
        except ParameterError:
            self.destroy_node()
            raise
        self.add_on_set_parameters_callback(self._refuse)
        self.add_post_set_parameters_callback(self._apply)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Yield the subscriptions that an executor serves: all but those ``taken_directly``."""
        return (item for item in super().subscriptions if item not in self.taken_directly)

    def _declare(self) -> Any:
        given = [name for name in self.list_parameters([], 0).names if not is_foreign(name)]
        values = build(self._kind, {name: self.get_parameter(name).value for name in given})
        for name in given:
            self.undeclare_parameter(name)
        for name, default, spec in declared(self._kind):
            value = values.flat()[name]
            self.declare_parameter(name, list(value) if isinstance(value, tuple) else value,
                                   descriptor(default, spec), ignore_override=True)
        return values

    def _merged(self, parameters: Iterable[Parameter]) -> Any:
        ours = {item.name: item.value for item in parameters if not is_foreign(item.name)}
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
        refused = self._refuse(parameter_list)
        if not refused.successful:
            return refused
        merged = self._merged(parameter_list).flat()
        return super().set_parameters_atomically([
            item if is_foreign(item.name)
            else Parameter(item.name, TYPES[type(merged[item.name])], merged[item.name])
            for item in parameter_list])


class ParameterReading:
    """
    All parameters of another node, read over its services without blocking.

    Call `poll` until ``values`` is filled (or patience ends), then `close`.
    """

    def __init__(self, node: Node, target: str) -> None:
        self.values: dict[str, Any] = {}
        self._node = node
        self._names = node.create_client(ListParameters, f'{target}/list_parameters')
        self._values = node.create_client(GetParameters, f'{target}/get_parameters')
        self._asked = False

    def poll(self) -> None:
        """Ask once both services are there."""
        if not self._asked and self._names.service_is_ready() and self._values.service_is_ready():
            self._asked = True
            self._names.call_async(ListParameters.Request()).add_done_callback(self._on_names)

    def _on_names(self, future: Future) -> None:
        names = list(future.result().result.names)
        self._values.call_async(GetParameters.Request(names=names)).add_done_callback(
            lambda got: self.values.update(zip(
                names, map(parameter_value_to_python, got.result().values), strict=True)))

    def close(self) -> None:
        """Destroy the clients."""
        self._node.destroy_client(self._names)
        self._node.destroy_client(self._values)
