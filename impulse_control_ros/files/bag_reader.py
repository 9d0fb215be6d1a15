"""
What a bag holds, whichever way it is stored.

A bag is a file or a rosbag2 folder: MCAP or sqlite3, in one file or split, each file or message
compressed with zstd or not. The content of a file tells what it is, not its name.
"""

from collections.abc import Iterator
from contextlib import closing
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
PART = 1 << 20  # bytes of messages that are held at once


def items(bag: str | Path) -> Iterator[Item]:
    """Yield what a bag holds, file by file; raises `BagError` for what is none."""
    bag = Path(bag)
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
    Return the files of a bag in their order, and what is to be said of it.

    The order is that of metadata.yaml, or of the names where it is missing.
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
    """Return the key by which bag_10 comes after bag_9."""
    return [(int('0' + digits), text) for text, digits in re.findall(r'(\D*)(\d*)', path.name)]


def is_storage(file: Path) -> bool:
    """Tell whether a file holds messages, by its name; of two the one that is not compressed."""
    if not STORAGE.fullmatch(file.name) or not file.is_file():
        return False
    return file.suffix != '.zstd' or not file.with_suffix('').exists()


def listed(metadata: Path) -> list[str]:
    """Return the names of files that a metadata.yaml lists, none where it cannot be read."""
    try:
        content = yaml.safe_load(metadata.read_text())['rosbag2_bagfile_information']
        return [PurePosixPath(path).name for path in content['relative_file_paths']]
    except (OSError, yaml.YAMLError, UnicodeDecodeError, LookupError, TypeError):
        return []


def items_of(file: Path) -> Iterator[Item]:
    """Yield what one file holds; raises `BagError`."""
    with naming(file), file.open('rb') as stream:
        head = stream.read(len(SQLITE))
    if head.startswith(MAGIC):
        yield from columns(file)
    elif head.startswith(SQLITE):
        yield from items_of_database(file)
    elif head.startswith(ZSTD):
        yield from items_of_compressed(file)
    elif head.startswith(ROSBAG1):
        raise BagError(f'{file}: this is a bag of ROS 1; rosbags-convert makes one of ROS 2 of it')
    else:
        raise BagError(f'{file}: this is no MCAP file and no sqlite3 database')


def items_of_compressed(file: Path) -> Iterator[Item]:
    """Yield what a file holds that is compressed as a whole."""
    with TemporaryDirectory() as folder:
        plain = Path(folder, file.name.removesuffix('.zstd'))
        with naming(file), file.open('rb') as source, plain.open('wb') as target:
            ZstdDecompressor().copy_stream(source, target)
        try:
            yield from items_of(plain)
        except BagError as error:
            raise BagError(str(error).replace(str(plain), str(file))) from error


def items_of_database(file: Path) -> Iterator[Item]:
    """Yield what a sqlite3 file holds, messages in the order in which they were recorded."""
    # one without a log beside it is opened in a folder, too, that cannot be written
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
    """Yield a row of the table of topics as the records of an MCAP file."""
    yield Schema(id=topic['id'], name=topic['type'], encoding='', data=b'')
    yield Channel(
        id=topic['id'],
        schema_id=topic['id'],
        topic=topic['name'],
        message_encoding=topic['serialization_format'],
        metadata={'offered_qos_profiles': topic.get('offered_qos_profiles') or ''},
    )


def messages_of(database: sqlite3.Connection, topics: dict[int, str]) -> Iterator[Column]:
    """Yield the messages, some at a time."""
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
    """Yield the columns of rows of the table of messages."""
    channel, time, data = zip(*rows, strict=True)
    times = np.array(time, np.int64)
    size = np.fromiter(map(len, data), np.int64, len(data))
    content = np.frombuffer(b''.join(data), np.uint8)
    start = size.cumsum() - size
    return by_topic(topics, np.array(channel), times, times, content, start, size)
