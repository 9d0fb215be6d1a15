"""Read the recording of a run from a bag, as arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from impulse_control_ros.core.protocol import StateHeader
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.core.trajectory import Trajectory
from impulse_control_ros.files.bag_content import BagContent
from impulse_control_ros.files.bag_reader import items
from impulse_control_ros.files.completeness import is_mid_run, lacking
from impulse_control_ros.files.joint_state_arrays import Messages
from impulse_control_ros.files.mcap_reader import naming
from impulse_control_ros.files.run_choice import (
    choose,
    damping_of,
    NO_RUN,
    one_run,
    runs_in,
    state_before,
)
from impulse_control_ros.files.run_parameters import acting, by_recording, Change, DEFAULT_JOINT
from impulse_control_ros.files.settings import Setting, settings_of, spans
from impulse_control_ros.files.topic_choice import Selection


@dataclass(frozen=True, kw_only=True)
class Recording(Trajectory):
    """
    The recording of one run of one joint.

    ``run`` is its id, '' for a foreign plant. The arrays ``states`` (n,), ``commands`` (n,),
    ``events`` (k,) and ``damping`` (j,) have dtypes SAMPLE, COMMAND, EVENT and DAMPING. Stamps
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
    events: np.ndarray
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

    @property
    def begins_in_mid_run(self) -> bool:
        """Whether the run began before the first state."""
        return bool(len(self.states)) and is_mid_run(self.states, self.run)

    @cached_property
    def impulses(self) -> np.ndarray:
        """The events at which an impulse starts."""
        return self.events[(self.events['guard'] > 0) | (self.events['verdict'] == 0)]

    @cached_property
    def verdicts(self) -> np.ndarray:
        """The events with a verdict of the supervision on an earlier impulse."""
        return self.events[self.events['verdict'] > 0]

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


def read_bag(
    bag: str | Path,
    run: str | int = '',
    *,
    joint: str = '',
    namespace: str = '',
    topics: Sequence[str] = (),
    log_time: bool = False,
) -> Recording:
    """
    Read one run of a bag: the one with the number or id ``run``, or the last one by default.

    ``joint``, ``namespace`` and ``topics`` select among several joints, systems and topics of one
    kind. ``log_time`` replaces the stamps by the times of recording. Raises `BagError` for an
    invalid bag, a bag without states, or an ambiguous selection.
    """
    selection = Selection(str(run), joint, namespace, topics, log_time)
    with naming(Path(bag)):
        content = BagContent(selection, joint or DEFAULT_JOINT)
        for item in items(bag):
            content.add(item)
            if not joint and content.parameters.joints - {DEFAULT_JOINT}:
                break
        if (told := content.joint_told()) != content.joint:  # read again for this joint
            content = BagContent(selection, told)
            for item in items(bag):
                content.add(item)
            content.joint_told()
        return recording_of(content)


def recording_of(content: BagContent) -> Recording:
    """Return the selected run; raises ValueError if it is ambiguous."""
    about, is_ours = content.about or {}, content.is_ours
    every, damping, near, by_place = content.system()
    runs = runs_in(every.states, content.joint, is_ours)
    recorded = about.get('run', '') if is_ours else None
    found = one_run(every, choose(runs, content.selection.run, recorded) or NO_RUN, runs)
    run, (states, commands, events) = found.source.run, found.series
    changes = content.parameters.changes(run, near, by_place)
    if run:
        changes = acting(changes, commands)
        mark_resets(states, changes)
    elif len(states.rows):
        changes = by_recording(changes, states, content.selection.log_time)
    withdrawn = found.withdrawn.sent
    return Recording(
        run=run,
        states=states.rows,
        commands=commands.rows,
        events=events.rows,
        withdrawn=withdrawn if is_ours else state_before(states, withdrawn),
        damping=damping_of(found, damping, is_ours),
        history=changes,
        version=about.get('version', ''),
        recording_summary=content.summary,
        unread=content.unread,
        lacks=[*content.notes, *content.parameters.notes, *lacking(found, changes)],
    )


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
