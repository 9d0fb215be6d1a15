"""The graph: topic names and qualities of service, and the proof that our CDR is rclpy's."""

from typing import Any

from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import FIELDS, JointStateLayout

JOINT_STATES = 'joint_states'
JOINT_COMMANDS = 'joint_commands'
IMPULSE_EVENTS = 'impulse_events'
SETPOINT = 'setpoint'
DAMPING = 'damping'
CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'
RECORDER_PROGRESS = 'recorder_progress'
RESET_MARK = 'reset'

# A joined recorder may be WINDOW states behind; the queues hold more, so none is overwritten.
WINDOW = 1000
SERIES_QOS = QoSProfile(depth=4 * WINDOW)
EVENT_QOS = QoSProfile(depth=4 * WINDOW)
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


def verified(layout: JointStateLayout) -> JointStateLayout:
    """
    Return ``layout`` once rclpy's own serializer agrees with it in both directions.

    Raises `RuntimeError` when it does not: then this middleware does not speak our CDR.
    """
    values = [1.5, -2.25, 3.0e-300][:len(layout.fields)]
    message: Any = deserialize_message(layout.encode(7, 999_999_999, *values), JointState)
    expected = JointState(name=[layout.joint])
    expected.header.stamp.sec, expected.header.stamp.nanosec = 7, 999_999_999
    expected.header.frame_id = layout.frame_id
    for field, value in zip(layout.fields, values, strict=True):
        setattr(expected, field, [value])
    if message != expected or layout.decode(serialize_message(expected)) != (
            7, 999_999_999, *values):
        raise RuntimeError(f'the CDR layout of JointState for joint {layout.joint!r} is not '
                           "that of this middleware's serializer")
    return layout


def state_layout(joint: str, mark: str = '') -> JointStateLayout:
    """Return the layout of joint_states; ``mark`` is the frame_id."""
    return verified(JointStateLayout(joint, mark))


def command_layout(joint: str) -> JointStateLayout:
    """Return the layout of joint_commands: effort alone."""
    return verified(JointStateLayout(joint, '', ('effort',)))


def event_layout(joint: str, guard: str) -> JointStateLayout:
    """Return the layout of impulse_events: position, velocity, and the area as effort."""
    return verified(JointStateLayout(joint, guard, FIELDS))
