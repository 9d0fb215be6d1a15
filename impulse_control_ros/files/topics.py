"""The topics of a run: names, types, and the quality of service offered by their publishers."""

from collections.abc import Mapping
from typing import Any

from impulse_control_ros.files.parameter_event import TYPE as PARAMETER_EVENT

JOINT_STATES = 'joint_states'
IMPULSE_EVENTS = 'impulse_events'
JOINT_COMMANDS = 'joint_commands'
EFFORT_COMMANDS = 'effort_commands'
THROTTLED_STATES = 'joint_states_throttled'
RUN_PARAMETERS = 'run_parameters'
PARAMETER_EVENTS = '/parameter_events'
DAMPING = 'damping'
SETPOINT = 'setpoint'
RECORDER_PROGRESS = 'recorder_progress'
CLOCK = '/clock'
DIAGNOSTICS = '/diagnostics'

JOINT_STATE = 'sensor_msgs/msg/JointState'
FLOAT64 = 'std_msgs/msg/Float64'
# every bag has these topics, in this order; their messages begin with a stamp
SERIES = {
    JOINT_STATES: JOINT_STATE,
    IMPULSE_EVENTS: JOINT_STATE,
    JOINT_COMMANDS: JOINT_STATE,
    RUN_PARAMETERS: PARAMETER_EVENT,
}

SERIES_DEPTH = 4000  # a recorder may be WINDOW states behind; none is overwritten
SLOW_DEPTH = 100
FOR_EVER = {'sec': 9223372036, 'nsec': 854775807}


def offered(depth: int = SERIES_DEPTH, latched: bool = False) -> Mapping[str, Any]:
    """Return the nine keys of a publisher in rosbag2's ``offered_qos_profiles``, version 9."""
    return {
        'history': 'keep_last',
        'depth': depth,
        'reliability': 'reliable',
        'durability': 'transient_local' if latched else 'volatile',
        'deadline': dict(FOR_EVER),
        'lifespan': dict(FOR_EVER),
        'liveliness': 'automatic',
        'liveliness_lease_duration': dict(FOR_EVER),
        'avoid_ros_namespace_conventions': False,
    }


def offered_on(topic: str) -> Mapping[str, Any]:
    """Return the quality of service that our publisher of a topic offers."""
    return offered(SLOW_DEPTH, latched=True) if topic == RUN_PARAMETERS else offered()
