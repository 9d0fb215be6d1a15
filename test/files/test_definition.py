"""Message definitions and hashes, against those of rosbags."""

import pytest
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from impulse_control_ros.files.definition import message_definition, type_hash

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = [
    'sensor_msgs/msg/JointState',
    'std_msgs/msg/Float64',
    'rosgraph_msgs/msg/Clock',
    'rcl_interfaces/msg/ParameterEvent',
    'diagnostic_msgs/msg/DiagnosticArray',
]


@pytest.mark.parametrize('name', TYPES)
def test_a_definition_holds_the_type_and_all_it_needs(name):
    parsed = get_types_from_msg(message_definition(name), name)
    fresh = get_typestore(Stores.EMPTY)
    fresh.register(parsed)
    assert name in fresh.types
    assert fresh.hash_rihs01(name) == STORE.hash_rihs01(name)


@pytest.mark.parametrize('name', TYPES)
def test_the_hash_is_that_of_ros(name):
    assert type_hash(name) == STORE.hash_rihs01(name)


def test_dependencies_stand_behind_separators_once():
    text = message_definition('diagnostic_msgs/msg/DiagnosticArray')
    assert text.count('=' * 80 + '\nMSG: std_msgs/Header\n') == 1
    assert text.count('=' * 80 + '\n') == 4


def test_an_unknown_type_is_named():
    with pytest.raises(FileNotFoundError, match='no_msgs/msg/Thing.msg'):
        message_definition('no_msgs/msg/Thing')
