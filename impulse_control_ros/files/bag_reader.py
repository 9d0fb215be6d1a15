"""
Read bags of every rosbag2 storage: MCAP or sqlite3, in one file or several, compressed or not.

zstd compresses chunks, messages or files. The format of a file is detected from its first bytes.
sqlite3 databases are read in the order of recording: their timestamps may go back.
"""

from collections.abc import Iterator
from contextlib import closing
import os
from pathlib import Path, PurePosixPath
import re
import sqlite3
from tempfile import TemporaryDirectory
from typing import Any

from mcap.records import Channel, Schema
import numpy as np
import yaml
from zstandard import ZstdDecompressor

from impulse_control_ros.errors import BagError
from impulse_control_ros.files.mcap_reader import (
    by_topic,
    Column,
    columns,
    Item,
    naming,
    Note,
    ZSTD,
)
from impulse_control_ros.files.mcap_writer import MAGIC

STORAGE = re.compile(r'.*\.(mcap|db3)(\.zstd)?')
SQLITE, ROSBAG1 = b'SQLite format 3\0', b'#ROSBAG V'
PART = 1 << 20  # bytes of messages in memory


def items(bag: str | Path) -> Iterator[Item]:
    """Yield the contents of a bag, file by file; raises `BagError` if it is invalid."""
    bag = Path(os.path.expanduser(bag))
    if not bag.exists():
        raise BagError(f'bag {str(bag)!r} does not exist')
    files, notes = ([bag], []) if bag.is_file() else files_of(bag)
    if not files:
        raise BagError(f'bag {str(bag)!r} has no .mcap or .db3 file')
    yield from notes
    for file in files:
        yield from items_of(file)


def files_of(folder: Path) -> tuple[list[Path], list[Note]]:
    """
    Return the files of a bag in order, and notes on the files that are missing or left out.

    The order is that of metadata.yaml, or by name if there is none or its files were renamed.
    """
    there = {file.name: file for file in sorted(folder.iterdir(), key=natural) if is_storage(file)}
    names = listed(folder / 'metadata.yaml')
    # a file may have been compressed or decompressed since
    places = {
        name: next(
            (one for one in (name, f'{name}.zstd', name.removesuffix('.zstd')) if one in there), ''
        )
        for name in names
    }
    if not any(places.values()):  # renamed, or without metadata
        return list(there.values()), []
    found = [place for place in places.values() if place]
    return [there[name] for name in found], [
        *(
            Note(f'{name}, which metadata.yaml lists, is missing')
            for name, place in places.items()
            if not place
        ),
        *(
            Note(f'{name} is left out: metadata.yaml does not list it')
            for name in there
            if name not in found
        ),
    ]


def natural(path: Path) -> list[tuple[int, str]]:
    """Return a sort key that puts bag_10 after bag_9."""
    return [(int('0' + digits), text) for text, digits in re.findall(r'(\D*)(\d*)', path.name)]


def is_storage(file: Path) -> bool:
    """Tell by its name whether a file has messages; false if it is also there uncompressed."""
    if not STORAGE.fullmatch(file.name) or not file.is_file():
        return False
    return file.suffix != '.zstd' or not file.with_suffix('').exists()


def listed(metadata: Path) -> list[str]:
    """Return the file names that a metadata.yaml lists, none if it cannot be read."""
    try:
        content = yaml.safe_load(metadata.read_text())['rosbag2_bagfile_information']
        return [PurePosixPath(path).name for path in content['relative_file_paths']]
    except (OSError, yaml.YAMLError, UnicodeDecodeError, LookupError, TypeError):
        return []


def items_of(file: Path) -> Iterator[Item]:
    """Yield the contents of one file; raises `BagError` if it is invalid."""
    with naming(file), file.open('rb') as stream:
        head = stream.read(len(SQLITE))
    if head.startswith(MAGIC):
        yield from columns(file)
    elif head.startswith(SQLITE):
        yield from items_of_database(file)
    elif head.startswith(ZSTD):
        yield from items_of_compressed(file)
    elif head.startswith(ROSBAG1):
        raise BagError(f'{file}: this is a ROS 1 bag; convert it with rosbags-convert')
    else:
        raise BagError(f'{file}: this is no MCAP file and no sqlite3 database')


def items_of_compressed(file: Path) -> Iterator[Item]:
    """Yield the contents of a compressed file."""
    with TemporaryDirectory() as folder:
        plain = Path(folder, file.name.removesuffix('.zstd'))
        with naming(file), file.open('rb') as source, plain.open('wb') as target:
            ZstdDecompressor().copy_stream(source, target)
        if not plain.stat().st_size:
            raise BagError(f'{file}: it was cut off: none of its content can be decompressed')
        try:
            yield from items_of(plain)
        except BagError as error:
            raise BagError(str(error).replace(str(plain), str(file))) from error


def items_of_database(file: Path) -> Iterator[Item]:
    """Yield the contents of a sqlite3 file, messages in the order of recording."""
    # without a write-ahead log, immutable also opens a database in a read-only folder
    has_log = file.with_name(f'{file.name}-wal').exists()
    address = f'{file.absolute().as_uri()}?mode=ro{"" if has_log else "&immutable=1"}'
    try:
        with naming(file), closing(sqlite3.connect(address, uri=True)) as database:
            database.row_factory = sqlite3.Row
            topics: dict[int, str] = {}
            for row in database.execute('SELECT * FROM topics').fetchall():
                yield from described(dict(row))
                topics[row['id']] = row['name']
            yield from messages_of(database, topics)
    except sqlite3.Error as error:
        raise BagError(f'{file}: {error}') from error


def described(topic: dict[str, Any]) -> Iterator[Item]:
    """Yield the MCAP records for a row of the table of topics."""
    yield Schema(id=topic['id'], name=topic['type'], encoding='', data=b'')
    yield Channel(
        id=topic['id'],
        schema_id=topic['id'],
        topic=topic['name'],
        # early versions of rosbag2 name no format
        message_encoding=topic.get('serialization_format') or 'cdr',
        metadata={'offered_qos_profiles': topic.get('offered_qos_profiles') or ''},
    )


def messages_of(database: sqlite3.Connection, topics: dict[int, str]) -> Iterator[Column]:
    """Yield the messages in parts of about `PART` bytes."""
    part: list[sqlite3.Row] = []
    size = 0
    for row in database.execute('SELECT topic_id, timestamp, data FROM messages ORDER BY id'):
        if not isinstance(row['data'], bytes):
            raise ValueError('it is damaged: a message has no bytes')
        part.append(row)
        size += len(row['data'])
        if size >= PART:
            yield from columns_of_rows(part, topics)
            part, size = [], 0
    if part:
        yield from columns_of_rows(part, topics)


def columns_of_rows(rows: list[sqlite3.Row], topics: dict[int, str]) -> Iterator[Column]:
    """Return the columns for rows of the table of messages."""
    channel, time, data = zip(*rows, strict=True)
    times = np.array(time, np.int64)
    size = np.fromiter(map(len, data), np.int64, len(data))
    content = np.frombuffer(b''.join(data), np.uint8)
    start = size.cumsum() - size
    return by_topic(topics, np.array(channel), times, times, content, start, size)
