"""Bags of other writers: whichever way they are stored, the same states are read."""

from contextlib import closing
from io import BytesIO
from pathlib import Path
import re
import shutil
import sqlite3

from hypothesis import given, strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as BagWriter
import yaml
from zstandard import ZstdCompressor

from impulse_control_ros.errors import BagError
from impulse_control_ros.files.bag_reader import files_of
from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.definition import message_definition
from impulse_control_ros.files.playback import chosen, in_order, span_of, surveyed
from impulse_control_ros.files.recording import read_bag
from test.files.test_bag import START, STORE

MS = 1_000_000
COUNT = 300
JOINT_STATE = 'sensor_msgs/msg/JointState'
TOPIC = '/joint_states'
LAYOUT = JointStateLayout('axis', 'base')


def message(k):
    return LAYOUT.encode(1, k * MS, 0.5 / (k + 1), -k, 5.0)


POSITIONS = [0.5 / (k + 1) for k in range(COUNT)]


def written(folder, storage=StoragePlugin.MCAP, mode=CompressionMode.NONE, ticks=range(COUNT)):
    """Return a bag of a robot, as rosbags writes it."""
    writer = BagWriter(folder, version=9, storage_plugin=storage)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = [
            writer.add_connection(name, JOINT_STATE, typestore=STORE)
            for name in (TOPIC, '/joint_commands')
        ]
        for k in ticks:
            for connection in connections:
                writer.write(connection, START + k * MS, message(k))
    return folder


def file_of(folder):
    (file,) = (path for path in folder.iterdir() if path.name != 'metadata.yaml')
    return file


def is_whole(bag):
    run = read_bag(bag)
    assert run.states['position'].tolist() == POSITIONS
    assert run.effort.tolist() == [5.0] * COUNT
    assert (run.unread, run.lacks) == (None, ['the parameters of the controller are missing'])
    found, times, _ = surveyed(bag)
    assert found[TOPIC].kind == JOINT_STATE
    span = span_of(times[TOPIC])
    assert span == (START, START + (COUNT - 1) * MS)
    played = list(in_order(bag, {TOPIC, '/joint_commands'}, *span))
    assert [time for time, _, _ in played] == sorted(2 * [START + k * MS for k in range(COUNT)])
    assert [raw for _, topic, raw in played if topic == TOPIC] == [*map(message, range(COUNT))]
    return True


@pytest.mark.parametrize('storage', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize(
    'mode', [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE]
)
def test_every_storage_and_compression_of_rosbag2_is_read(tmp_path, storage, mode):
    bag = written(tmp_path / 'bag', storage, mode)
    assert is_whole(bag)
    assert is_whole(file_of(bag))  # whatever metadata.yaml says


def split(folder, names, listed):
    """Return a bag in several files, of which metadata.yaml lists some; None: it is missing."""
    folder.mkdir()
    for number, name in enumerate(names):
        ticks = range(COUNT * number // len(names), COUNT * (number + 1) // len(names))
        storage = StoragePlugin.SQLITE3 if name.endswith('.db3') else StoragePlugin.MCAP
        shutil.copy(
            file_of(written(folder.parent / f'{folder.name}_{number}', storage, ticks=ticks)),
            folder / name,
        )
    if listed is not None:
        content = {'rosbag2_bagfile_information': {'relative_file_paths': listed}}
        (folder / 'metadata.yaml').write_text(yaml.safe_dump(content))
    return folder


@pytest.mark.parametrize('suffix', ['mcap', 'db3'])
def test_a_split_bag_is_read_in_the_order_of_its_metadata_or_of_its_names(tmp_path, suffix):
    names = [f'bag_{number}.{suffix}' for number in (8, 9, 10, 11)]
    odd = [f'{name}.{suffix}' for name in 'dacb']
    kinds = [(names, None), (names, names), (odd, [f'bag/{one}' for one in odd]), (names, ['x'])]
    for number, (files, listed) in enumerate(kinds):
        assert is_whole(split(tmp_path / f'bag{number}', files, listed))


def test_a_file_that_was_compressed_later_is_that_of_the_metadata(tmp_path):
    bag = written(tmp_path / 'bag')
    file = file_of(bag)
    file.with_name(f'{file.name}.zstd').write_bytes(ZstdCompressor().compress(file.read_bytes()))
    assert [one.name for one in files_of(bag)[0]] == [file.name]
    file.unlink()
    assert is_whole(bag)
    (bag / 'metadata.yaml').unlink()
    assert is_whole(bag)


def test_files_that_the_metadata_lists_otherwise_are_named(tmp_path):
    names = [f'bag_{number}.mcap' for number in range(3)]
    bag = split(tmp_path / 'bag', names, ['bag_0.mcap', 'bag_1.mcap', 'bag_7.mcap'])
    run = read_bag(bag)
    assert run.states['position'].tolist() == POSITIONS[:200]
    assert run.lacks[:2] == [
        'bag_7.mcap, which metadata.yaml lists, is missing',
        'bag_2.mcap is left out: metadata.yaml does not list it',
    ]


def test_what_a_killed_recorder_left_in_the_log_of_a_database_is_read(tmp_path):
    file = file_of(written(tmp_path / 'bag', StoragePlugin.SQLITE3))
    copy = tmp_path / 'copy.db3'
    with closing(sqlite3.connect(file)) as database:
        database.execute('PRAGMA journal_mode=WAL')
        database.execute('UPDATE messages SET timestamp = timestamp + 1')
        database.commit()
        for suffix in ('', '-wal'):
            shutil.copy(f'{file}{suffix}', f'{copy}{suffix}')
    assert span_of(surveyed(copy)[1][TOPIC])[0] == START + 1


def test_a_database_of_the_first_rosbag2_names_no_format_and_is_read(tmp_path):
    bag = written(tmp_path / 'bag', StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(file_of(bag))) as database:
        for column in ('serialization_format', 'offered_qos_profiles', 'type_description_hash'):
            database.execute(f'ALTER TABLE topics DROP COLUMN {column}')
        database.commit()
    is_whole(bag)


@pytest.mark.parametrize(
    ('content', 'why'),
    [
        (b'#ROSBAG V2.0\n', 'this is a ROS 1 bag'),
        (b'PK\3\4' * 9, 'no MCAP file and no sqlite3 database'),
        (b'SQLite format 3\0' * 9, 'file is not a database'),
        (ZstdCompressor().compress(b'PK\3\4' * 9), 'no MCAP file and no sqlite3 database'),
        (ZstdCompressor().compress(b'PK\3\4' * 9)[:-3], 'it was cut off'),
    ],
)
def test_what_is_no_bag_is_refused_by_what_it_is(tmp_path, content, why):
    path = tmp_path / 'thing.mcap'
    path.write_bytes(content)
    with pytest.raises(BagError, match=f'^{re.escape(str(path))}: .*{why}'):
        read_bag(path)


# -- MCAP --------------------------------------------------------------------------------------


def mcap(order=range(COUNT), encoding='cdr', **options):
    """Return an MCAP file of a robot, as the library writes it, and where its data end."""
    stream = BytesIO()
    writer = Writer(stream, **options)
    writer.start(profile='ros2', library='library')
    schema = writer.register_schema(
        JOINT_STATE, 'ros2msg', message_definition(JOINT_STATE).encode()
    )
    other = writer.register_channel('/odom', 'json', 0)
    channel = writer.register_channel(TOPIC, encoding, schema)
    for k in order:
        time = START + int(k) * MS
        writer.add_message(channel, time, message(k), time)
        if k % 7 == 1:
            writer.add_message(other, time, b'{}', time)
        if k % 100 == 0:
            writer.add_attachment(time, time, 'a', 'text/plain', b'b')
            writer.add_metadata('m', {'a': 'b'})
    writer.finish()
    data = stream.getvalue()
    end = 8
    while data[end] != Opcode.DATA_END:
        end += 9 + int.from_bytes(data[end + 1 : end + 9], 'little')
    return data, end


orders = st.one_of(
    st.just(range(COUNT)),
    st.just(range(COUNT)[::-1]),
    st.integers(0, 99).map(lambda seed: np.random.default_rng(seed).permutation(COUNT)),
)


@pytest.mark.parametrize('name', [TOPIC, 'joint_states'])
@pytest.mark.parametrize('wanted', [TOPIC, 'joint_states'])
def test_the_slash_in_front_of_a_topic_does_not_matter(tmp_path, name, wanted):
    with (tmp_path / 'bag.mcap').open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', b'')
        channel = writer.register_channel(name, 'cdr', schema)
        for k in range(3):
            writer.add_message(channel, START + k, message(k), START + k)
        writer.finish()
    assert len(read_bag(tmp_path / 'bag.mcap', topics=[wanted]).states) == 3
    assert [*chosen(surveyed(tmp_path / 'bag.mcap')[0], [wanted])] == [name]


@given(
    order=orders,
    cut=st.one_of(st.none(), st.floats(0.0, 1.0)),
    options=st.fixed_dictionaries(
        {
            'chunk_size': st.sampled_from([1, 1000, 1024 * 1024]),
            'compression': st.sampled_from(CompressionType),
            'index_types': st.integers(0, IndexType.ALL.value).map(IndexType),
            **dict.fromkeys(
                [
                    'repeat_channels',
                    'repeat_schemas',
                    'use_chunking',
                    'use_statistics',
                    'use_summary_offsets',
                    'enable_crcs',
                    'enable_data_crcs',
                ],
                st.booleans(),
            ),
        }
    ),
)
def test_an_mcap_file_of_any_writer_is_read_as_far_as_it_goes(
    tmp_path_factory, order, cut, options
):
    path = Path(tmp_path_factory.mktemp('mcap'), 'bag.mcap')
    data, end = mcap(order, **options)
    length = len(data) if cut is None else 8 + int(cut * (len(data) - 8))
    path.write_bytes(data[:length])
    run = read_bag(path)
    path.unlink()
    ticks = (run.states['stamp'] - START) // MS
    assert (run.unread is None) == (length == len(data))
    assert sorted(ticks.tolist()) == sorted(order[: len(ticks)])
    assert len(ticks) == COUNT or length < end
    assert run.states['position'].tolist() == [POSITIONS[k] for k in ticks]


@pytest.mark.parametrize('finished', [True, False])
def test_a_compression_that_nobody_knows_is_the_reason(tmp_path, finished):
    data, end = mcap(compression=CompressionType.LZ4)
    path = tmp_path / 'bag.mcap'
    path.write_bytes(data[: None if finished else end].replace(b'\3\0\0\0lz4', b'\3\0\0\0bz2'))
    with pytest.raises(BagError, match="chunks compressed with 'bz2' cannot be read"):
        read_bag(path)


def test_messages_that_are_not_cdr_are_named_so(tmp_path):
    path = tmp_path / 'bag.mcap'
    path.write_bytes(mcap(encoding='json')[0])
    with pytest.raises(BagError, match="/joint_states .*JointState, encoded as 'json'"):
        read_bag(path)
