"""Bags as arrays: what a run was."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Metadata, Schema
from mcap_ros2.decoder import DecoderFactory
import numpy as np

from impulse_control_ros.files.bag import PACKAGE, PARAMETERS, ROLES
from impulse_control_ros.files.columns import BagError, Column, columns, Item, naming
from impulse_control_ros.files.series import (
    COMMAND,
    DAMPING,
    damping_of,
    IMPULSE,
    SAMPLE,
    Series,
)

JOINT_STATE, FLOAT64 = 'sensor_msgs/msg/JointState', 'std_msgs/msg/Float64'
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
    """Read a bag; raises `BagError` for what is none, or has no states."""
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
        self._ours = False
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
            self._ours, self._version = True, item.metadata.get('version', '')
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
            self._series[role].add(column, joint_of(self._parameters), self._ours)
        elif role == 'damping' and kind == FLOAT64:
            self._damping.append(damping_of(column))
        elif kind == PARAMETER_EVENT:
            decode = self._decoders.decoder_for('cdr', schema)
            self._changes += changes_of(column, decode) if decode else ()

    def recording(self) -> Recording:
        """Return it as a whole."""
        placed = self._series['joint_states'].placed
        states, commands, impulses = (one.in_order() for one in self._series.values())
        if self._topics and not len(states):
            raise ValueError(f'no joint_states of joint {joint_of(self._parameters)!r} among its '
                             f'topics {", ".join(sorted(map(self._typed, self._topics)))}')
        withdrawn = self._series['joint_commands'].unstamped
        damping, changes = np.concatenate(self._damping), self._changes
        if not self._ours:
            withdrawn, damping['stamp'] = placed(withdrawn), placed(damping['stamp'])
            damping = np.sort(damping, order='stamp', kind='stable')
            changes = [change._replace(stamp=int(placed(change.stamp))) for change in changes]
        return Recording(
            states=states, commands=commands, impulses=impulses, withdrawn=withdrawn,
            damping=damping, parameters=self._parameters,
            changes=sorted(changes, key=lambda change: (change.stamp, not change.anew)),
            version=self._version, receipt=self._receipt, unread=self._unread)

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


def joint_of(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the joint that the nodes of a recording are for."""
    return next((values['joint_name'] for values in parameters.values()
                 if 'joint_name' in values), 'axis')
