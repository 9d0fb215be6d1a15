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
from std_msgs.msg import Float64
import yaml

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.topics import offered_on, SERIES_DEPTH
from impulse_control_ros.nodes.topics import qos_keys
from test.conftest import ROOT
from test.files.test_bag import QOS
from test.nodes.runs import Run

NEEDED = {
    ('controller', '/joint_states'),
    ('controller', '/setpoint'),
    ('controller', '/run_parameters'),
    ('plant_simulator', '/joint_commands'),
    ('recorder', '/joint_states'),
    ('recorder', '/joint_commands'),
    ('recorder', '/impulse_events'),
    ('recorder', '/run_parameters'),
    ('recorder', '/damping'),
    ('recorder', '/setpoint'),
}
TOPICS = sorted({topic for _, topic in NEEDED})


def profile(keys):
    """Return the QoS of nine keys as they stand in metadata.yaml, without its history."""

    def duration(time):
        return Duration(nanoseconds=time['sec'] * SECOND + time['nsec'])

    return QoSProfile(
        depth=10,
        reliability=ReliabilityPolicy.get_from_short_key(keys['reliability']),
        durability=DurabilityPolicy.get_from_short_key(keys['durability']),
        deadline=duration(keys['deadline']),
        lifespan=duration(keys['lifespan']),
        liveliness=LivelinessPolicy.get_from_short_key(keys['liveliness']),
        liveliness_lease_duration=duration(keys['liveliness_lease_duration']),
        avoid_ros_namespace_conventions=keys['avoid_ros_namespace_conventions'],
    )


def offered_by_play(profiles):
    """Return what rosbag2's player offers: the recorded profile where all are the same."""
    assert all(one == profiles[0] for one in profiles)
    return profile(profiles[0] if profiles else QOS)


def test_play_offers_every_node_what_it_requests_and_a_bag_says_what_was_offered(graph, client):
    run = Run(graph, client)
    client.node.create_publisher(Float64, '/setpoint', 10)

    def requests():
        return {
            (end.node_name, topic): end.qos_profile
            for topic in TOPICS
            for end in client.node.get_subscriptions_info_by_topic(topic)
            if end.node_name != 'test_client'
        }

    client.spin_until(lambda: requests().keys() >= NEEDED, 'the subscriptions of our nodes')
    requested = requests()
    run.finish()
    content = yaml.safe_load((run.bag / 'metadata.yaml').read_text())
    offers = {
        topic['topic_metadata']['name']: topic['topic_metadata']['offered_qos_profiles']
        for topic in content['rosbag2_bagfile_information']['topics_with_message_count']
    }
    for (node, topic), request in requested.items():
        verdict, why = qos_check_compatible(offered_by_play(offers.get(topic, [])), request)
        assert verdict == QoSCompatibility.OK, f'{node} on {topic}: {why}'
    assert offers['/run_parameters'][0]['durability'] == 'transient_local'
    for keys in (keys for profiles in offers.values() for keys in profiles):
        assert {
            **qos_keys(profile(keys)),
            'history': keys['history'],
            'depth': keys['depth'],
        } == keys


@pytest.mark.parametrize(('name', 'topics'), [('record', 5), ('play', 2)])
def test_the_overrides_for_ros2_bag_reach_and_are_reached_by_our_nodes(name, topics):
    overrides = yaml.safe_load((ROOT / 'qos' / f'{name}.yaml').read_text())
    assert len(overrides) == topics
    for topic, keys in overrides.items():
        ours = profile({**QOS, **offered_on(topic.strip('/'))})
        theirs = profile({**QOS, **keys})
        pair = (ours, theirs) if name == 'record' else (theirs, ours)
        assert qos_check_compatible(*pair)[0] == QoSCompatibility.OK
    depth = overrides['/joint_states']['depth']
    assert depth == {'record': 20_000, 'play': SERIES_DEPTH}[name]
