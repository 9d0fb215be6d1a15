"""Read the parameters of nodes from the topics run_parameters and /parameter_events."""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.protocol import name_of, parse_node
from impulse_control_ros.core.tick import to_ns
from impulse_control_ros.files.joint_state_arrays import Messages
from impulse_control_ros.files.mcap_reader import Column
from impulse_control_ros.files.parameter_event import decode_parameter_event, TYPE
from impulse_control_ros.files.topic_choice import one_of, preferred, Selection
from impulse_control_ros.files.topics import PARAMETER_EVENTS, RUN_PARAMETERS

DEFAULT_JOINT = 'axis'
LAST = np.iinfo(np.int64).max


class Change(NamedTuple):
    """
    Parameters of the node ``node_id`` that apply from the state of ``stamp`` [ns] on.

    A controller answers this state with these parameters, and a plant steps on from this state.
    ``values`` has all parameters of the node by name, ``changed`` only those that were just set.
    The message was ``logged`` [ns] on a ``topic`` and has a ``place`` in the bag; its ``run`` is
    '' with a foreign plant.
    """

    stamp: int
    node_id: str
    values: dict[str, Any]
    changed: dict[str, Any]
    run: str
    topic: str
    logged: int
    place: int

    @property
    def node(self) -> str:
        """The full name of the node."""
        return name_of(self.node_id)

    @property
    def is_plant(self) -> bool:
        """Whether the node is a plant; a controller has an id or a set-point."""
        return self.node == self.node_id and 'x_r' not in self.values

    @property
    def source(self) -> str:
        """The name that has the namespace of the system: the topic, or the node."""
        return self.node if self.topic == PARAMETER_EVENTS else self.topic

    @property
    def anew(self) -> bool:
        """Whether the node becomes active; a controller then has an empty memory."""
        return not self.changed


class RunParameters:
    """
    The parameters that all nodes of a bag have published.

    Messages on run_parameters have all parameters of a node. On /parameter_events every ROS 2 node
    publishes what is new or changed; only nodes with a set-point are used.
    """

    def __init__(self, selection: Selection) -> None:
        self._selection = selection
        self._changes: dict[bytes, Change] = {}  # by message, without duplicates
        self._values: dict[str, dict[str, Any]] = {}  # by node, from /parameter_events
        self.notes: list[str] = []

    def add(self, column: Column, place: np.ndarray) -> None:
        """Add the events of a column; raises ValueError if they cannot be decoded."""
        try:
            for at, size, *when in zip(
                column.start, column.size, column.time.tolist(), place.tolist(), strict=True
            ):
                raw = column.content[at : at + size].tobytes()
                if raw not in self._changes:
                    self._changes[raw] = self._change(raw, column.topic, *when)
        except Exception as error:  # the library raises anything for bytes that are no event
            raise ValueError(
                f'{column.topic} cannot be decoded: {" ".join(str(error).split())}'
            ) from error

    def _change(self, raw: bytes, topic: str, logged: int, place: int) -> Change:
        sec, nanosec, node, values, changed = decode_parameter_event(raw, decoded)
        run, node_id = parse_node(node)
        if topic == PARAMETER_EVENTS:
            before = self._values.get(node_id)
            changed = changed if before is None else {**values, **changed}
            values = self._values[node_id] = {**(before or {}), **values, **changed}
        return Change(to_ns(sec, nanosec), node_id, values, changed, run, topic, logged, place)

    @property
    def joints(self) -> set[str]:
        """The joint of each system, according to its nodes."""
        told = [
            one
            for one in self._changes.values()
            if isinstance(one.values.get('joint_name'), str)
            and (one.topic != PARAMETER_EVENTS or 'x_r' in one.values)
        ]
        told.sort(key=lambda one: (one.topic == PARAMETER_EVENTS, not one.run))
        told = [one for one in told if one.topic == told[0].topic or one.run]
        names = preferred({one.source for one in told}, self._selection)
        first = {one.source: one.values['joint_name'] for one in reversed(told)}
        return {first[name] for name in names}

    def changes(self, run: str, near: str, by_place: bool) -> list[Change]:
        """
        Return the changes of a run, by stamp; for a foreign plant, those in a namespace.

        ``near`` is that namespace. ``by_place`` replaces ``logged`` by the position in the bag.
        Raises ValueError if several topics may have them.
        """
        if by_place:
            self._changes = {
                raw: one._replace(logged=one.place) for raw, one in self._changes.items()
            }
        every = [one for one in self._changes.values() if one.run == run]
        changes = [one for one in every if one.topic != PARAMETER_EVENTS]
        if not run:
            topic = one_of(RUN_PARAMETERS, {one.topic for one in changes}, self._selection, near)
            changes = [one for one in changes if one.topic == topic]
        return sorted(changes, key=lambda one: (one.stamp, one.logged)) or self._of_one_node(near)

    def _of_one_node(self, near: str) -> list[Change]:
        """Return the changes of the node with a set-point on /parameter_events, in order."""
        told = [
            one
            for one in self._changes.values()
            if one.topic == PARAMETER_EVENTS and 'x_r' in one.values
        ]
        nodes = preferred({one.node for one in told}, self._selection, near)
        if len(nodes) > 1:
            self.notes.append(
                f'several nodes have a set-point x_r, none is used: {", ".join(nodes)}'
            )
        return [one for one in told if [one.node] == nodes]


def decoded(raw: bytes) -> Any:
    """Decode an event; the bag need not have its message definition."""
    return typestore().deserialize_cdr(raw, TYPE)


@cache
def typestore() -> Any:
    """Return the message types of ROS 2 Jazzy."""
    from rosbags.typesys import get_typestore, Stores  # takes a tenth of a second

    return get_typestore(Stores.ROS2_JAZZY)


def by_recording(changes: Sequence[Change], states: Messages, log_time: bool) -> list[Change]:
    """
    Return the ``changes``, each with the stamp of the first state that was recorded after it.

    Changes on run_parameters already have that stamp, unless ``log_time`` replaced the stamps of
    the states. A change before the first state gets the stamp 0.
    """
    order = np.argsort(states.sent, kind='stable')
    stamps = np.append(states.stamps[order], LAST)
    stamps[0] = 0
    places = np.searchsorted(states.sent[order], [one.logged for one in changes], 'right')
    return [
        one._replace(stamp=stamp) if log_time or one.topic == PARAMETER_EVENTS else one
        for one, stamp in zip(changes, stamps[places].tolist(), strict=True)
    ]


def acting(changes: Sequence[Change], commands: Messages) -> list[Change]:
    """
    Return the ``changes`` except those of controllers that were not active at the time.

    Several controllers may publish their parameters for a state, but only one becomes active: the
    author of the next one of the ``commands``, which are in order.
    """
    at = np.searchsorted(commands.stamps, [change.stamp for change in changes])
    return [
        change
        for change, place in zip(changes, at.tolist(), strict=True)
        if change.is_plant
        or place == len(commands.rows)
        or commands.origins[commands.origin[place]].node_id == change.node_id
    ]
