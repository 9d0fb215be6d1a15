"""JointState to and from bytes, by layouts verified against rclpy's serializer."""

from collections.abc import Callable, Sequence
import math
from operator import itemgetter
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from impulse_control_ros.errors import MiddlewareError, UnreadableError
from impulse_control_ros.files.cdr import FIELDS, JointStateLayout, layout_in

PROBE = (1.5, -2.25, 3.0e-300)
FRAME_ID_AT = 12  # offset of its length, after encapsulation and stamp
MOST_KNOWN = 64
MOST_NAMED = 8
# a parsed frame_id, the decoder of such a message, and the selector of the values read
Known = tuple[Any, Callable[[bytes], Any], Callable[[Any], Any]]


def decode_any(
    raw: bytes, joint: str, fields: Sequence[str], optional: Sequence[str] = ()
) -> tuple[Any, ...]:
    """
    Decode any JointState, with several joints, another byte order, or any frame_id.

    Returns (frame_id, sec, nanosec, *values of ``fields`` and ``optional`` for ``joint``), nan
    for an empty optional field; raises `UnreadableError`.
    """
    try:
        message: Any = deserialize_message(raw, JointState)
    except Exception as error:  # rclpy raises its own type for invalid bytes
        raise UnreadableError(f'cannot be decoded ({error})') from None
    if joint not in message.name:
        others = ', '.join(message.name[:MOST_NAMED])
        raise UnreadableError(f'no joint {joint!r}, but {others or "none"}', is_normal=True)
    at, stamp = list(message.name).index(joint), message.header.stamp
    wanted = [*fields, *optional]
    empty = [field for field in optional if not len(getattr(message, field))]
    for field in wanted:
        if field not in empty and len(getattr(message, field)) <= at:
            raise UnreadableError(f'no {field} of joint {joint!r}')
    return (
        message.header.frame_id,
        stamp.sec,
        stamp.nanosec,
        *(math.nan if field in empty else getattr(message, field)[at] for field in wanted),
    )


class JointStateReader:
    """
    Reads ``fields`` and ``optional`` of ``joint``, and the frame_id by ``parse``.

    Messages with a known frame_id and layout are read by that layout, 30 times as fast.
    """

    def __init__(
        self,
        joint: str,
        parse: Callable[[str], Any],
        fields: Sequence[str],
        optional: Sequence[str] = (),
    ) -> None:
        self._joint, self._parse = joint, parse
        self._fields, self._optional = tuple(fields), tuple(optional)
        self._known: dict[bytes, Known] = {}
        self._recent: Known = None, lambda raw: None, tuple

    def read(self, raw: bytes) -> tuple[Any, tuple[Any, ...]]:
        """Return header and (sec, nanosec, *values); a missing optional value is nan."""
        header, decode, pick = self._recent
        values = decode(raw)
        return (header, pick(values)) if values is not None else self._read_other(raw)

    def _read_other(self, raw: bytes) -> tuple[Any, tuple[Any, ...]]:
        """Read a message whose layout differs from the last one; may raise `UnreadableError`."""
        size = raw[FRAME_ID_AT] if len(raw) > FRAME_ID_AT else 0
        key = raw[FRAME_ID_AT : FRAME_ID_AT + 4 + size]
        known = self._known.get(key)
        if known:
            header, decode, pick = known
            values = decode(raw)
            if values is not None:
                self._recent = known
                return header, pick(values)
        frame_id, *found = decode_any(raw, self._joint, self._fields, self._optional)
        known = self._parse(frame_id), *self._layout(raw)
        values = known[1](raw)
        # compared as text, since nan does not equal itself
        if values is not None and repr(list(known[2](values))) == repr(found):
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            self._recent = self._known[key] = known
        return known[0], tuple(found)

    def _layout(self, raw: bytes) -> tuple[Callable[[bytes], Any], Callable[[Any], Any]]:
        """Return the decoder of a message, and the selector of the fields read."""
        layout = layout_in(raw, self._joint)
        wanted = (*self._fields, *self._optional)
        if layout is None or not all(field in layout.fields for field in wanted):
            return lambda raw: None, tuple
        return layout.decode, itemgetter(
            0, 1, *(2 + layout.fields.index(field) for field in wanted)
        )


def verified_layout(joint: str, frame_id: str, fields: Sequence[str] = FIELDS) -> JointStateLayout:
    """Return a layout to write with; raises `MiddlewareError` if rclpy reads it differently."""
    layout = JointStateLayout(joint, frame_id, fields)
    values = PROBE[: len(fields)]
    raw = layout.encode(7, 999_999_999, *values)
    if decode_any(raw, joint, fields) != (frame_id, 7, 999_999_999, *values):
        raise MiddlewareError(
            'this middleware does not encode JointState as little-endian CDR: '
            'set RMW_IMPLEMENTATION=rmw_fastrtps_cpp'
        )
    return layout
