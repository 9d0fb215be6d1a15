"""
ROS parameters from the parameter classes: declared, described and validated in one place.

rclpy checks type and range before any callback, and its reasons do not state the value. This
module therefore checks the whole set first and passes only a valid set to rclpy. The post-set
callback applies it as one new immutable value.
"""

from collections.abc import Iterable
import sys
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from impulse_control_ros.core.parameter import build, declared, Parameters, refusal, Spec
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import is_foreign
from impulse_control_ros.files.parameter_file import command_line_sections, merged, NAMES, names_of

TYPES = {
    float: Parameter.Type.DOUBLE,
    int: Parameter.Type.INTEGER,
    bool: Parameter.Type.BOOL,
    str: Parameter.Type.STRING,
    tuple: Parameter.Type.STRING_ARRAY,
}


def descriptor(default: Any, spec: Spec) -> ParameterDescriptor:
    """Return the descriptor that `ros2 param describe` shows."""
    unit = f' [{spec.unit}]' if spec.unit else ''
    made = ParameterDescriptor(
        type=TYPES[type(default)].value,
        description=spec.description + unit,
        additional_constraints=spec.allowed(type(default)),
        read_only=spec.read_only,
    )
    if spec.lower is not None or spec.upper is not None:
        largest = sys.float_info.max if isinstance(default, float) else 2**63 - 1
        lower = -largest if spec.lower is None else spec.lower
        upper = largest if spec.upper is None else spec.upper
        if isinstance(default, float):
            made.floating_point_range = [FloatingPointRange(from_value=lower, to_value=upper)]
        else:
            made.integer_range = [IntegerRange(from_value=int(lower), to_value=int(upper))]
    return made


def ros_value(value: Any) -> Any:
    """Return what rclpy takes for a value of `Parameters`."""
    return list(value) if isinstance(value, tuple) else value


class ParameterNode(Node):
    """
    A node with the parameters of one class; ``self.parameters`` has their current values.

    The constructor raises `ParameterError` for an override that is unknown, of a wrong type or out
    of bounds. Subclasses react to a new set in `parameters_changed`. ``finished`` is true once the
    node has nothing more to do; ``failure`` is the reason if it failed.
    """

    finished = False
    failure: Exception | None = None

    def __init__(self, name: str, kind: type[Parameters], **options: Any) -> None:
        super().__init__(name, **options)
        self._kind = kind
        try:
            self.parameters = self._declare()
        except ParameterError as error:
            self.destroy_node()
            raise ParameterError(f'{name}: {error}') from None
        self.add_on_set_parameters_callback(self._refuse)
        self.add_post_set_parameters_callback(self._apply)

    def fail(self, reason: Exception) -> None:
        """End the node, and its process, for ``reason``."""
        self.failure, self.finished = reason, True

    def _declare(self) -> Any:
        # the values are those of rcl, but these errors name the file
        merged(command_line_sections(sys.argv), self.get_fully_qualified_name(), self._kind)
        others = NAMES - names_of(self._kind)  # /** is for all nodes
        # rclpy does not declare an empty list override, which has no type
        given = {
            name: () if item.value is None else item.value
            for name, item in self._parameter_overrides.items()
            if not is_foreign(name) and name not in others
        }
        values = build(self._kind, given)
        for name, default, spec in declared(self._kind):
            self.declare_parameter(
                name,
                ros_value(values.flat()[name]),
                descriptor(default, spec),
                ignore_override=True,
            )
        return values

    def _merged(self, parameters: Iterable[Parameter]) -> Any:
        ours = {item.name: item.value for item in parameters if not is_foreign(item.name)}
        before = self.parameters.flat()
        merged = build(self._kind, before | ours)
        after = merged.flat()
        for name, _, spec in declared(self._kind):
            if spec.read_only and after[name] != before[name]:
                raise refusal(
                    name,
                    after[name],
                    f'{before[name]!r}: read-only, it is set where the node is started',
                )
        return merged

    def _refuse(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._merged(parameters)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        before, self.parameters = self.parameters.flat(), self._merged(parameters)
        changed = {
            name: value for name, value in self.parameters.flat().items() if value != before[name]
        }
        if changed:
            self.parameters_changed(changed)

    def parameters_changed(self, changed: dict[str, Any]) -> None:
        """React to the new ``self.parameters``; ``changed`` has the values that differ."""

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set all or none, converted as `build` does; read-only ones may be set as they are."""
        try:
            merged = self._merged(parameter_list).flat()
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        right = [
            item
            if is_foreign(item.name)
            else Parameter(item.name, TYPES[type(merged[item.name])], ros_value(merged[item.name]))
            for item in parameter_list
        ]
        settable = [item for item in right if not self._is_fixed(item)]
        if not settable:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(settable)

    def _is_fixed(self, item: Parameter) -> bool:
        """Tell whether a parameter is read-only and has this value."""
        if not (self.has_parameter(item.name) and self.describe_parameter(item.name).read_only):
            return False
        # rclpy takes an empty list for one of bytes, so the types may differ
        return bool(self.get_parameter(item.name).value == item.value)
