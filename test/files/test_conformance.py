"""
Bags of real runs, judged by what rosbag2 of Jazzy requires and by independent readers.

rosbag2 itself is not on PyPI. What it requires is written down here from its sources:
rosbag2_storage's yaml.hpp and qos.cpp, rosbag2_storage_mcap's mcap_storage.cpp, and the player's
choice of a quality of service. All readers that were tried are in
docs/reference/bag-format.md.
"""

from collections import Counter, defaultdict
import subprocess

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.protocol import parse_command, parse_node, parse_state
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.parameter_event import FIELDS as VALUES
from impulse_control_ros.files.recording import read_bag
from test.conftest import BIN


@pytest.fixture(scope='module', params=['underdamped', 'left'])
def bag(request, recorded):
    return recorded / request.param


@pytest.fixture(scope='module')
def path(bag):
    return bag / f'{bag.name}_0.mcap'


@pytest.fixture(scope='module')
def summary(path):
    with path.open('rb') as stream:
        return make_reader(stream, validate_crcs=True).get_summary()


@pytest.fixture(scope='module')
def raw(bag):
    """Return (time, topic, bytes) of all messages, as rosbags reads them."""
    with Reader(bag) as reader:
        return [
            (time, connection.topic, bytes(data)) for connection, time, data in reader.messages()
        ]


# -- metadata.yaml and the record rosbag2, as its parser reads them -----------------------------


def natural(value):
    return type(value) is int and 0 <= value < 2**63


def text(value):
    return isinstance(value, str)


TIME = {'sec': natural, 'nsec': natural}
# rmw's words; 'unknown' is what discovery does not tell, and what rosbag2 writes for it too
WORDS = {
    'history': ('keep_last', 'keep_all', 'system_default', 'unknown'),
    'reliability': ('reliable', 'best_effort'),
    'durability': ('volatile', 'transient_local'),
    'liveliness': ('automatic', 'manual_by_topic'),
}
QOS = {
    'history': WORDS['history'].__contains__,
    'depth': lambda value: natural(value) and value < 2**31,
    'reliability': WORDS['reliability'].__contains__,
    'durability': WORDS['durability'].__contains__,
    'deadline': TIME,
    'lifespan': TIME,
    'liveliness': WORDS['liveliness'].__contains__,
    'liveliness_lease_duration': TIME,
    'avoid_ros_namespace_conventions': lambda value: isinstance(value, bool),
}
SPAN = {
    'starting_time': {'nanoseconds_since_epoch': natural},
    'duration': {'nanoseconds': natural},
    'message_count': natural,
}
BAG_METADATA = {
    'version': lambda value: value == 9,
    'storage_identifier': lambda value: value == 'mcap',
    **SPAN,
    'topics_with_message_count': [
        {
            'topic_metadata': {
                'name': text,
                'type': text,
                'serialization_format': lambda value: value == 'cdr',
                'offered_qos_profiles': [QOS],
                'type_description_hash': lambda value: value.startswith('RIHS01_'),
            },
            'message_count': natural,
        }
    ],
    'compression_format': lambda value: value == '',
    'compression_mode': lambda value: value == '',
    'relative_file_paths': [text],
    'files': [{'path': text, **SPAN}],
    'custom_data': lambda value: all(map(text, value)) and all(map(text, value.values())),
    'ros_distro': text,
}


def assert_fits(content, shape):
    if isinstance(shape, dict):
        assert content.keys() == shape.keys()
        for key, inner in shape.items():
            assert_fits(content[key], inner)
    elif isinstance(shape, list):
        assert isinstance(content, list)
        for item in content:
            assert_fits(item, shape[0])
    else:
        assert shape(content), content


def information(bag):
    return yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


def test_metadata_yaml_has_the_fields_that_version_9_is_parsed_by(bag):
    assert_fits(information(bag), BAG_METADATA)


def test_the_last_rosbag2_record_says_what_metadata_yaml_says(bag, path):
    with path.open('rb') as stream:
        said = [
            yaml.safe_load(record.metadata['serialized_metadata'])
            for record in make_reader(stream).iter_metadata()
            if record.name == 'rosbag2'
        ]
    first, last = said
    assert_fits(first, BAG_METADATA)
    assert last == information(bag)


def test_metadata_yaml_agrees_with_a_count_of_the_messages(bag, raw):
    content = information(bag)
    times, counts = [time for time, _, _ in raw], Counter(topic for _, topic, _ in raw)
    assert content['message_count'] == len(raw) == content['files'][0]['message_count']
    assert content['starting_time']['nanoseconds_since_epoch'] == min(times)
    assert content['duration']['nanoseconds'] == max(times) - min(times)
    assert {
        item['topic_metadata']['name']: item['message_count']
        for item in content['topics_with_message_count']
        if item['message_count']
    } == counts
    assert all((bag / name).is_file() for name in content['relative_file_paths'])


def test_a_channel_says_of_its_topic_what_metadata_yaml_says(bag, summary):
    topics = {
        item['topic_metadata']['name']: item['topic_metadata']
        for item in information(bag)['topics_with_message_count']
    }
    assert {channel.topic for channel in summary.channels.values()} == topics.keys()
    for channel in summary.channels.values():
        topic = topics[channel.topic]
        assert channel.message_encoding == 'cdr'
        assert channel.metadata.keys() == {'offered_qos_profiles', 'topic_type_hash'}
        assert channel.metadata['topic_type_hash'] == topic['type_description_hash']
        assert (
            yaml.safe_load(channel.metadata['offered_qos_profiles'])
            == topic['offered_qos_profiles']
        )
        assert summary.schemas[channel.schema_id].name == topic['type']


# -- definitions --------------------------------------------------------------------------------


def test_the_definitions_in_the_bag_alone_have_the_hash_of_their_type(summary):
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        assert schema.encoding == 'ros2msg'
        assert store.hash_rihs01(schema.name) == channel.metadata['topic_type_hash']


# -- independent readers ------------------------------------------------------------------------


def rows_of(decoded):
    """Return the values of each topic of ours, by its last name, from (topic, message)."""
    rows = defaultdict(list)
    for topic, message in decoded:
        name = topic.rsplit('/', 1)[-1]
        if name in ('joint_states', 'joint_commands', 'impulse_events'):
            assert list(message.name) == ['axis']
            parse = parse_state if name == 'joint_states' else parse_command
            header = parse(message.header.frame_id)
            rows[name].append(
                bits(
                    (
                        nanoseconds(message.header.stamp),
                        header.run,
                        *((header.guard, header.verdict) if name != 'joint_states' else ()),
                        *message.position,
                        *message.velocity,
                        *message.effort,
                    )
                )
            )
            rows['controllers'].append(header[2])
        elif name == 'damping':
            rows[name].append(bits((message.data,)))
        elif name == 'run_parameters':
            values = {
                one.name: getattr(one.value, VALUES[one.value.type])
                for one in message.new_parameters
            }
            rows[name].append(
                (
                    nanoseconds(message.stamp),
                    *parse_node(message.node),
                    {
                        key: value
                        if isinstance(value, str) or np.ndim(value) == 0
                        else list(value)
                        for key, value in values.items()
                    },
                )
            )
    return rows


def nanoseconds(stamp):
    return stamp.sec * SECOND + stamp.nanosec


def bits(row):
    return [item if isinstance(item, str) else np.float64(item).tobytes() for item in row]


def guard_and_verdict(row):
    return GUARDS[row['guard']], VERDICTS[row['verdict']]


def assert_same_bits(rows, bag):
    run = read_bag(bag)
    assert len(run.states) == len(run.commands) > 1000
    assert run.lacks == []
    assert rows['joint_states'] == [
        bits((row['stamp'], run.run, row['position'], row['velocity'], row['effort']))
        for row in run.states
    ]
    words = {row['stamp']: guard_and_verdict(row) for row in run.events}
    assert rows['joint_commands'] == [
        bits((row['stamp'], run.run, *words.get(row['stamp'], ('', '')), row['effort']))
        for row in run.commands
    ]
    assert rows['impulse_events'] == [
        bits(
            (
                row['stamp'],
                run.run,
                *guard_and_verdict(row),
                row['position'],
                row['velocity'],
                row['area'],
            )
        )
        for row in run.events
    ]
    assert rows['damping'] == [bits((row['damping'],)) for row in run.damping]
    assert rows['run_parameters'] == [
        (change.stamp, run.run, change.node_id, change.values) for change in run.history
    ]
    plant, controller = run.history
    assert (plant.is_plant, controller.is_plant) == (True, False)
    assert rows['controllers'].count('') == 1  # in the first state
    assert {*rows['controllers']} == {'', controller.node_id}


def test_rosbags_and_read_agree_on_every_message_to_the_bit(bag):
    with AnyReader([bag]) as reader:
        rows = rows_of(
            (connection.topic, reader.deserialize(data, connection.msgtype))
            for connection, _, data in reader.messages()
        )
    assert_same_bits(rows, bag)


def test_mcap_ros2_support_and_read_agree_on_every_message_to_the_bit(bag, path):
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        rows = rows_of(
            (channel.topic, decoded) for _, channel, _, decoded in reader.iter_decoded_messages()
        )
    assert_same_bits(rows, bag)


def test_the_publish_time_of_a_message_is_its_stamp(bag, path):
    damping, told = [], []
    with path.open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert message.publish_time <= message.log_time
            if schema.name == 'sensor_msgs/msg/JointState':
                assert message.publish_time == nanoseconds(decoded.header.stamp)
            elif channel.topic.endswith('/run_parameters'):
                told.append((message.publish_time, nanoseconds(decoded.stamp)))
            elif channel.topic.endswith('/damping'):
                damping.append(message.publish_time)
    run = read_bag(bag)
    assert damping == list(run.damping['stamp'])
    assert told == [(change.stamp, change.stamp) for change in run.history]


def test_mcap_and_rosbags_agree_on_every_message_of_every_topic(path, raw):
    with path.open('rb') as stream:
        assert raw == [
            (message.log_time, channel.topic, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def test_a_bag_turned_into_sqlite_and_back_keeps_every_message(bag, raw, tmp_path):
    for source, target, storage in (
        (bag, tmp_path / 'sqlite', 'sqlite3'),
        (tmp_path / 'sqlite', tmp_path / 'back', 'mcap'),
    ):
        subprocess.run(
            [
                str(BIN / 'rosbags-convert'),
                '--src',
                str(source),
                '--dst',
                str(target),
                '--dst-storage',
                storage,
            ],
            check=True,
        )
        with Reader(target) as reader, Reader(bag) as original:
            assert [
                (time, connection.topic, bytes(data))
                for connection, time, data in reader.messages()
            ] == raw
            assert described(reader) == described(original)


def described(reader):
    return {
        connection.topic: (
            connection.msgtype,
            connection.digest,
            connection.ext.offered_qos_profiles,
        )
        for connection in reader.connections
    }
