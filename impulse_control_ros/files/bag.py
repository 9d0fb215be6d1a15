"""
Bags: a rosbag2 folder, ``NAME/NAME_0.mcap`` and ``NAME/metadata.yaml``.

Bags have the format of rosbag2 in Jazzy (profile ros2, schemas ros2msg, CDR, metadata version 9),
with log time = publish time = the stamp of the message. A full chunk is handed to the operating
system at once, so a killed recorder loses at most its last chunk. If the disk is full, chunks are
discarded from the end until the file can be finished.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

import yaml

from impulse_control_ros import __version__
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.definition import message_definition, type_hash
from impulse_control_ros.files.mcap_chunk import Block
from impulse_control_ros.files.mcap_reader import naming
from impulse_control_ros.files.mcap_writer import McapFile
from impulse_control_ros.files.topics import SERIES

ROS_DISTRO = 'jazzy'
# name of the metadata record with our version, the id of the run, and the topic of each role
PACKAGE = 'impulse_control_ros'
ROLES = tuple(SERIES)


class _PlainDumper(yaml.SafeDumper):
    """YAML without anchors: every value is written in full."""

    def ignore_aliases(self, data: Any) -> bool:
        """Never write an alias for an earlier value."""
        return True


def to_yaml(content: Any) -> str:
    """Return ``content`` as YAML in the order given."""
    return yaml.dump(content, Dumper=_PlainDumper, sort_keys=False)


@dataclass(frozen=True, kw_only=True)
class Topic:
    """A recorded topic: absolute name, type pkg/msg/Name, nine QoS keys per publisher."""

    name: str
    type: str
    qos: tuple[Mapping[str, Any], ...]

    @property
    def metadata(self) -> dict[str, Any]:
        """The entry of the topic in metadata.yaml."""
        return {
            'name': self.name,
            'type': self.type,
            'serialization_format': 'cdr',
            'offered_qos_profiles': [dict(qos) for qos in self.qos],
            'type_description_hash': type_hash(self.type),
        }


class BagWriter:
    """
    A bag under construction; `close` finishes it, once.

    ``full`` is the error of the first failed write; nothing is written after it. All methods raise
    a `BagError` that names the file, for example if the folder exists.
    """

    def __init__(self, folder: str | Path, compression: str = 'none') -> None:
        self.folder = Path(folder)
        self.full: OSError | None = None
        make(self.folder)
        self._path = storage_path(self.folder)
        self._topics: list[Topic] = []
        try:
            self._file = McapFile(self._path, f'impulse_control_ros {__version__}', compression)
        except OSError as error:
            self._path.unlink(missing_ok=True)
            self.folder.rmdir()
            raise BagError(f'bag {str(folder)!r} cannot be made: {error.strerror}') from None
        self._if_it_fits(self._add_bag_metadata)

    def add_topic(self, topic: Topic) -> int:
        """Register a topic; return its channel for `write`."""
        definition = definition_of(topic.type, f'topic {topic.name!r}')
        metadata = {
            'offered_qos_profiles': to_yaml([dict(qos) for qos in topic.qos]),
            'topic_type_hash': type_hash(topic.type),
        }
        self._if_it_fits(self._file.add_channel, topic.name, topic.type, definition, metadata)
        if not self.full:
            self._topics.append(topic)
        return len(self._topics)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Store a named record of strings."""
        self._if_it_fits(self._file.add_metadata, name, values)

    def write(self, messages: Iterable[tuple[int, int, bytes]]) -> None:
        """Append messages, see `McapFile.write`."""
        self._if_it_fits(self._file.write, messages)

    def write_block(self, block: Block) -> None:
        """Append messages, see `McapFile.write_block`."""
        self._if_it_fits(self._file.write_block, block)

    def _if_it_fits(self, write: Callable[..., object], *what: Any) -> None:
        if self.full:
            return
        try:
            write(*what)
        except OSError as error:
            self.full = error
            self._file.cut_back()

    @property
    def count(self) -> int:
        """Messages written so far."""
        return self._file.count

    def close(self, recording_summary: Mapping[str, str] | None = None) -> None:
        """Finish the file with the ``recording_summary``, and write metadata.yaml."""
        self._if_it_fits(self._file.end_chunk)
        with naming(self._path):
            while True:
                try:
                    self._finish(recording_summary)
                    return
                except OSError as error:
                    self.full = self.full or error
                    if not self._file.cut_back():
                        self._file.close()
                        raise

    def _finish(self, recording_summary: Mapping[str, str] | None) -> None:
        if recording_summary is not None:
            why = {'full': os.strerror(self.full.errno or 0)} if self.full else {}
            self._file.add_metadata(
                'recording', {'messages': str(self.count), **recording_summary, **why}
            )
        self._add_bag_metadata()
        self._file.finish()
        (self.folder / 'metadata.yaml').write_text(
            to_yaml({'rosbag2_bagfile_information': self._information()})
        )
        self._file.close()

    def _add_bag_metadata(self) -> None:
        self._file.add_metadata('rosbag2', {'serialized_metadata': to_yaml(self._information())})

    def _information(self) -> dict[str, Any]:
        """Return rosbag2's BagMetadata, version 9."""
        span = {
            'starting_time': {'nanoseconds_since_epoch': self._file.first},
            'duration': {'nanoseconds': self._file.last - self._file.first},
            'message_count': self.count,
        }
        counted = zip(self._topics, self._file.counts.values(), strict=True)
        return {
            'version': 9,
            'storage_identifier': 'mcap',
            'duration': span['duration'],
            'starting_time': span['starting_time'],
            'message_count': self.count,
            'topics_with_message_count': [
                {'topic_metadata': topic.metadata, 'message_count': count}
                for topic, count in counted
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self._path.name],
            'files': [{'path': self._path.name, **span}],
            'custom_data': {'impulse_control_ros': __version__},
            'ros_distro': ROS_DISTRO,
        }


def require_definitions(kinds: Iterable[str]) -> None:
    """Raise `BagError` for a message type whose definition is not installed."""
    for kind in kinds:
        definition_of(kind, f'message type {kind!r}')


def definition_of(kind: str, what: str) -> str:
    """Return the definition of a message type; raises `BagError`, which names ``what``."""
    try:
        return message_definition(kind)
    except FileNotFoundError as error:
        raise BagError(f'{what} cannot be recorded: {error}') from None


def describe_run(bag: BagWriter, run: str, topics: Sequence[Topic]) -> None:
    """Store in a bag the id of its run, and the role of each of its ``topics``."""
    bag.add_metadata(
        PACKAGE,
        {'version': __version__, 'run': run}
        | {role: topic.name for role, topic in zip(ROLES, topics, strict=False)},
    )


def require_writable(folder: Path) -> None:
    """
    Raise `BagError` if ``folder`` exists or cannot be made, so that no recording is overwritten.

    The folder is made and removed again, the only reliable test.
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
    """Return the path of the MCAP file in a bag that this package writes."""
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
