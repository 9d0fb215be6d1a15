"""Collect the messages of a bag that belong to runs, by kind and topic."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

from mcap.records import Channel, Schema
import numpy as np

from impulse_control_ros.files.bag import PACKAGE, ROLES
from impulse_control_ros.files.joint_state_arrays import (
    COMMAND,
    DAMPING as DAMPING_ROWS,
    damping_rows,
    EVENT,
    JointStateTable,
    Messages,
    SAMPLE,
)
from impulse_control_ros.files.mcap_reader import Column, Cut, Item, Note
from impulse_control_ros.files.run_choice import is_by_place, Series, state_before
from impulse_control_ros.files.run_parameters import DEFAULT_JOINT, RunParameters
from impulse_control_ros.files.topic_choice import (
    absolute,
    namespace_of,
    one_of,
    preferred,
    require_selected,
    Selection,
)
from impulse_control_ros.files.topics import (
    DAMPING,
    FLOAT64,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATE,
    JOINT_STATES,
    PARAMETER_EVENTS,
    RUN_PARAMETERS,
    SERIES,
)

KINDS: dict[str, np.dtype[Any]] = {
    JOINT_STATES: SAMPLE,
    JOINT_COMMANDS: COMMAND,
    IMPULSE_EVENTS: EVENT,
}


def only(joints: Collection[str]) -> str:
    """Return the only joint; raises ValueError for several."""
    if len(joints) > 1:
        raise ValueError(f'its joints are {", ".join(sorted(joints))}: choose one with --joint')
    return next(iter(joints))


class System(NamedTuple):
    """
    The messages of one system: its ``series``, and ``damping`` with publish times as stamps.

    ``namespace`` is the namespace of its states. If ``by_place``, the publish times are replaced
    by positions in the bag, because the recorder's clock was coarse or was set back.
    """

    series: Series
    damping: np.ndarray
    namespace: str
    by_place: bool


class BagContent:
    """The contents of a bag read so far; messages of several joints are read for ``joint``."""

    def __init__(self, selection: Selection, joint: str) -> None:
        self.selection, self.joint = selection, joint
        self.parameters = RunParameters(selection)
        self.about: Mapping[str, str] | None = None
        self.summary: Mapping[str, str] = {}
        self.unread: int | None = None
        self.notes: list[str] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[str, tuple[Channel, str]] = {}  # with its type, by topic
        self._tables: dict[str, dict[str, JointStateTable]] = {role: {} for role in KINDS}
        self._damping: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        self._topics: set[str] = set()
        self._content, self._before = np.zeros(0, np.uint8), 0

    @property
    def is_ours(self) -> bool:
        """Whether our recorder, or a compatible writer, made the bag."""
        return self.about is not None

    def add(self, item: Item) -> None:
        """Add an item of a file."""
        if isinstance(item, Column):
            self._add_messages(item._replace(topic=absolute(item.topic)))
        elif isinstance(item, Schema):
            self._schemas[item.id] = item
        elif isinstance(item, Channel):
            schema = self._schemas.get(item.schema_id)
            self._channels[absolute(item.topic)] = item, schema.name if schema else ''
        elif isinstance(item, Cut):
            self.unread = (self.unread or 0) + item.unread
        elif isinstance(item, Note):
            self.notes.append(item.text)
        elif item.name == PACKAGE:
            self.about = item.metadata
        elif item.name == 'recording':
            self.summary = item.metadata

    def _add_messages(self, column: Column) -> None:
        """Add the messages of a topic."""
        topic = column.topic
        self._topics.add(topic)
        if column.content is not self._content:
            self._before += len(self._content)
            self._content = column.content
        place = column.start + self._before
        if self.selection.log_time:
            column = column._replace(stamp=column.time)
        channel, kind = self._channels[topic]
        role = self._role(topic)
        if channel.message_encoding != 'cdr':
            return
        if role in KINDS and kind == JOINT_STATE:
            if topic not in self._tables[role]:
                self._tables[role][topic] = JointStateTable(KINDS[role], self.joint)
            self._tables[role][topic].add(
                column, place, in_place=self.is_ours and not self.selection.log_time
            )
        elif role == DAMPING and kind == FLOAT64:
            self._damping.setdefault(topic, []).append((damping_rows(column), place))
        elif kind == SERIES[RUN_PARAMETERS] and (
            role == RUN_PARAMETERS or topic == PARAMETER_EVENTS
        ):
            self.parameters.add(column, place)

    def _role(self, topic: str) -> str:
        """Return the kind of a topic by its name; a selected topic of another name has states."""
        ours = {role: name for role, name in (self.about or {}).items() if role in ROLES}
        if ours and topic.rpartition('/')[2] in ROLES:  # our recorder records one plant
            return next((role for role, name in ours.items() if name == topic), '')
        name = next((role for role, of in ours.items() if of == topic), topic.rpartition('/')[2])
        is_selected = topic in map(absolute, self.selection.topics)
        return JOINT_STATES if is_selected and name not in (*SERIES, DAMPING) else name

    def joint_told(self) -> str:
        """
        Return the joint to read: selected, from parameters, `DEFAULT_JOINT`, or the only one.

        Raises ValueError if several joints remain.
        """
        if self.selection.joint:
            return self.selection.joint
        if joints := self.parameters.joints:
            return only(joints)
        tables = self._tables[JOINT_STATES]
        joints = set[str]().union(
            *(tables[topic].joints for topic in preferred(tables, self.selection))
        )
        if DEFAULT_JOINT in joints or not joints:
            return DEFAULT_JOINT
        return only(joints)

    def system(self) -> System:
        """
        Return the messages of the system; may be called only once.

        Raises ValueError for several systems, without states, or if all stamps are 0.
        """
        require_selected(self.selection, self._topics)
        read = {
            role: {topic: table.messages() for topic, table in tables.items()}
            for role, tables in self._tables.items()
        }
        states = self._with_states(read[JOINT_STATES])
        if self._topics and not states:
            raise ValueError(
                f'no joint_states of joint {self.joint!r} among its topics '
                f'{", ".join(sorted(map(self._typed, self._topics)))}{self._why_no_states()}'
            )
        self._note_unreadable()
        topic = one_of(f'states of joint {self.joint!r}', states, self.selection)
        near = namespace_of(topic)
        answers = (self._one(role, read[role], near) for role in (JOINT_COMMANDS, IMPULSE_EVENTS))
        damping = self._damping.get(one_of(DAMPING, self._damping, self.selection, near), [])
        every = Series(states.get(topic) or self._none(JOINT_STATES), *answers)
        return self._timed(every, damping, near)

    def _why_no_states(self) -> str:
        """Return why messages on topics of states are none, '' where there is no such message."""
        return ''.join(
            f'; the messages on {topic} cannot be read: {reason}'
            for topic, table in self._tables[JOINT_STATES].items()
            for reason in (*table.unreadable, *(f'{one} is empty' for one in table.empty))
        )

    def _note_unreadable(self) -> None:
        """Note the messages that cannot be read."""
        self.notes += [
            f'{count} messages on {topic} are left out: {reason}'
            for tables in self._tables.values()
            for topic, table in tables.items()
            for reason, count in table.unreadable.items()
        ]

    def _with_states(self, found: Mapping[str, Messages]) -> dict[str, Messages]:
        """Return the messages by topic, of topics with states of the joint or selected run."""
        if self.selection.joint:
            found = {
                topic: messages.from_origins(lambda origin: origin.joint == self.joint)
                for topic, messages in found.items()
            }
        runs = {
            topic: {
                origin.header.run
                for origin, count in messages.counts()
                if count and (origin.header.run or origin.joint == self.joint)
            }
            for topic, messages in found.items()
        }
        chosen = [
            topic for topic in found if self.selection.run and self.selection.run in runs[topic]
        ]
        return {topic: found[topic] for topic in chosen or found if runs[topic]}

    def _one(self, role: str, found: Mapping[str, Messages], near: str) -> Messages:
        """Return the messages of the topic of a ``role``."""
        topic = one_of(
            role,
            [name for name, messages in found.items() if len(messages.rows)],
            self.selection,
            near,
        )
        return found.get(topic) or self._none(role)

    def _none(self, role: str) -> Messages:
        """Return no messages."""
        return JointStateTable(KINDS[role], self.joint).messages()

    def _timed(
        self, series: Series, damping: list[tuple[np.ndarray, np.ndarray]], near: str
    ) -> System:
        """Return a system with the selected stamps, in the order of recording."""
        states, *answers = series
        rows = np.concatenate([np.zeros(0, DAMPING_ROWS), *(part for part, _ in damping)])
        if self.selection.log_time:
            states.rows['stamp'] = states.sent
        elif len(states.rows) and not states.stamps.any():
            raise ValueError(
                'the stamps of its states are 0: --time log takes the times at which they were '
                'recorded'
            )
        by_place = not self.is_ours and is_by_place(states.sent)
        if by_place:
            states, *answers = (part._replace(sent=part.place) for part in series)
            rows['stamp'] = np.concatenate(
                [np.zeros(0, np.int64), *(place for _, place in damping)]
            )
        for messages in answers if self.selection.log_time else ():
            messages.rows['stamp'] = state_before(states, messages.sent)
        self._note_stamps(states, answers[0])
        return System(Series(states.where(states.stamps > 0), *answers), rows, near, by_place)

    def _note_stamps(self, states: Messages, commands: Messages) -> None:
        """Add notes on messages without a stamp."""
        if missing := int(np.count_nonzero(states.stamps == 0)):
            self.notes.append(f'{missing} states with a stamp of 0 are left out')
        if len(commands.rows) and not commands.stamps.any():
            self.notes.append(
                'the stamps of its commands are 0, so they answer no state: --time log takes the '
                'times at which they were recorded'
            )

    def _typed(self, topic: str) -> str:
        """Return a topic with its type, if known, and its encoding, if not CDR."""
        channel, kind = self._channels[topic]
        encoding = channel.message_encoding
        told = [*filter(None, [kind, '' if encoding == 'cdr' else f'encoded as {encoding!r}'])]
        return f'{topic} ({", ".join(told)})' if told else topic
