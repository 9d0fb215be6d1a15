"""
JointState as CDR bytes: a fixed layout packed and read at known offsets.

The frame_id and the filled fields determine the layout of a JointState of one joint: constant
bytes, a stamp at offset 4, and doubles at offsets that follow from CDR's alignment (relative to
the end of the 4-byte encapsulation, little endian). Padding is written as zero and ignored on
reading: other writers leave it uninitialised, and rclpy's serializer may append unused bytes.
"""

from collections.abc import Sequence
import struct
from typing import Any

import numpy as np

from impulse_control_ros.core.tick import to_ns

FIELDS = ('position', 'velocity', 'effort')
COMMANDED = ('effort',)
WITHOUT_VELOCITY = ('position', 'effort')  # of a sensor that measures positions only
LITTLE_ENDIAN_CDR = b'\x00\x01\x00\x00'
BIG_ENDIAN = b'\x00\x00'
_FRAME_ID_AT = 12  # behind the stamp
_HEADER = struct.Struct('<4sIII')  # stamp, and the length of the string behind it


class CdrWriter:
    """
    A CDR message under construction: its ``data`` and a ``mask``.

    The mask is 0 for padding and for values to be filled in later, and 255 elsewhere.
    """

    def __init__(self) -> None:
        self.data, self.mask = bytearray(LITTLE_ENDIAN_CDR), bytearray(b'\xff' * 4)

    def _append(self, data: bytes, is_constant: bool) -> None:
        self.data += data
        self.mask += (b'\xff' if is_constant else b'\x00') * len(data)

    def put(self, code: str, value: float | None = None) -> int:
        """Append a number of this `struct` code, or room for one; return its offset."""
        size = struct.calcsize('<' + code)
        self._append(bytes((4 - len(self.data)) % size), False)
        self._append(struct.pack('<' + code, value or 0), value is not None)
        return len(self.data) - size

    def put_string(self, text: str) -> None:
        """Append a string."""
        self._append(bytes(-len(self.data) % 4), False)
        self._append(string(text), True)


class JointStateLayout:
    """
    The layout for one joint: ``fields`` are filled with one value, the others left empty.

    The values of other ``joints`` in the message are written as 0 and ignored on reading.
    ``encode(sec, nanosec, *values)`` returns bytes. ``decode(raw)`` returns (sec, nanosec,
    *values), with values in the order of ``fields``, or None if ``raw`` has another layout.
    ``dtype`` is the dtype of a ``message`` as a record of these values.
    """

    def __init__(
        self,
        joint: str,
        frame_id: str = '',
        fields: Sequence[str] = FIELDS,
        joints: Sequence[str] = (),
    ) -> None:
        self.joint, self.frame_id, self.fields = joint, frame_id, tuple(fields)
        self.joints = tuple(joints) or (joint,)
        message = CdrWriter()
        places = [message.put('I'), message.put('I')]
        message.put_string(frame_id)
        message.put('I', len(self.joints))
        for name in self.joints:
            message.put_string(name)
        for field in FIELDS:
            values = self.joints if field in fields else ()
            message.put('I', len(values))
            places += [message.put('d') for _ in values][self.joints.index(joint) :][:1]
        self.message, self._mask = bytes(message.data), bytes(message.mask)
        self._constant = int.from_bytes(self.message, 'little')
        self._check = int.from_bytes(self._mask, 'little')
        names, codes = ('sec', 'nanosec', *self.fields), 'II' + 'd' * len(self.fields)
        self.dtype = np.dtype(
            {
                'names': names,
                'formats': [f'<{code}' for code in codes],
                'offsets': places,
                'itemsize': len(self.message),
            }
        )
        form, written = '<', 0
        self._pieces: list[Any] = []
        for at, code in zip(places, codes, strict=True):
            form += f'{at - written}s{code}'
            self._pieces += [self.message[written:at], 0]
            written = at + struct.calcsize(code)
        self._pieces.append(self.message[written:])
        form += f'{len(self._pieces[-1])}s'
        self._packed, self._read = struct.Struct(form), struct.Struct(form.replace('s', 'x'))

    def encode(self, sec: int, nanosec: int, *values: float) -> bytes:
        """Return the message."""
        pieces = self._pieces
        pieces[1], pieces[3] = sec, nanosec
        pieces[5:-1:2] = values
        return self._packed.pack(*pieces)

    def decode(self, raw: bytes) -> tuple[Any, ...] | None:
        """Return (sec, nanosec, *values), or None for another layout."""
        size = len(self.message)
        if len(raw) < size or (
            int.from_bytes(raw[:size], 'little') & self._check != self._constant
        ):
            return None
        return self._read.unpack_from(raw)

    def decode_rows(self, rows: np.ndarray) -> list[np.ndarray]:
        """
        Return (whether a row has this layout, sec, nanosec, *values), each of shape (n,).

        ``rows``, shape (n, size), are the bytes of n messages of one size. The values of rows with
        another layout are meaningless.
        """
        if rows.shape[1] < len(self.message):
            return [np.zeros(len(rows), bool), *np.zeros((2 + len(self.fields), len(rows)))]
        front = np.ascontiguousarray(rows[:, : len(self.message)])
        mask, message = (np.frombuffer(item, np.uint8) for item in (self._mask, self.message))
        values = front.view(self.dtype)[:, 0]
        good = (front & mask == message).all(axis=1)
        return [good, *(values[name] for name in self.dtype.names or ())]


def encode_rows(
    message: bytes, dtype: np.dtype[Any], values: Sequence[np.ndarray], room: int
) -> np.ndarray:
    """Return n rows: ``room`` free bytes, then the ``message`` with its row of ``values``."""
    rows = np.empty((len(values[0]), room + len(message)), np.uint8)
    rows[:, room:] = np.frombuffer(message, np.uint8)
    records = rows[:, room:].view(dtype)[:, 0]
    for name, value in zip(dtype.names or (), values, strict=True):
        records[name] = value
    return rows


def layout_in(raw: bytes, joint: str | None = None) -> JointStateLayout | None:
    """
    Return the layout of a message for ``joint`` (its first if None), or None if there is none.

    Each field must be empty or have a value for each joint.
    """
    try:
        frame_id, joints, sizes = _parsed(raw)
    except (struct.error, UnicodeDecodeError):
        return None
    wanted = joints[0] if joint is None and joints else joint
    filled = [field for field, size in sizes.items() if size]
    layout = JointStateLayout(wanted, frame_id, filled, joints) if wanted in joints else None
    return layout if layout and layout.decode(raw) else None


def why_unreadable(raw: bytes) -> str:
    """Return why `layout_in` finds no layout in a message."""
    if raw[:2] == BIG_ENDIAN:
        return 'they are big-endian CDR; little-endian is read'
    if raw[:4] != LITTLE_ENDIAN_CDR:
        return f'they begin with {raw[:4].hex() or "nothing"}, which is no plain CDR'
    try:
        _, joints, sizes = _parsed(raw)
    except (struct.error, UnicodeDecodeError):
        return 'they are no JointState, or cut off'
    for field, size in sizes.items():
        if size not in (0, len(joints)):
            return f'{field} has {size} values for {len(joints)} joints'
    return 'they are cut off' if joints else 'they name no joint'


def _parsed(raw: bytes) -> tuple[str, list[str], dict[str, int]]:
    """Return the frame_id, the joints, and the number of values of each field, of a message."""
    frame_id, at = _string_at(raw, _FRAME_ID_AT)
    count, at = _count_at(raw, at)
    joints, sizes = [], {}
    for _ in range(count):
        name, at = _string_at(raw, at)
        joints.append(name)
    for field in FIELDS:
        sizes[field], at = _count_at(raw, at)
        if sizes[field]:
            at += (4 - at) % 8 + 8 * sizes[field]
    return frame_id, joints, sizes


def _count_at(raw: bytes, at: int) -> tuple[int, int]:
    """Return the count at or after offset ``at``, and its end."""
    at += -at % 4
    return struct.unpack_from('<I', raw, at)[0], at + 4


def _string_at(raw: bytes, at: int) -> tuple[str, int]:
    """Return the string at or after offset ``at``, and its end."""
    size, at = _count_at(raw, at)
    return raw[at : at + size - 1].decode(), at + size


def string(text: str) -> bytes:
    """Return a string in CDR: its length, its bytes, a zero."""
    data = text.encode() + b'\x00'
    return struct.pack('<I', len(data)) + data


def read_header(raw: bytes) -> tuple[int, bytes]:
    """
    Return the stamp [ns] and the string after it, with which many messages begin.

    In a message with a header, the string is the frame_id. A stamp of 0 means no stamp.
    """
    if len(raw) < _HEADER.size or raw[:4] != LITTLE_ENDIAN_CDR:
        return 0, b''
    _, sec, nanosec, size = _HEADER.unpack_from(raw)
    return to_ns(sec, nanosec), raw[_HEADER.size : _HEADER.size + size - 1]


def encode_header(sec: int, nanosec: int, frame_id: str) -> bytes:
    """Return a std_msgs/Header."""
    return LITTLE_ENDIAN_CDR + struct.pack('<II', sec, nanosec) + string(frame_id)


def encode_time(sec: int, nanosec: int) -> bytes:
    """Return a rosgraph_msgs/Clock (or a builtin_interfaces/Time)."""
    return LITTLE_ENDIAN_CDR + struct.pack('<II', sec, nanosec)


FLOAT64 = np.dtype({'names': ['data'], 'formats': ['<f8'], 'offsets': [4], 'itemsize': 12})


def encode_float64(value: float) -> bytes:
    """Return a std_msgs/Float64."""
    return LITTLE_ENDIAN_CDR + struct.pack('<d', value)


def encode_float64_array(values: Sequence[float]) -> bytes:
    """Return a std_msgs/Float64MultiArray of at least one value, without named dimensions."""
    return LITTLE_ENDIAN_CDR + struct.pack(f'<III4x{len(values)}d', 0, 0, len(values), *values)
