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
    Parameters of the node ``node_id`` that apply from the state of ``stamp`` [ns] on.

    A controller answers this state with these parameters, and a plant steps on from this state.
    ``values`` has all parameters of the node by name, ``changed`` only those that were just set.
    The message was ``logged`` [ns] in a ``namespace``; its ``run`` is '' with a foreign plant.
    """

    stamp: int
    node_id: str
    values: dict[str, Any]
    changed: dict[str, Any]
    run: str
    namespace: str
    logged: int

    @property
    def node(self) -> str:
        """The full name of the node."""
        return name_of(self.node_id)

    @property
    def is_plant(self) -> bool:
        """Whether the node is a plant; only controllers have an id."""
        return self.node == self.node_id

    @property
    def anew(self) -> bool:
        """Whether the node becomes active; a controller then has an empty memory."""
        return not self.changed


class RunParameters:
    """The parameters that all nodes of a bag have published."""

    def __init__(self) -> None:
        self._joints: dict[bool, str] = {}  # of the first node without a run (True) or with one
        self._changes: dict[bytes, Change] = {}  # each message once, however often it arrived
        self._decoders = DecoderFactory()

    def add(self, column: Column, namespace: str, schema: Schema | None) -> None:
        """Add the events of a column; raises ValueError if they cannot be decoded."""
        try:
            self._add(column, namespace, schema)
        except Exception as error:  # the library compiles the schema and may raise anything
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
            stamp = sec * SECOND + nanosec
            change = Change(stamp, node_id, values, changed, run, namespace, int(time))
            self._changes.setdefault(raw, change)
            joint = values.get('joint_name')
            if isinstance(joint, str):
                self._joints.setdefault(not run, joint)

    @property
    def joint(self) -> str:
        """The joint to look for among several; our plants have only one."""
        return self._joints.get(True, self._joints.get(False, DEFAULT_JOINT))

    def changes(self, run: str, namespace: str) -> list[Change]:
        """Return the changes of a run, by stamp; for a foreign plant, those in its namespace."""
        changes = [one for one in self._changes.values() if one.run == run]
        near = [one for one in changes if one.namespace == namespace]
        return sorted(
            near if near and not run else changes, key=lambda one: (one.stamp, one.logged)
        )


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
