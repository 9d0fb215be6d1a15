"""Read the recording of a run from a bag, as arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
import numpy as np

from impulse_control_ros.core.protocol import StateHeader
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.core.trajectory import Trajectory
from impulse_control_ros.files.bag import PACKAGE, ROLES
from impulse_control_ros.files.completeness import lacking
from impulse_control_ros.files.joint_state_arrays import (
    COMMAND,
    damping_rows,
    IMPULSE,
    JointStateTable,
    Messages,
    SAMPLE,
)
from impulse_control_ros.files.mcap_reader import Column, columns, Cut, Item, naming, storage_file
from impulse_control_ros.files.run_choice import (
    choose,
    damping_of,
    NO_SOURCE,
    one_run,
    OneRun,
    Series,
    state_before,
)
from impulse_control_ros.files.run_parameters import acting, Change, DEFAULT_JOINT, RunParameters
from impulse_control_ros.files.settings import Setting, settings_of, spans
from impulse_control_ros.files.topics import (
    DAMPING,
    FLOAT64,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATE,
    JOINT_STATES,
    RUN_PARAMETERS,
    SERIES,
)

KINDS = {JOINT_STATES: SAMPLE, JOINT_COMMANDS: COMMAND, IMPULSE_EVENTS: IMPULSE}


@dataclass(frozen=True, kw_only=True)
class Recording(Trajectory):
    """
    The recording of one run of one joint.

    ``run`` is its id, '' for a foreign plant. The arrays ``states`` (n,), ``commands`` (n,),
    ``impulses`` (k,) and ``damping`` (j,) have dtypes SAMPLE, COMMAND, IMPULSE and DAMPING. Stamps
    are in ns, other values in SI units; an unmeasured velocity or effort is nan. ``is_reset``
    marks states at which one of our plants starts or is reset. After each state with a stamp in
    ``withdrawn`` [ns], the controller withdrew its effort, for example because states stopped
    arriving, and cleared its memory. ``history`` has the parameters of plants and controllers and
    their changes, by stamp. ``version`` is the version of the package that recorded the bag.
    ``recording_summary`` has the final counts of the recorder (messages, missing, repeated,
    foreign, wall_seconds); it is empty for an unfinished bag. ``unread`` is then the number of
    bytes at the end that form no whole record, and None for a finished bag. ``lacks`` lists in
    sentences what is missing. States of other joints, and states out of order, are left out.

    ``time`` [s], ``position`` [m], ``velocity`` [m/s] (nan if not measured), ``effort`` [N] (the
    command that answers each state, nan if none) and ``set_point`` [m] (0 if unknown) have shape
    (n,).
    """

    run: str
    states: np.ndarray
    commands: np.ndarray
    withdrawn: np.ndarray
    impulses: np.ndarray
    damping: np.ndarray
    history: list[Change]
    version: str
    recording_summary: Mapping[str, str]
    unread: int | None
    lacks: list[str]

    @cached_property
    def time(self) -> np.ndarray:
        """Time [s] since the first state, by the stamps."""
        stamps = self.states['stamp']
        return (stamps - stamps[:1]) / SECOND

    @property
    def position(self) -> np.ndarray:
        """Position [m] of each state."""
        return self.states['position']

    @property
    def velocity(self) -> np.ndarray:
        """Velocity [m/s] of each state."""
        return self.states['velocity']

    @cached_property
    def effort(self) -> np.ndarray:
        """Effort [N] of the command that answers each state."""
        effort, place = np.full(len(self.states), np.nan), self.places(self.commands['stamp'])
        answers = self.states['stamp'][place] == self.commands['stamp']
        effort[place[answers]] = self.commands['effort'][answers]
        return effort

    @cached_property
    def settings(self) -> list[Setting]:
        """The settings of the controller; empty if no controller publishes a set-point."""
        return settings_of(self.states['stamp'], self.controllers)

    @cached_property
    def set_point(self) -> np.ndarray:
        """Set-point [m] at each state."""
        set_point = np.zeros(len(self.states))
        for part, values in spans(self.settings, len(self.states)):
            set_point[part] = values['x_r']
        return set_point

    def impulse_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the index of the state, and the guard, of each impulse."""
        return self.places(self.impulses['stamp']), self.impulses['guard']

    def places(self, stamps: np.ndarray) -> np.ndarray:
        """Return the index of the state at or after each of ``stamps`` [ns]."""
        return np.minimum(np.searchsorted(self.states['stamp'], stamps), len(self.states) - 1)

    @cached_property
    def _first(self) -> dict[str, Change]:
        """The initial parameters of each node: its last change before the first state."""
        start = self.states['stamp'][0] if len(self.states) else 0
        first: dict[str, Change] = {}
        for change in self.history:
            if change.node not in first or change.stamp < start:
                first[change.node] = change
        return first

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """The initial parameters of each node, by its full name."""
        return {node: change.values for node, change in self._first.items()}

    @property
    def changes(self) -> list[Change]:
        """The changes during the run, by stamp, including nodes that become active."""
        start = self.states['stamp'][0] if len(self.states) else 0
        return [
            change
            for change in self.history
            if change.stamp > start
            or (change.stamp == start and change is not self._first[change.node])
        ]

    @property
    def plant(self) -> list[Change]:
        """The parameters of the plant, if it is one of ours."""
        return [change for change in self.history if self.run and change.is_plant]

    @property
    def controllers(self) -> list[Change]:
        """The parameters of the controllers, each from the state at which it becomes active."""
        return [change for change in self.history if not change.is_plant]


def read_bag(bag: str | Path, run: str = '') -> Recording:
    """
    Read the run with the name ``run`` from a bag, or the longest one by default.

    The name is a run's id or, for a foreign plant, the namespace of its joint_states. Raises
    `BagError` for an invalid bag or a bag without states.
    """
    path = storage_file(bag)
    with naming(path):
        found = _Gathered(DEFAULT_JOINT)
        for item in columns(path):
            found.add(item)
            if found.parameters.joint != DEFAULT_JOINT:
                break
        if found.parameters.joint != DEFAULT_JOINT:  # from the start, for this joint
            found = _Gathered(found.parameters.joint)
            for item in columns(path):
                found.add(item)
        return found.recording(run)


class _Gathered:
    """The contents of a bag read so far; messages of several joints are read for ``joint``."""

    def __init__(self, joint: str) -> None:
        self.parameters = RunParameters()
        self._joint = joint
        self._schemas: dict[int, Schema] = {}
        self._types: dict[str, Schema | None] = {}  # by topic
        self._series = {role: JointStateTable(kind, joint) for role, kind in KINDS.items()}
        self._damping: dict[str, list[np.ndarray]] = {}
        self._about: Mapping[str, str] | None = None
        self._summary: Mapping[str, str] = {}
        self._unread: int | None = None
        self._topics: set[str] = set()

    def add(self, item: Item) -> None:
        """Add an item of a file."""
        if isinstance(item, Column):
            self._add_messages(item)
        elif isinstance(item, Schema):
            self._schemas[item.id] = item
        elif isinstance(item, Channel):
            self._types[item.topic] = self._schemas.get(item.schema_id)
        elif isinstance(item, Cut):
            self._unread = item.unread
        elif item.name == PACKAGE:
            self._about = item.metadata
        elif item.name == 'recording':
            self._summary = item.metadata

    def _add_messages(self, column: Column) -> None:
        """Add the messages of a topic."""
        self._topics.add(column.topic)
        namespace, _, name = column.topic.rpartition('/')
        about, schema = self._about or {}, self._types.get(column.topic)
        role = next((role for role in ROLES if about.get(role) == column.topic), name)
        # our recorder records one plant, whatever the names of its topics
        namespace = '/' if self._is_ours else namespace or '/'
        kind = schema.name if schema else ''
        if role in KINDS and kind == JOINT_STATE:
            self._series[role].add(column, namespace, in_place=self._is_ours)
        elif role == DAMPING and kind == FLOAT64:
            self._damping.setdefault(namespace, []).append(damping_rows(column))
        elif role == RUN_PARAMETERS and kind == SERIES[RUN_PARAMETERS]:
            self.parameters.add(column, namespace, schema)

    def recording(self, name: str) -> Recording:
        """Return the recording of the run with that ``name``, '' for any."""
        every = Series(*(self._series[role].messages() for role in KINDS))
        every = every._replace(states=every.states.where(every.states.stamps > 0))
        run = self._about.get('run', '') if self._about is not None else None
        source = choose(every.states, self._joint, run, name)
        if self._topics and not source:
            raise ValueError(
                f'no joint_states of joint {self._joint!r} among its topics '
                f'{", ".join(sorted(map(self._typed, self._topics)))}'
            )
        return self._recording_of(one_run(every, source or NO_SOURCE, self._is_ours))

    def _recording_of(self, found: OneRun) -> Recording:
        run, (states, commands, impulses) = found.source.run, found.series
        changes = self.parameters.changes(run, found.source.namespace)
        if run:
            changes = acting(changes, commands)
            mark_resets(states, changes)
        withdrawn = found.withdrawn.sent
        return Recording(
            run=run,
            states=states.rows,
            commands=commands.rows,
            impulses=impulses.rows,
            withdrawn=withdrawn if self._is_ours else state_before(states, withdrawn),
            damping=damping_of(found, self._damping, self._is_ours),
            history=changes,
            version=(self._about or {}).get('version', ''),
            recording_summary=self._summary,
            unread=self._unread,
            lacks=lacking(found, changes),
        )

    @property
    def _is_ours(self) -> bool:
        """Whether our recorder, or a compatible writer, made the bag."""
        return self._about is not None

    def _typed(self, topic: str) -> str:
        """Return a topic with its type, if known."""
        schema = self._types.get(topic)
        return f'{topic} ({schema.name})' if schema else topic


def mark_resets(states: Messages, changes: Sequence[Change]) -> None:
    """
    Mark the states at which one of our plants starts or is reset.

    A reset begins a new episode. The plant publishes its parameters for the first state of a run;
    if the bag lacks them, the first state is the one that names no controller.
    """
    is_reset, header = states.rows['is_reset'], states.origins[states.origin[0]].header
    is_reset[1:] = np.diff(states.per_message(lambda origin: origin.header.episode)) != 0
    # a plant that waits for the wall clock publishes its parameters again at its start
    starts = {change.stamp for change in changes if change.is_plant and change.anew}
    is_reset[0] = states.stamps[0] in starts if starts else header == StateHeader(header.run)
