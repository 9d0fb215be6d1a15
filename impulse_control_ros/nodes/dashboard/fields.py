"""The form field of a parameter, from its ROS descriptor."""

from collections.abc import Mapping
import math
import re
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.parameter import Parameter
from yaml import YAMLError

from impulse_control_ros.files.yaml_file import parsed

UNIT = re.compile(r'(.*) \[([^\[\]]+)\]', re.DOTALL)
CHOICES = 'one of '
KINDS = {
    Parameter.Type.BOOL: 'switch',
    Parameter.Type.INTEGER: 'integer',
    Parameter.Type.DOUBLE: 'number',
    Parameter.Type.STRING: 'text',
}


def field_of(described: ParameterDescriptor, value: Any) -> dict[str, Any]:
    """Return the description of a parameter for the page, as JSON; an infinite bound is None."""
    kind = KINDS.get(Parameter.Type(described.type), 'list')
    found = UNIT.fullmatch(described.description)
    limits = [*described.floating_point_range, *described.integer_range]
    lower, upper = (limits[0].from_value, limits[0].to_value) if limits else (None, None)
    allowed = described.additional_constraints
    choices = allowed.removeprefix(CHOICES) if allowed.startswith(CHOICES) else ''
    return {
        'name': described.name,
        'kind': kind,
        'value': as_json(value),
        'description': found[1] if found else described.description,
        'unit': found[2] if found else '',
        'allowed': allowed,
        'lower': bound(lower),
        'upper': bound(upper),
        'choices': choices.split(', ') if choices else [],
        'read_only': described.read_only,
    }


def bound(value: float | None) -> float | None:
    """Return a bound of a slider; None if it stands for infinity."""
    return None if value is None or abs(value) > 1e6 else value


def as_json(value: Any) -> Any:
    """Return a parameter's value for JSON, with lists as plain lists and nan as None."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return [as_json(item) for item in value]


def value_of(text: str, before: Any) -> Any:
    """Return the value of a YAML text, for a parameter that has the value ``before`` now."""
    if isinstance(before, str):
        return text
    try:
        value = parsed(text)
    except YAMLError:
        return text
    return text if value is None else value


def law_of(values: Mapping[str, Any]) -> dict[str, float]:
    """Return the numbers among the parameters of a controller."""
    return {
        name: float(value)
        for name, value in values.items()
        if isinstance(value, (int, float)) and not isinstance(value, bool)
    }
