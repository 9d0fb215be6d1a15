"""Bags of ours as arrays: what a run was."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
import json
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Metadata, Schema
from mcap_ros2.decoder import DecoderFactory
import numpy as np

from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.bag import PACKAGE, PARAMETERS, ROLES
from impulse_control_ros.files.cdr import (
    COMMANDED,
    FIELDS,
    JointStateLayout,
    layout_in,
    RESET_MARK,
    WITHOUT_VELOCITY,
)
from impulse_control_ros.files.columns import BagError, Column, columns, Item, naming

SAMPLE = np.dtype([('stamp', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('effort', 'f8'),
                   ('marked', '?')])
COMMAND = np.dtype([('stamp', 'i8'), ('effort', 'f8')])
IMPULSE = np.dtype([('stamp', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'),
                    ('area', 'f8')])
DAMPING = np.dtype([('stamp', 'i8'), ('damping', 'f8')])
JOINT_STATE, FLOAT64 = 'sensor_msgs/msg/JointState', 'std_msgs/msg/Float64'
FLOAT64_SIZE = 12
PARAMETER_EVENT = 'rcl_interfaces/msg/ParameterEvent'
# fields of rcl_interfaces/ParameterValue by its type, of the types that our parameters have
VALUES = {1: 'bool_value', 2: 'integer_value', 3: 'double_value', 4: 'string_value',
          9: 'string_array_value'}


class Change(NamedTuple):
    """
    Parameters of ``node`` that act from the state of ``stamp`` [ns] on.

    The controller answers this state with them, and the plant steps on from it. ``anew`` tells
    that the node itself was started anew; then they are all, and its memory is empty.
    """

    stamp: int
    node: str
    values: Mapping[str, Any]
    anew: bool


@dataclass(frozen=True, kw_only=True)
class Recording:
    """
    What a bag holds of one joint.

    ``states`` (n,) of dtype SAMPLE, ``commands`` (n,) of COMMAND, ``impulses`` (k,) of IMPULSE,
    ``damping`` (j,) of DAMPING, stamps in ns, the rest in SI units, nan for a velocity or
    effort that was not measured; a state is ``marked`` where a run starts or is reset. Behind the
    state of each stamp in ``withdrawn`` [ns] the controller took its effort away, as for want of
    states, and began afresh.
    ``parameters`` at the start by node name and parameter name, and the ``changes`` to them in
    the order of time; ``version`` is that of the package that recorded them; ``receipt`` is what
    the recorder says at the end (messages, missing, repeated, foreign, wall_seconds), empty for a
    bag that was cut off, of which ``unread`` bytes at the end are no whole record; None for a
    finished one. States of other joints, or out of their time, are left out.
    """

    states: np.ndarray
    commands: np.ndarray
    withdrawn: np.ndarray
    impulses: np.ndarray
    damping: np.ndarray
    parameters: Mapping[str, Mapping[str, Any]]
    changes: list[Change]
    version: str
    receipt: Mapping[str, str]
    unread: int | None

    def history(self, node: str) -> Iterator[Change]:
        """Yield all parameters of ``node`` from the start on, stamp 0, and after each change."""
        before = Change(0, node, self.parameters[node], anew=True)
        yield before
        for change in self.changes:
            if change.node == node:
                values = change.values if change.anew else {**before.values, **change.values}
                before = change._replace(values=values)
                yield before


def storage_file(bag: str | Path) -> Path:
    """Return the MCAP file of a bag folder, or the file itself."""
    path = Path(bag)
    if path.is_file():
        return path
    if not path.exists():
        raise BagError(f'bag {str(bag)!r} does not exist')
    found = sorted(path.glob('*.mcap'))
    if len(found) != 1:
        raise BagError(f'bag {str(bag)!r} has {len(found)} .mcap files; 1 is expected')
    return found[0]


def read(bag: str | Path) -> Recording:
    """Read a bag of ours; raises `BagError` for what is none."""
    path = storage_file(bag)
    gathered = _Gathered()
    with naming(path):
        for item in columns(path):
            gathered.add(item)
        return gathered.recording()


class _Gathered:
    """What has been read of a bag so far."""

    def __init__(self) -> None:
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[str, Channel] = {}
        self._series = {'joint_states': Series(SAMPLE), 'joint_commands': Series(COMMAND),
                        'impulse_events': Series(IMPULSE)}
        self._damping = [np.zeros(0, DAMPING)]
        self._parameters: dict[str, dict[str, Any]] = {}
        self._changes: list[Change] = []
        self._receipt: dict[str, str] = {}
        self._version = ''
        self._unread: int | None = None
        self._roles: dict[str, str] = {}
        self._topics: set[str] = set()
        self._decoders = DecoderFactory()

    def add(self, item: Item) -> None:
        """Take what a file holds."""
        if isinstance(item, Column):
            self._add_messages(item)
        elif isinstance(item, Metadata):
            self._add_metadata(item)
        elif isinstance(item, Schema):
            self._schemas[item.id] = item
        elif isinstance(item, Channel):
            self._channels[item.topic] = item
        else:
            self._unread = item.unread

    def _add_metadata(self, item: Metadata) -> None:
        """Take a named record of strings."""
        if item.name.startswith(PARAMETERS):
            name, _, stamp = item.name.removeprefix(PARAMETERS).partition(':')
            values = {key: json.loads(value) for key, value in item.metadata.items()}
            if stamp and name in self._parameters:  # else one that told them late
                self._changes.append(Change(int(stamp), name, values, anew=True))
            else:
                self._parameters[name] = values
        elif item.name == PACKAGE:
            self._version = item.metadata.get('version', '')
            self._roles = {item.metadata[role]: role for role in ROLES if role in item.metadata}
        elif item.name == 'recording':
            self._receipt = item.metadata

    def _add_messages(self, column: Column) -> None:
        """Take the messages of a topic."""
        self._topics.add(column.topic)
        role = self._roles.get(column.topic, column.topic.rsplit('/', 1)[-1])
        schema = self._type_of(column.topic)
        kind = schema.name if schema else ''
        if role in self._series and kind == JOINT_STATE:
            self._series[role].add(column, joint_of(self._parameters))
        elif role == 'damping' and kind == FLOAT64:
            self._damping.append(damping_of(column))
        elif kind == PARAMETER_EVENT:
            decode = self._decoders.decoder_for('cdr', schema)
            self._changes += changes_of(column, decode) if decode else ()

    def recording(self) -> Recording:
        """Return it as a whole."""
        states, commands, impulses = (one.in_order() for one in self._series.values())
        if self._topics and not len(states):
            raise ValueError(f'no joint_states of joint {joint_of(self._parameters)!r} among its '
                             f'topics {", ".join(sorted(map(self._typed, self._topics)))}')
        self._changes.sort(key=lambda change: (change.stamp, not change.anew))
        return Recording(
            states=states, commands=commands, impulses=impulses,
            withdrawn=self._series['joint_commands'].unstamped,
            damping=np.concatenate(self._damping), parameters=self._parameters,
            changes=self._changes, version=self._version, receipt=self._receipt,
            unread=self._unread)

    def _typed(self, topic: str) -> str:
        """Return a topic with its type, where that is known."""
        kind = self._type_of(topic)
        return f'{topic} ({kind.name})' if kind else topic

    def _type_of(self, topic: str) -> Schema | None:
        channel = self._channels.get(topic)
        return self._schemas.get(channel.schema_id) if channel else None


def changes_of(events: Column, decode: Callable[[bytes], Any]) -> Iterator[Change]:
    """Yield what parameter events tell."""
    for at, size, stamp in zip(events.start, events.size, events.stamp, strict=True):
        event = decode(events.content[at:at + size].tobytes())
        values = {parameter.name: getattr(parameter.value, VALUES[parameter.value.type])
                  for parameter in (*event.new_parameters, *event.changed_parameters)
                  if parameter.value.type in VALUES}
        yield Change(int(stamp), event.node, values, anew=False)


def damping_of(column: Column) -> np.ndarray:
    """Return the messages of std_msgs/Float64 of a chunk: shape (n,), dtype DAMPING."""
    rows = np.zeros(len(column.stamp), DAMPING)
    rows['stamp'], rows['damping'] = column.stamp, np.nan
    for which, content in column.same_size():
        if content.shape[1] >= FLOAT64_SIZE:
            rows['damping'][which] = content[:, 4:FLOAT64_SIZE].copy().view('<f8')[:, 0]
    return rows


def joint_of(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the joint that the nodes of a recording are for."""
    return next((values['joint_name'] for values in parameters.values()
                 if 'joint_name' in values), 'axis')


class Series:
    """The messages of one topic of ours, collected as rows of ``kind``."""

    def __init__(self, kind: np.dtype[Any]) -> None:
        self._kind = kind
        self._rows = [np.zeros(0, kind)]
        self._times = [np.zeros(0, np.int64)]
        self._unstamped = [np.zeros(0, np.int64)]

    def add(self, column: Column, joint: str) -> None:
        """Take the messages of ``joint`` whose place is that of their stamp."""
        rows, known = np.zeros(len(column.time), self._kind), np.zeros(len(column.time), bool)
        layouts = layouts_of(self._kind, joint)
        for which, content in column.same_size():
            others = others_in(content, joint, known, which) if self._kind is SAMPLE else ()
            for number, layout in enumerate(chain(layouts, others)):
                if known[which].all():
                    break
                good, sec, nanosec, *values = layout.decode_rows(content)
                at = which[good]
                known[at] = True
                rows['stamp'][at] = sec[good] * np.int64(SECOND) + nanosec[good]
                if self._kind is IMPULSE:
                    rows['guard'][at] = number
                elif self._kind is SAMPLE:
                    rows['marked'][at] = layout.frame_id == RESET_MARK
                    rows['velocity'][at] = rows['effort'][at] = np.nan
                for name, value in zip(self._names(layout), values, strict=True):
                    rows[name][at] = value[good]
        self._unstamped.append(column.stamp[known & (rows['stamp'] == 0)])
        known &= rows['stamp'] == column.stamp
        self._rows.append(rows[known])
        self._times.append(column.time[known])

    @property
    def _measured(self) -> list[str]:
        return [name for name in self._kind.names or () if self._kind[name].kind == 'f']

    def _names(self, layout: JointStateLayout) -> Sequence[str]:
        """Return our names of the fields of a layout."""
        return self._measured if self._kind is IMPULSE else layout.fields

    @property
    def unstamped(self) -> np.ndarray:
        """Return the places [ns] of the messages that tell no stamp of their own."""
        return np.concatenate(self._unstamped)

    def in_order(self) -> np.ndarray:
        """Return the rows in the order of their log time."""
        rows, times = np.concatenate(self._rows), np.concatenate(self._times)
        self._rows, self._times = [rows], [times]  # the parts are not held twice
        if (times[1:] >= times[:-1]).all():
            return rows
        return rows[np.argsort(times, kind='stable')]


def others_in(content: np.ndarray, joint: str, known: np.ndarray, which: np.ndarray
              ) -> Iterator[JointStateLayout]:
    """
    Yield the layout of each state of ``joint`` that is not yet ``known`` when it is asked for.

    ``content`` of shape (k, size) are the bytes of the messages ``which`` of those ``known``.
    """
    for message, place in zip(content, which, strict=True):
        layout = None if known[place] else layout_in(message.tobytes(), joint)
        if layout and 'position' in layout.fields:
            yield layout


@cache
def layouts_of(kind: np.dtype[Any], joint: str) -> list[JointStateLayout]:
    """Return the layouts of the messages that rows of ``kind`` are made of."""
    if kind is IMPULSE:
        return [JointStateLayout(joint, guard) for guard in GUARDS]
    if kind is COMMAND:
        return [JointStateLayout(joint, guard, COMMANDED) for guard in GUARDS]
    return [JointStateLayout(joint, mark, fields) for fields in (FIELDS, WITHOUT_VELOCITY)
            for mark in ('', RESET_MARK)]
