"""The parameters of the nodes of a run, from the messages of the topic run_parameters."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
import numpy as np

from impulse_control_ros.core.protocol import name_of, parse_node
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.joint_state_arrays import Messages
from impulse_control_ros.files.mcap_reader import Column
from impulse_control_ros.files.parameter_event import decode_parameter_event

DEFAULT_JOINT = 'axis'


class Change(NamedTuple):
    """
    Parameters of the node ``node_id`` that act from the state of ``stamp`` [ns] on.

    A controller answers this state with them, and a plant steps on from it. ``values`` are all
    of the node by name, and ``changed`` those that were set then.
    """

    stamp: int
    node_id: str
    values: dict[str, Any]
    changed: dict[str, Any]

    @property
    def node(self) -> str:
        """The full name of the node."""
        return name_of(self.node_id)

    @property
    def is_plant(self) -> bool:
        """Whether it is a plant: a controller has an id."""
        return self.node == self.node_id

    @property
    def anew(self) -> bool:
        """Whether the node begins to act: a controller with an empty memory."""
        return not self.changed


class Told(NamedTuple):
    """A change as it was told: in a ``namespace``, of a ``run``, '' beside a foreign plant."""

    namespace: str
    run: str
    time: int
    change: Change


class RunParameters:
    """What all nodes of a bag tell of their parameters."""

    def __init__(self) -> None:
        self._joints: dict[bool, str] = {}  # of the first node in a run of ours, and beside none
        self._told: dict[bytes, Told] = {}  # once each, however often it came
        self._decoders = DecoderFactory()

    def add(self, column: Column, namespace: str, schema: Schema | None) -> None:
        """Take the events of a column; raises ValueError for what are none."""
        try:
            self._add(column, namespace, schema)
        except Exception as error:  # the library makes code of the schema: it raises anything
            raise ValueError(
                f'{column.topic} cannot be decoded: {" ".join(str(error).split())}'
            ) from error

    def _add(self, column: Column, namespace: str, schema: Schema | None) -> None:
        decode = self._decoders.decoder_for('cdr', schema)
        if not decode:
            return
        for at, size, time in zip(column.start, column.size, column.time, strict=True):
            raw = column.content[at : at + size].tobytes()
            sec, nanosec, node, values, changed = decode_parameter_event(raw, decode)
            run, node_id = parse_node(node)
            change = Change(sec * SECOND + nanosec, node_id, values, changed)
            self._told.setdefault(raw, Told(namespace, run, int(time), change))
            joint = values.get('joint_name')
            if isinstance(joint, str):
                self._joints.setdefault(not run, joint)

    @property
    def joint(self) -> str:
        """The joint to look for among several: our plants have one alone."""
        return self._joints.get(True, self._joints.get(False, DEFAULT_JOINT))

    def changes(self, run: str, namespace: str) -> list[Change]:
        """Return those of a run, by their stamps; of a foreign plant those in its namespace."""
        told = [one for one in self._told.values() if one.run == run]
        if not run and any(one.namespace == namespace for one in told):
            told = [one for one in told if one.namespace == namespace]
        return [one.change for one in sorted(told, key=lambda one: (one.change.stamp, one.time))]


def acting(changes: Sequence[Change], commands: Messages) -> list[Change]:
    """
    Return the ``changes`` without those of controllers that did not act then.

    Several may tell their parameters for a state, but one becomes the active controller: the
    author of the next of the ``commands``, which are in order.
    """
    at = np.searchsorted(commands.stamps, [change.stamp for change in changes])
    return [
        change
        for change, place in zip(changes, at.tolist(), strict=True)
        if change.is_plant
        or place == len(commands.rows)
        or commands.origins[commands.origin[place]].node_id == change.node_id
    ]
