"""
rcl_interfaces/ParameterEvent as CDR bytes for run_parameters, written without ROS.

An event lists all parameters of its node in ``new_parameters`` and repeats those just changed in
``changed_parameters``. Its stamp is the stamp of the first state that the parameters apply to.
"""

from collections.abc import Callable, Mapping
from typing import Any

from impulse_control_ros.core.parameter import RENAMED
from impulse_control_ros.files.cdr import CdrWriter

TYPE = 'rcl_interfaces/msg/ParameterEvent'
# field of rcl_interfaces/ParameterValue by type, for the types of our parameters
FIELDS = {
    1: 'bool_value',
    2: 'integer_value',
    3: 'double_value',
    4: 'string_value',
    9: 'string_array_value',
}
_TYPES = {bool: 1, int: 2, float: 3, str: 4, tuple: 9, list: 9}


def _put_parameter(message: CdrWriter, name: str, value: Any) -> None:
    kind = _TYPES[type(value)]
    message.put_string(name)
    message.put('B', kind)
    message.put('?', value if kind == 1 else False)
    message.put('q', value if kind == 2 else 0)
    message.put('d', value if kind == 3 else 0.0)
    message.put_string(value if kind == 4 else '')
    for _ in ('byte', 'bool', 'integer', 'double'):
        message.put('I', 0)
    items = value if kind == 9 else ()
    message.put('I', len(items))
    for item in items:
        message.put_string(item)


def encode_parameter_event(
    sec: int, nanosec: int, node: str, parameters: Mapping[str, Any], changed: Mapping[str, Any]
) -> bytes:
    """Return the event of ``node`` with all its ``parameters``, of which some are ``changed``."""
    message = CdrWriter()
    message.put('i', sec)
    message.put('I', nanosec)
    message.put_string(node)
    for values in (parameters, changed, {}):
        message.put('I', len(values))
        for name, value in values.items():
            _put_parameter(message, name, value)
    return bytes(message.data)


def decode_parameter_event(
    raw: bytes, decode: Callable[[bytes], Any]
) -> tuple[int, int, str, dict[str, Any], dict[str, Any]]:
    """
    Return (sec, nanosec, node, parameters, changed) of an event, by their present names.

    ``decode``, from rclpy or mcap, turns the bytes into an object with the message's fields.
    """
    event = decode(raw)
    parameters, changed = (
        {
            RENAMED.get(one.name, one.name): getattr(one.value, FIELDS[one.value.type])
            for one in values
            if one.value.type in FIELDS
        }
        for values in (event.new_parameters, event.changed_parameters)
    )
    return event.stamp.sec, event.stamp.nanosec, event.node, parameters, changed
