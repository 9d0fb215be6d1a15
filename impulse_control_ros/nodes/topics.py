"""The graph: topic names and qualities of service, and the proof that our CDR is rclpy's."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import COMMANDED, FIELDS, JointStateLayout
from impulse_control_ros.files.columns import BagError

JOINT_STATES = 'joint_states'
JOINT_COMMANDS = 'joint_commands'
IMPULSE_EVENTS = 'impulse_events'
SETPOINT = 'setpoint'
DAMPING = 'damping'
CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'
RECORDER_PROGRESS = 'recorder_progress'

# A joined recorder may be WINDOW states behind; the queues hold more, so none is overwritten.
WINDOW = 1000
SERIES_QOS = QoSProfile(depth=4 * WINDOW)  # at most one message a sample
SLOW_QOS = QoSProfile(depth=100)


def qos_keys(qos: QoSProfile) -> dict[str, Any]:
    """Return the nine keys of rosbag2's ``offered_qos_profiles``, version 9."""
    def duration(value: Any) -> dict[str, int]:
        sec, nanosec = divmod(value.nanoseconds, SECOND)
        return {'sec': sec, 'nsec': nanosec}

    return {
        'history': qos.history.short_key, 'depth': qos.depth,
        'reliability': qos.reliability.short_key, 'durability': qos.durability.short_key,
        'deadline': duration(qos.deadline), 'lifespan': duration(qos.lifespan),
        'liveliness': qos.liveliness.short_key,
        'liveliness_lease_duration': duration(qos.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': qos.avoid_ros_namespace_conventions}


def message_class(kind: str) -> type:
    """Return the class of pkg/msg/Name; raises `BagError` where it is not installed."""
    package, _, name = kind.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, ValueError):
        raise BagError(f'message type {kind!r} is not installed') from None


class UnreadableError(Exception):
    """A JointState that does not say what is asked of it; the message says why."""


def decode_any(raw: bytes, joint: str, fields: Sequence[str], optional: Sequence[str] = (),
               ) -> tuple[Any, ...]:
    """
    Decode any JointState: of several joints, in another byte order, with any frame_id.

    Returns (sec, nanosec, frame_id, *values of ``fields`` and ``optional`` for ``joint``), None
    for an optional one that is empty; raises `UnreadableError`.
    """
    try:
        message: Any = deserialize_message(raw, JointState)
    except Exception as error:  # rclpy raises its own type for bytes that are no message
        raise UnreadableError(f'that cannot be decoded ({error})') from None
    if joint not in message.name:
        raise UnreadableError(f'without joint {joint!r}')
    at, stamp = list(message.name).index(joint), message.header.stamp
    wanted = [*fields, *optional]
    empty = [field for field in optional if not len(getattr(message, field))]
    for field in wanted:
        if field not in empty and len(getattr(message, field)) <= at:
            raise UnreadableError(f'without {field} of joint {joint!r}')
    return (stamp.sec, stamp.nanosec, message.header.frame_id,
            *(None if field in empty else getattr(message, field)[at] for field in wanted))


class TypedLayout:
    """`JointStateLayout` by rclpy's own serializer: right on any middleware, ten times slower."""

    def __init__(self, joint: str, frame_id: str, fields: Sequence[str]) -> None:
        self._message = JointState(name=[joint])
        self._message.header.frame_id = frame_id
        self._fields = tuple(fields)

    def encode(self, sec: int, nanosec: int, *values: float) -> bytes:
        """Return the message."""
        self._message.header.stamp.sec, self._message.header.stamp.nanosec = sec, nanosec
        for field, value in zip(self._fields, values, strict=True):
            setattr(self._message, field, [value])
        return bytes(serialize_message(self._message))

    def decode(self, raw: bytes) -> tuple[Any, ...] | None:
        """Return (sec, nanosec, *values), or None for another layout."""
        try:
            message: Any = deserialize_message(raw, JointState)
        except Exception:  # rclpy raises its own type for bytes that are no message
            return None
        filled = tuple(field for field in FIELDS if len(getattr(message, field)) == 1)
        if (filled, message.name, message.header.frame_id) != (
                self._fields, self._message.name, self._message.header.frame_id):
            return None
        return (message.header.stamp.sec, message.header.stamp.nanosec,
                *(getattr(message, field)[0] for field in filled))


def verified(fast: JointStateLayout, logger: Any) -> JointStateLayout | TypedLayout:
    """
    Return ``fast`` when rclpy's own serializer agrees with it in both directions.

    Else the middleware does not speak our CDR: one error line, and a `TypedLayout`.
    """
    slow = TypedLayout(fast.joint, fast.frame_id, fast.fields)
    values = (1.5, -2.25, 3.0e-300)[:len(fast.fields)]
    probe = (7, 999_999_999, *values)
    if (slow.decode(fast.encode(7, 999_999_999, *values)) == probe
            == fast.decode(slow.encode(7, 999_999_999, *values))):
        return fast
    logger.error(f'the CDR of JointState for joint {fast.joint!r} is not what this middleware '
                 'writes: messages are converted one by one, which is slower')
    return slow


def state_layout(joint: str, logger: Any, mark: str = '', fields: Sequence[str] = FIELDS,
                 ) -> JointStateLayout | TypedLayout:
    """Return the layout of joint_states; ``mark`` is the frame_id."""
    return verified(JointStateLayout(joint, mark, fields), logger)


def command_layouts(joint: str, logger: Any) -> list[JointStateLayout | TypedLayout]:
    """Return the layout of joint_commands for each of `GUARDS`: effort alone."""
    return [verified(JointStateLayout(joint, guard, COMMANDED), logger) for guard in GUARDS]


def event_layouts(joint: str, logger: Any) -> list[JointStateLayout | TypedLayout]:
    """Return those of impulse_events for each: position, velocity, and the area as effort."""
    return [verified(JointStateLayout(joint, guard), logger) for guard in GUARDS]
