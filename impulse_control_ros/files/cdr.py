"""
JointState as CDR bytes: a fixed layout packed and read at known offsets.

A JointState of one joint always has the same shape once its frame_id and the filled fields are
known: constant bytes, a stamp at offset 4, and doubles at offsets that follow from CDR's
alignment (relative to the end of the 4-byte encapsulation, little endian). Padding is zero in
what we write and ignored in what we read: other writers leave it uninitialised, and rclpy's
serializer may append unused bytes.
"""

from collections.abc import Sequence
import struct
from typing import Any

import numpy as np

from impulse_control_ros.core.tick import SECOND

FIELDS = ('position', 'velocity', 'effort')
COMMANDED = ('effort',)
WITHOUT_VELOCITY = ('position', 'effort')  # of a sensor that measures positions only
LITTLE_ENDIAN_CDR = b'\x00\x01\x00\x00'
_FRAME_ID_AT = 12  # behind the stamp
_HEADER = struct.Struct('<4sIII')  # stamp, and the length of the string behind it


class JointStateLayout:
    """
    The layout for one joint: ``fields`` are filled with one value, the others left empty.

    Where the message has other ``joints`` beside it, theirs are 0, and ignored in what is read.
    ``encode(sec, nanosec, *values)`` returns bytes; ``decode(raw)`` returns
    (sec, nanosec, *values), values in the order of ``fields``, or None when ``raw`` has another
    layout.
    """

    def __init__(
        self,
        joint: str,
        frame_id: str = '',
        fields: Sequence[str] = FIELDS,
        joints: Sequence[str] = (),
    ) -> None:
        self.joint, self.frame_id, self.fields = joint, frame_id, tuple(fields)
        self._joints = tuple(joints) or (joint,)
        self._message, self._mask = bytearray(), bytearray()
        self._format: list[str] = []
        self._pieces: list[Any] = []
        self._at: list[tuple[int, str]] = []
        self._written = 0
        self._lay_out()
        self.size = len(self._message)
        self._constant = int.from_bytes(self._message, 'little')
        self._check = int.from_bytes(self._mask, 'little')
        self._packed = struct.Struct('<' + ''.join(self._format))
        self._read = struct.Struct('<' + ''.join(self._format).replace('s', 'x'))

    def _put(self, data: bytes, constant: bool) -> None:
        self._message += data
        self._mask += (b'\xff' if constant else b'\x00') * len(data)

    def _align(self, size: int) -> None:
        self._put(b'\x00' * ((4 - len(self._message)) % size), constant=False)

    def _put_count(self, count: int) -> None:
        self._align(4)
        self._put(struct.pack('<I', count), constant=True)

    def _put_string(self, text: str) -> None:
        self._align(4)
        self._put(string(text), constant=True)

    def _put_variable(self, code: str) -> None:
        """Leave room for one value, and pack what came before it as a constant."""
        constant = bytes(self._message[self._written :])
        self._at.append((len(self._message), {'I': '<u4', 'd': '<f8'}[code]))
        self._put(bytes(struct.calcsize('<' + code)), constant=False)
        self._format += [f'{len(constant)}s', code]
        self._pieces += [constant, 0]
        self._written = len(self._message)

    def _lay_out(self) -> None:
        self._put(LITTLE_ENDIAN_CDR, constant=True)
        self._put_variable('I')
        self._put_variable('I')
        self._put_string(self.frame_id)
        self._put_count(len(self._joints))
        for name in self._joints:
            self._put_string(name)
        for field in FIELDS:
            filled = field in self.fields
            self._put_count(len(self._joints) if filled else 0)
            if filled:
                self._align(8)
                self._put_values()
        trailer = bytes(self._message[self._written :])
        self._format.append(f'{len(trailer)}s')
        self._pieces.append(trailer)

    def _put_values(self) -> None:
        """Leave room for the value of the joint, among those of the others."""
        at = self._joints.index(self.joint)
        self._put(bytes(8 * at), constant=False)
        self._put_variable('d')
        self._put(bytes(8 * (len(self._joints) - at - 1)), constant=False)

    def encode(self, sec: int, nanosec: int, *values: float) -> bytes:
        """Return the message."""
        pieces = self._pieces
        pieces[1], pieces[3] = sec, nanosec
        pieces[5:-1:2] = values
        return self._packed.pack(*pieces)

    def decode(self, raw: bytes) -> tuple[Any, ...] | None:
        """Return (sec, nanosec, *values), or None for another layout."""
        if len(raw) < self.size or (
            int.from_bytes(raw[: self.size], 'little') & self._check != self._constant
        ):
            return None
        return self._read.unpack_from(raw)

    def decode_rows(self, rows: np.ndarray) -> list[np.ndarray]:
        """
        Return (whether it has this layout, sec, nanosec, *values), each of shape (n,).

        ``rows`` of shape (n, size) are the bytes of n messages of one size; what `decode` takes
        for none has meaningless values.
        """
        count, size = rows.shape
        if size < self.size:
            return [np.zeros(count, bool), *np.zeros((len(self._at), count))]
        front = rows[:, : self.size]
        mask, message = (np.frombuffer(item, np.uint8) for item in (self._mask, self._message))
        good = (front & mask == message).all(axis=1)
        return [
            good,
            *(
                front[:, at : at + np.dtype(code).itemsize].copy().view(code)[:, 0]
                for at, code in self._at
            ),
        ]


def layout_in(raw: bytes, joint: str) -> JointStateLayout | None:
    """
    Return the layout of any message of a ``joint``, alone or among others; None for no such one.

    Each field is to be empty, or to have a value for each joint.
    """
    try:
        frame_id, at = _string_at(raw, _FRAME_ID_AT)
        count, at = _count_at(raw, at)
        joints = []
        for _ in range(count):
            name, at = _string_at(raw, at)
            joints.append(name)
        filled = []
        for field in FIELDS:
            values, at = _count_at(raw, at)
            if values:
                at += (4 - at) % 8 + 8 * values
                filled.append(field)
    except (struct.error, UnicodeDecodeError):
        return None
    layout = JointStateLayout(joint, frame_id, filled, joints) if joint in joints else None
    return layout if layout and layout.decode(raw) else None


def _count_at(raw: bytes, at: int) -> tuple[int, int]:
    """Return the count that stands at, or after, ``at``, and the end of it."""
    at += -at % 4
    return struct.unpack_from('<I', raw, at)[0], at + 4


def _string_at(raw: bytes, at: int) -> tuple[str, int]:
    """Return the string that stands at, or after, ``at``, and the end of it."""
    size, at = _count_at(raw, at)
    return raw[at : at + size - 1].decode(), at + size


def string(text: str) -> bytes:
    """Return a string as it stands in CDR: its length, its bytes, a zero."""
    data = text.encode() + b'\x00'
    return struct.pack('<I', len(data)) + data


def read_header(raw: bytes) -> tuple[int, bytes]:
    """
    Return the stamp [ns] and the string behind it, which many messages begin with.

    For a message with a header that string is the frame_id. A stamp of 0 is none.
    """
    if len(raw) < _HEADER.size or raw[:4] != LITTLE_ENDIAN_CDR:
        return 0, b''
    _, sec, nanosec, size = _HEADER.unpack_from(raw)
    return sec * SECOND + nanosec, raw[_HEADER.size : _HEADER.size + size - 1]


def encode_header(sec: int, nanosec: int, frame_id: str) -> bytes:
    """Return a std_msgs/Header."""
    return LITTLE_ENDIAN_CDR + struct.pack('<II', sec, nanosec) + string(frame_id)


def encode_time(sec: int, nanosec: int) -> bytes:
    """Return a rosgraph_msgs/Clock (or a builtin_interfaces/Time)."""
    return LITTLE_ENDIAN_CDR + struct.pack('<II', sec, nanosec)


def encode_float64(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return LITTLE_ENDIAN_CDR + struct.pack('<d', value)
