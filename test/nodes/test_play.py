"""A bag played by rosbag2 reaches our nodes: what it would offer, against what they request."""

import pytest
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    qos_check_compatible,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
)
import yaml

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.nodes.topics import qos_keys
from test.conftest import CONFIG

NEEDED = {('controller', '/joint_states'), ('controller', '/setpoint'),
          ('plant_simulator', '/joint_commands'), ('recorder', '/joint_states'),
          ('recorder', '/joint_commands'), ('recorder', '/impulse_events'),
          ('recorder', '/damping')}
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
UNRECORDED = {'reliability': 'reliable', 'durability': 'volatile', 'deadline': FOREVER,
              'lifespan': FOREVER, 'liveliness': 'automatic',
              'liveliness_lease_duration': FOREVER, 'avoid_ros_namespace_conventions': False}


def profile(keys):
    """Return the QoS of nine keys as they stand in metadata.yaml, without its history."""
    def duration(time):
        return Duration(nanoseconds=time['sec'] * SECOND + time['nsec'])

    return QoSProfile(
        depth=10, reliability=ReliabilityPolicy.get_from_short_key(keys['reliability']),
        durability=DurabilityPolicy.get_from_short_key(keys['durability']),
        deadline=duration(keys['deadline']), lifespan=duration(keys['lifespan']),
        liveliness=LivelinessPolicy.get_from_short_key(keys['liveliness']),
        liveliness_lease_duration=duration(keys['liveliness_lease_duration']),
        avoid_ros_namespace_conventions=keys['avoid_ros_namespace_conventions'])


def offered_by_play(profiles):
    """Return what rosbag2's player offers: the recorded profile where all are the same."""
    assert all(one == profiles[0] for one in profiles)
    return profile(profiles[0] if profiles else UNRECORDED)


@pytest.fixture
def offers(recorded):
    content = yaml.safe_load((recorded / 'left' / 'metadata.yaml').read_text())
    return {topic['topic_metadata']['name'].removeprefix('/left'): topic['topic_metadata'][
        'offered_qos_profiles']
        for topic in content['rosbag2_bagfile_information']['topics_with_message_count']}


def test_play_offers_every_node_what_it_requests(offers, graph, client):
    process = graph.start('closed_loop', '--ros-args', '-p', f'recorder:bag:={graph.folder}/bag',
                          config=CONFIG / 'axis.yaml')

    def requests():
        return {(end.node_name, topic): end.qos_profile for topic in offers
                for end in client.node.get_subscriptions_info_by_topic(topic)}

    client.spin_until(lambda: requests().keys() >= NEEDED, 'the subscriptions of our nodes')
    for (node, topic), request in requests().items():
        verdict, why = qos_check_compatible(offered_by_play(offers[topic]), request)
        assert verdict == QoSCompatibility.OK, f'{node} on {topic}: {why}'
    assert process.interrupt() == 0


def test_a_profile_in_a_bag_is_the_one_that_was_offered(offers):
    for profiles in offers.values():
        for keys in profiles:
            assert {**qos_keys(profile(keys)), 'history': keys['history'],
                    'depth': keys['depth']} == keys
