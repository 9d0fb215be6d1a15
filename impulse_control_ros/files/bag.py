"""
Bags: a rosbag2 folder, ``NAME/NAME_0.mcap`` and ``NAME/metadata.yaml``, written and read.

Written as rosbag2 of Jazzy does (profile ros2, schemas ros2msg, CDR, metadata version 9), with
log time = publish time = the stamp of the message. A chunk is handed to the operating system as
soon as it is full, so a recorder that is killed loses no more than its last chunk.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
import json
import os
from pathlib import Path
import struct
from typing import Any, IO

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Metadata
from mcap.stream_reader import breakup_chunk, StreamReader
import numpy as np
import yaml
from zstandard import ZstdError

from impulse_control_ros import __version__
from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import JointStateLayout, RESET_MARK
from impulse_control_ros.files.definition import message_definition, type_hash
from impulse_control_ros.files.mcap_file import McapFile

ROS_DISTRO = 'jazzy'
# name of the metadata record of a node's parameters, before the node's; ':STAMP' follows where
# the node came anew in mid-run
PARAMETERS = 'parameters:'
SAMPLE = np.dtype([('stamp', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('effort', 'f8')])
COMMAND = np.dtype([('stamp', 'i8'), ('effort', 'f8')])
IMPULSE = np.dtype([('stamp', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'),
                    ('area', 'f8')])


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors: every value is spelled out where it stands."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never refer to an earlier value."""
        return True


def to_yaml(content: Any) -> str:
    """Return ``content`` as YAML in the order given."""
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False)


class BagError(Exception):
    """A bag that cannot be written or read; the message names the path and the reason."""


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A recorded topic: absolute name, type as pkg/msg/Name, nine QoS keys per publisher."""

    name: str
    type: str
    qos: tuple[Mapping[str, Any], ...]


class BagWriter:
    """
    A bag under construction; `close` finishes it, once.

    ``write`` and ``add_metadata`` are those of its `McapFile`.
    Raises `BagError` when the folder exists or cannot be made.
    """

    def __init__(self, folder: str | Path, compression: str = 'none') -> None:
        self.folder = Path(folder)
        make(self.folder)
        self._path = storage_path(self.folder)
        self._file = McapFile(self._path, f'impulse_control_ros {__version__}', compression)
        self._topics: list[Topic] = []
        self._schemas: dict[str, int] = {}
        self.write, self.add_metadata = self._file.write, self._file.add_metadata
        self._add_bag_metadata()

    def add_topic(self, topic: Topic) -> int:
        """Register a topic; returns the channel for `write`."""
        if topic.type not in self._schemas:
            try:
                definition = message_definition(topic.type)
            except FileNotFoundError as error:
                raise BagError(f'topic {topic.name!r} cannot be recorded: {error}') from None
            self._schemas[topic.type] = self._file.add_schema(topic.type, definition)
        self._topics.append(topic)
        return self._file.add_channel(
            topic.name, self._schemas[topic.type],
            {'offered_qos_profiles': to_yaml([dict(qos) for qos in topic.qos]),
             'topic_type_hash': type_hash(topic.type)})

    @property
    def count(self) -> int:
        """Messages written so far."""
        return sum(self._file.counts.values())

    def close(self) -> None:
        """Finish the file and write metadata.yaml."""
        self._file.end_chunk()
        self._add_bag_metadata()
        self._file.close()
        (self.folder / 'metadata.yaml').write_text(to_yaml(
            {'rosbag2_bagfile_information': self._information()}))

    def _add_bag_metadata(self) -> None:
        self._file.add_metadata('rosbag2', {
            'serialized_metadata': to_yaml(self._information())})

    def _information(self) -> dict[str, Any]:
        """Return rosbag2's BagMetadata, version 9."""
        start = {'nanoseconds_since_epoch': self._file.first}
        length = {'nanoseconds': self._file.last - self._file.first}
        return {
            'version': 9, 'storage_identifier': 'mcap', 'duration': length,
            'starting_time': start, 'message_count': self.count,
            'topics_with_message_count': [
                {'topic_metadata': {
                    'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                    'offered_qos_profiles': [dict(qos) for qos in topic.qos],
                    'type_description_hash': type_hash(topic.type)},
                 'message_count': count}
                for topic, count in zip(
                    self._topics, self._file.counts.values(), strict=True)],
            'compression_format': '', 'compression_mode': '',
            'relative_file_paths': [self._path.name],
            'files': [{'path': self._path.name, 'starting_time': start, 'duration': length,
                       'message_count': self.count}],
            'custom_data': {'impulse_control_ros': __version__}, 'ros_distro': ROS_DISTRO}


def require_writable(folder: Path) -> None:
    """
    Raise `BagError` when ``folder`` exists or cannot be made: nothing recorded is overwritten.

    The folder is made for a moment, the only proof that it can be.
    """
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    try:
        make(folder)
        with naming(folder):
            storage_path(folder).touch()
            storage_path(folder).unlink()
    finally:
        for path in filter(os.path.isdir, missing):
            path.rmdir()


def storage_path(folder: Path) -> Path:
    """Return the path of the MCAP file in a bag of ours."""
    return folder / f'{folder.name}_0.mcap'


def make(folder: Path) -> None:
    """Make ``folder``, or raise `BagError`."""
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise BagError(f'bag {str(folder)!r} exists; name a new folder') from None
    except (OSError, ValueError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise BagError(f'bag {str(folder)!r} cannot be made: {reason}') from None


@dataclass(frozen=True, kw_only=True)
class Recording:
    """
    What a bag holds of one joint.

    ``states`` (n,) of dtype SAMPLE, ``commands`` (n,) of COMMAND, ``impulses`` (k,) of IMPULSE,
    stamps in ns, the rest in SI units; ``parameters`` by node name and parameter name, and
    ``restarts`` (stamp, node, parameters) of nodes that came anew with others; ``receipt`` is
    what the recorder says at the end (messages, missing, repeated, foreign, wall_seconds), empty
    for a bag that was cut off. States of other joints, or out of their time, are left out.
    """

    states: np.ndarray
    commands: np.ndarray
    impulses: np.ndarray
    parameters: Mapping[str, Mapping[str, Any]]
    restarts: list[tuple[int, str, Mapping[str, Any]]]
    receipt: Mapping[str, str]


def storage_file(bag: str | Path) -> Path:
    """Return the MCAP file of a bag folder, or the file itself."""
    path = Path(bag)
    if path.is_file():
        return path
    found = sorted(path.glob('*.mcap'))
    if len(found) != 1:
        raise BagError(f'bag {str(bag)!r} has {len(found)} .mcap files; 1 is expected')
    return found[0]


BROKEN = (McapError, OSError, ValueError, RuntimeError, struct.error, ZstdError)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what the MCAP library and its codecs raise into a `BagError` that names the file."""
    try:
        yield
    except BROKEN as error:
        raise BagError(f'{path}: {error or type(error).__name__}') from error


def records(path: Path) -> Iterator[tuple[Channel, Message] | Metadata]:
    """Yield messages and metadata: in the order of time; of a cut-off file, as far as it goes."""
    with path.open('rb') as stream, naming(path):
        reader = make_reader(stream, validate_crcs=True)
        try:
            finished = reader.get_summary() is not None
        except BROKEN:  # what stands at the end is no footer
            finished = False
        if finished:
            yield from reader.iter_metadata()
            for _, channel, message in reader.iter_messages():
                yield channel, message
        else:
            stream.seek(0)
            yield from records_up_to_the_cut(stream)


def records_up_to_the_cut(stream: IO[bytes]) -> Iterator[tuple[Channel, Message] | Metadata]:
    """Yield what stands before the first incomplete record or damaged chunk."""
    channels: dict[int, Channel] = {}
    try:
        for record in StreamReader(stream, emit_chunks=True).records:
            inner = (breakup_chunk(record, validate_crc=True) if isinstance(record, Chunk)
                     else [record])
            for item in inner:
                if isinstance(item, Channel):
                    channels[item.id] = item
                elif isinstance(item, Message):
                    yield channels[item.channel_id], item
                elif isinstance(item, Metadata):
                    yield item
    except BROKEN:
        return


def read(bag: str | Path) -> Recording:
    """Read a bag of ours; raises `BagError` for what is none."""
    path = storage_file(bag)
    rows: dict[str, list[Any]] = {'joint_states': [], 'joint_commands': [], 'impulse_events': []}
    parameters: dict[str, dict[str, Any]] = {}
    restarts: list[tuple[int, str, Mapping[str, Any]]] = []
    receipt: dict[str, str] = {}
    topics: set[str] = set()
    layouts: dict[str, list[JointStateLayout]] | None = None
    for item in records(path):
        if isinstance(item, Metadata):
            if item.name.startswith(PARAMETERS):
                name, _, stamp = item.name.removeprefix(PARAMETERS).partition(':')
                values = {key: json.loads(value) for key, value in item.metadata.items()}
                if stamp:
                    restarts.append((int(stamp), name, values))
                else:
                    parameters[name] = values
            elif item.name == 'recording':
                receipt = item.metadata
            continue
        channel, message = item
        topics.add(channel.topic)
        kind = channel.topic.rsplit('/', 1)[-1]
        if kind not in rows:
            continue
        if layouts is None:
            layouts = layouts_of(parameters)
        row = decoded(layouts[kind], message)
        if row:
            rows[kind].append(row)
    if topics and not rows['joint_states']:
        joint = layouts['joint_states'][0].joint if layouts else 'axis'
        raise BagError(f'{path}: no joint_states of joint {joint!r} among its topics '
                       f'{", ".join(sorted(topics))}')
    return Recording(
        states=np.array(rows['joint_states'], SAMPLE),
        commands=np.array(rows['joint_commands'], COMMAND),
        impulses=np.array(rows['impulse_events'], IMPULSE),
        parameters=parameters, restarts=restarts, receipt=receipt)


def layouts_of(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, list[JointStateLayout]]:
    """Return the layouts that each topic's messages may have."""
    joint = next((values['joint_name'] for values in parameters.values()
                  if 'joint_name' in values), 'axis')
    return {'joint_states': [JointStateLayout(joint, mark) for mark in ('', RESET_MARK)],
            'joint_commands': [JointStateLayout(joint, '', ('effort',))],
            'impulse_events': [JointStateLayout(joint, guard) for guard in GUARDS]}


def decoded(layouts: list[JointStateLayout], message: Message) -> tuple[Any, ...] | None:
    """
    Return (stamp, values), with the guard's number first where there is a choice.

    None stands for a message of another joint, or one whose place is not that of its stamp.
    """
    for number, layout in enumerate(layouts):
        values = layout.decode(message.data)
        if values is not None:
            if values[0] * SECOND + values[1] != message.publish_time:
                return None
            guard = (number,) if len(layouts) == len(GUARDS) else ()
            return (message.publish_time, *guard, *values[2:])
    return None
