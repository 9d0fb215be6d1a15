"""Bags, read back by independent readers, finished or cut off."""

from contextlib import contextmanager
import itertools
from pathlib import Path
import resource

from hypothesis import given, settings, strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores
import yaml

from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.protocol import CommandHeader, StateHeader
from impulse_control_ros.core.tick import stamp
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag import BagWriter, PACKAGE, Topic
from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.export import to_pandas
from impulse_control_ros.files.mcap_chunk import CHUNK_SIZE
from impulse_control_ros.files.parameter_event import (
    encode_parameter_event,
    TYPE as PARAMETER_EVENT,
)
from impulse_control_ros.files.recording import read_bag

STORE = get_typestore(Stores.ROS2_JAZZY)
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
QOS = {
    'history': 'keep_last',
    'depth': 4000,
    'reliability': 'reliable',
    'durability': 'volatile',
    'deadline': FOREVER,
    'lifespan': FOREVER,
    'liveliness': 'automatic',
    'liveliness_lease_duration': FOREVER,
    'avoid_ros_namespace_conventions': False,
}
RUN, AUTHOR = '0123abcd', '/controller#4567'
STATE = JointStateLayout('axis', StateHeader(RUN, 0, AUTHOR).frame_id)
COMMAND = JointStateLayout('axis', CommandHeader(RUN, 0, AUTHOR).frame_id, ('effort',))
EVENT = JointStateLayout('axis', CommandHeader(RUN, 0, AUTHOR, 'position_zero').frame_id)
START, STEP = 1_000_000_000, 100_000


def topic(name, kind='sensor_msgs/msg/JointState'):
    return Topic(name=name, type=kind, qos=(QOS,))


def entries(count):
    for k in range(count):
        sec, nanosec = divmod(START + k * STEP, 10**9)
        yield START + k * STEP, 1, STATE.encode(sec, nanosec, 0.5 / (k + 1), -k, 5.0)
        if k % 100 == 7:
            yield START + k * STEP, 2, EVENT.encode(sec, nanosec, 0.5, -k, 0.25)
        yield START + k * STEP, 3, COMMAND.encode(sec, nanosec, 5.0 * k)


def begun(folder, count, compression='none'):
    writer = BagWriter(folder, compression)
    for name in ('/joint_states', '/impulse_events', '/joint_commands'):
        writer.add_topic(topic(name))
    writer.add_topic(topic('/run_parameters', PARAMETER_EVENT))
    writer.add_topic(topic('/damping', 'std_msgs/msg/Float64'))
    writer.add_metadata(PACKAGE, {'version': '1.2.3', 'run': RUN})
    writer.write(entries(count))
    return writer


def finished(folder, count=10_000, compression='none'):
    writer = begun(folder, count, compression)
    writer.add_metadata('recording', {'messages': str(writer.count)})
    writer.close()
    return folder


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_rosbags_reads_every_message_type_and_quality_of_service(tmp_path, compression):
    expected = list(entries(10_000))
    with Reader(finished(tmp_path / 'run', compression=compression)) as reader:
        assert reader.message_count == len(expected)
        assert (reader.start_time, reader.duration) == (START, 9_999 * STEP + 1)
        for connection in reader.connections:
            assert connection.digest == STORE.hash_rihs01(connection.msgtype)
            assert connection.ext.offered_qos_profiles[0].depth == 4000
        got = sorted(
            (stamp, connection.topic, bytes(raw)) for connection, stamp, raw in reader.messages()
        )
    names = {1: '/joint_states', 2: '/impulse_events', 3: '/joint_commands'}
    assert got == sorted((stamp, names[channel], raw) for stamp, channel, raw in expected)
    assert STORE.deserialize_cdr(got[0][2], 'sensor_msgs/msg/JointState').name == ['axis']


@pytest.mark.parametrize('compression', ['none', 'lz4', 'zstd'])
def test_the_mcap_reader_agrees_on_checksums_statistics_and_index(tmp_path, compression):
    path = finished(tmp_path / 'run', compression=compression) / 'run_0.mcap'
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == 'ros2'
        messages = list(reader.iter_messages())
        names = [record.name for record in reader.iter_metadata()]
    statistics = summary.statistics
    assert len(messages) == statistics.message_count == 20_100
    assert statistics.channel_message_counts == {1: 10_000, 2: 100, 3: 10_000}
    assert (statistics.message_start_time, statistics.message_end_time) == (
        START,
        START + 9_999 * STEP,
    )
    assert len(summary.chunk_indexes) == statistics.chunk_count > 3
    assert all(
        index.uncompressed_size < 2 * CHUNK_SIZE <= 2**20 for index in summary.chunk_indexes
    )
    assert [message.log_time for _, _, message in messages] == sorted(
        message.log_time for _, _, message in messages
    )
    assert {(schema.name, schema.encoding) for schema in summary.schemas.values()} == {
        ('sensor_msgs/msg/JointState', 'ros2msg'),
        ('std_msgs/msg/Float64', 'ros2msg'),
        (PARAMETER_EVENT, 'ros2msg'),
    }
    assert names == ['rosbag2', PACKAGE, 'recording', 'rosbag2']


def test_a_range_of_time_is_found_by_the_message_index(tmp_path):
    path = finished(tmp_path / 'run') / 'run_0.mcap'
    with path.open('rb') as stream:
        found = [
            message.log_time
            for _, _, message in make_reader(stream).iter_messages(
                topics='/joint_states',
                starting_at=START + 5000 * STEP,
                ending_before=START + 5010 * STEP,
            )
        ]
    assert found == [START + k * STEP for k in range(5000, 5010)]


def test_log_times_never_go_back_whatever_is_given(tmp_path):
    writer = begun(tmp_path / 'run', 10)
    writer.write([(START, 1, STATE.encode(1, 0, 1.0, 0.0, 0.0))])
    writer.close()
    with (tmp_path / 'run' / 'run_0.mcap').open('rb') as stream:
        last = list(make_reader(stream).iter_messages())[-1][2]
    assert (last.log_time, last.publish_time) == (START + 9 * STEP, START)


def chunks_of(path):
    with path.open('rb') as stream:
        return make_reader(stream).get_summary().chunk_indexes


def test_no_two_chunks_overlap_in_time(tmp_path):
    chunks = chunks_of(finished(tmp_path / 'run') / 'run_0.mcap')
    assert len(chunks) > 3
    for before, after in itertools.pairwise(chunks):
        assert before.message_end_time < after.message_start_time


def test_a_chunk_has_at_most_a_mebibyte_even_while_time_stands_still(tmp_path):
    writer = begun(tmp_path / 'run', 0)
    writer.write((START, 1, STATE.encode(1, 0, float(k), 0.0, 0.0)) for k in range(20_000))
    writer.close()
    sizes = [chunk.uncompressed_size for chunk in chunks_of(tmp_path / 'run' / 'run_0.mcap')]
    assert len(sizes) == 3
    assert max(sizes) <= 2**20


def test_the_metadata_file_is_that_of_jazzy(tmp_path):
    folder = finished(tmp_path / 'run', 100)
    content = yaml.safe_load((folder / 'metadata.yaml').read_text())
    bag = content['rosbag2_bagfile_information']
    assert list(content) == ['rosbag2_bagfile_information']
    assert (bag['version'], bag['storage_identifier'], bag['ros_distro']) == (9, 'mcap', 'jazzy')
    assert bag['duration']['nanoseconds'] == 99 * STEP
    assert bag['starting_time']['nanoseconds_since_epoch'] == START
    assert bag['message_count'] == 201
    assert bag['relative_file_paths'] == ['run_0.mcap'] == [bag['files'][0]['path']]
    assert (bag['compression_format'], bag['compression_mode']) == ('', '')
    states = bag['topics_with_message_count'][0]
    assert states['message_count'] == 100
    assert states['topic_metadata']['offered_qos_profiles'] == [QOS]
    assert states['topic_metadata']['serialization_format'] == 'cdr'
    assert '&' not in (folder / 'metadata.yaml').read_text()


def test_what_is_written_is_read(tmp_path):
    writer = begun(tmp_path / 'run', 0)
    values = {'K': 10.0, 'joint_name': 'axis', 'impulses': True, 'stiction_wait_samples': 3}
    writer.write([(START, 4, encode_parameter_event(1, 0, f'run:{RUN} {AUTHOR}', values, {}))])
    writer.write(entries(300))
    writer.close({'missing': '0'})
    run = read_bag(tmp_path / 'run')
    assert np.array_equal(run.states['stamp'], START + np.arange(300) * STEP)
    assert list(run.states['position']) == [0.5 / (k + 1) for k in range(300)]
    assert list(run.commands['effort']) == [5.0 * k for k in range(300)]
    assert [tuple(row) for row in run.impulses] == [
        (START + k * STEP, 1, 0, 0.5, -k, 0.25) for k in (7, 107, 207)
    ]
    assert run.parameters == {'/controller': values}
    assert (run.run, run.version) == (RUN, '1.2.3')
    assert run.recording_summary == {'messages': '604', 'missing': '0'}


def test_impulses_and_verdicts_are_told_apart(tmp_path):
    writer = begun(tmp_path / 'run', 0)
    what = {2: ('sticking', ''), 3: ('', 'absent'), 4: ('sticking', 'confirmed')}
    for k in range(6):
        at = stamp(k, START, STEP)
        header = CommandHeader(RUN, 0, AUTHOR, *what.get(k, ('', ''))).frame_id
        area = 0.25 if k in (2, 4) else 0.0
        writer.write([(START + k * STEP, 1, STATE.encode(*at, 0.5, 0.0, 0.0))])
        if k in what:
            raw = JointStateLayout('axis', header).encode(*at, 0.5, -k, area)
            writer.write([(START + k * STEP, 2, raw)])
        raw = JointStateLayout('axis', header, ('effort',)).encode(*at, 0.0)
        writer.write([(START + k * STEP, 3, raw)])
    writer.close({})
    run = read_bag(tmp_path / 'run')
    ticks, verdicts = ((one['stamp'] - START) // STEP for one in (run.impulses, run.verdicts))
    assert (ticks.tolist(), verdicts.tolist()) == ([2, 4], [3, 4])
    assert run.events['area'].tolist() == [0.25, 0.0, 0.25]
    assert [VERDICTS[one] for one in run.verdicts['verdict']] == ['absent', 'confirmed']
    assert run.impulse_samples()[0].tolist() == [2, 4]
    guards = to_pandas(run)[['guard', 'verdict']].to_numpy().tolist()
    assert guards[2:5] == [['sticking', ''], ['', 'absent'], ['sticking', 'confirmed']]


def test_an_existing_folder_is_refused_and_left_alone(tmp_path):
    (tmp_path / 'run').mkdir()
    with pytest.raises(BagError, match='run.*exists'):
        BagWriter(tmp_path / 'run')
    assert list((tmp_path / 'run').iterdir()) == []


def test_a_topic_of_an_unknown_type_is_refused_by_name(tmp_path):
    writer = BagWriter(tmp_path / 'run')
    with pytest.raises(BagError, match='/thing.*no_msgs/msg/Thing'):
        writer.add_topic(topic('/thing', 'no_msgs/msg/Thing'))
    writer.close()


@contextmanager
def room_for(size):
    """Let no file grow beyond ``size`` bytes meanwhile, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


WHOLE = 3_100_000  # about the size of 12,000 entries


@settings(max_examples=25, deadline=None)
@given(
    size=st.one_of(
        st.integers(20_000, WHOLE),
        st.integers(-50, 50).map(lambda more: 2 * (CHUNK_SIZE + 200_000) + more),
    ),
    compression=st.sampled_from(['none', 'lz4']),
)
def test_a_bag_that_does_not_fit_is_finished_with_the_messages_that_do(
    tmp_path_factory, size, compression
):
    folder = Path(tmp_path_factory.mktemp('full'), 'run')
    with room_for(size):
        writer = begun(folder, 12_000, compression)
        writer.write(entries(100))
        writer.add_metadata('more', {'a': 'b'})
        writer.close({'missing': '0'})
    content = yaml.safe_load((folder / 'metadata.yaml').read_text())
    with (folder / 'run_0.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        statistics = reader.get_summary().statistics
        got = [
            (message.publish_time, channel.id, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
    given_messages = [*entries(12_000), *entries(100)]
    assert got == given_messages[: len(got)]
    assert (
        len(got)
        == statistics.message_count
        == content['rosbag2_bagfile_information']['message_count']
    )
    recording_summary = read_bag(folder).recording_summary
    assert recording_summary['messages'] == str(len(got))
    assert (recording_summary.get('full') == 'File too large') == (len(got) < len(given_messages))
    assert (folder / 'run_0.mcap').stat().st_size > size - 1.2 * CHUNK_SIZE - 200_000 or (
        len(got) == len(given_messages)
    )


def test_a_bag_without_room_for_its_frame_is_refused_by_name(tmp_path):
    with room_for(1000), pytest.raises(BagError, match='run_0.mcap: .*File too large'):
        begun(tmp_path / 'run', 10).close()


def test_a_bag_without_room_for_its_first_byte_leaves_nothing(tmp_path):
    with room_for(10), pytest.raises(BagError, match=r"run' cannot be made: File too large$"):
        BagWriter(tmp_path / 'run')
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    return finished(tmp_path_factory.mktemp('bags') / 'run', 12_000) / 'run_0.mcap'


@settings(max_examples=30, deadline=None)
@given(fraction=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_off_anywhere_reads_up_to_its_last_whole_chunk(
    whole, tmp_path_factory, fraction
):
    length = 8 + int(fraction * (whole.stat().st_size - 9))
    path = Path(tmp_path_factory.mktemp('cut'), 'cut.mcap')
    path.write_bytes(whole.read_bytes()[:length])
    run = read_bag(path)
    count = len(run.states)
    assert np.array_equal(run.states['stamp'], START + np.arange(count) * STEP)
    per_sample = 84 + 60 + 2 * 31 + 2 * 16
    assert count >= (length - 4000 - 1.1 * CHUNK_SIZE) / per_sample * 0.8


def test_a_flipped_byte_in_a_finished_bag_is_found(tmp_path):
    path = finished(tmp_path / 'run') / 'run_0.mcap'
    content = bytearray(path.read_bytes())
    content[content.index(b'axis', len(content) // 2) + 18] ^= 0x10  # a bit of a position
    path.write_bytes(content)
    with pytest.raises(BagError, match='run_0.mcap'):
        read_bag(path)


@pytest.mark.parametrize('content', [b'', b'no bag at all', b'\x89MCAP0\r\n'[:5]])
def test_what_is_no_bag_is_refused_by_name(tmp_path, content):
    path = tmp_path / 'thing.mcap'
    path.write_bytes(content)
    with pytest.raises(BagError, match='thing.mcap'):
        read_bag(path)


def test_a_tilde_in_the_path_of_a_bag_is_the_home_folder(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    with pytest.raises(BagError, match=f'{tmp_path}/none'):
        read_bag('~/none')


def test_a_bag_without_our_topics_is_refused_by_its_topics(tmp_path):
    writer = BagWriter(tmp_path / 'run')
    writer.write([(START, writer.add_topic(topic('/elsewhere')), STATE.encode(1, 0, 0, 0, 0))])
    writer.close()
    with pytest.raises(BagError, match='no joint_states .* among its topics /elsewhere'):
        read_bag(tmp_path / 'run')


@pytest.mark.parametrize('chunked', [True, False])
def test_a_bag_of_another_writer_is_read_in_the_order_of_time(tmp_path, chunked):
    path = tmp_path / 'other.mcap'
    with path.open('wb') as stream:
        writer = Writer(stream, chunk_size=4096, use_chunking=chunked)
        writer.start('ros2')
        schema = writer.register_schema('sensor_msgs/msg/JointState', 'ros2msg', b'')
        channels = {
            number: writer.register_channel(name, 'cdr', schema)
            for number, name in (
                (1, '/left/joint_states'),
                (2, '/left/impulse_events'),
                (3, '/left/joint_commands'),
            )
        }
        for stamp, number, raw in sorted(entries(500), key=lambda entry: entry[0] // 10**7 % 2):
            writer.add_message(channels[number], stamp, raw, stamp)
        writer.finish()
    run, ours = read_bag(path), read_bag(finished(tmp_path / 'run', 500))
    for name in ('states', 'commands', 'impulses'):
        assert getattr(run, name).tobytes() == getattr(ours, name).tobytes()


def test_a_folder_without_a_file_is_refused(tmp_path):
    with pytest.raises(BagError, match='has no .mcap or .db3 file'):
        read_bag(tmp_path)
