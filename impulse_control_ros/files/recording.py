"""Bags of ours as arrays: what a run was."""

from collections.abc import Mapping
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

import numpy as np

from impulse_control_ros.core.impulse import GUARDS
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.bag import PACKAGE, PARAMETERS, ROLES
from impulse_control_ros.files.cdr import JointStateLayout, RESET_MARK
from impulse_control_ros.files.columns import BagError, Column, columns

SAMPLE = np.dtype([('stamp', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('effort', 'f8')])
COMMAND = np.dtype([('stamp', 'i8'), ('effort', 'f8')])
IMPULSE = np.dtype([('stamp', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'),
                    ('area', 'f8')])


@dataclass(frozen=True, kw_only=True)
class Recording:
    """
    What a bag holds of one joint.

    ``states`` (n,) of dtype SAMPLE, ``commands`` (n,) of COMMAND, ``impulses`` (k,) of IMPULSE,
    stamps in ns, the rest in SI units; ``parameters`` by node name and parameter name, and
    ``restarts`` (stamp, node, parameters) of nodes that came anew with others; ``receipt`` is
    what the recorder says at the end (messages, missing, repeated, foreign, wall_seconds), empty
    for a bag that was cut off. States of other joints, or out of their time, are left out.
    """

    states: np.ndarray
    commands: np.ndarray
    impulses: np.ndarray
    parameters: Mapping[str, Mapping[str, Any]]
    restarts: list[tuple[int, str, Mapping[str, Any]]]
    receipt: Mapping[str, str]


def storage_file(bag: str | Path) -> Path:
    """Return the MCAP file of a bag folder, or the file itself."""
    path = Path(bag)
    if path.is_file():
        return path
    found = sorted(path.glob('*.mcap'))
    if len(found) != 1:
        raise BagError(f'bag {str(bag)!r} has {len(found)} .mcap files; 1 is expected')
    return found[0]


def read(bag: str | Path) -> Recording:
    """Read a bag of ours; raises `BagError` for what is none."""
    path = storage_file(bag)
    series = {'joint_states': Series(SAMPLE), 'joint_commands': Series(COMMAND),
              'impulse_events': Series(IMPULSE)}
    parameters: dict[str, dict[str, Any]] = {}
    restarts: list[tuple[int, str, Mapping[str, Any]]] = []
    receipt: dict[str, str] = {}
    topics: set[str] = set()
    roles: dict[str, str] = {}
    for item in columns(path):
        if isinstance(item, Column):
            topics.add(item.topic)
            kind = roles.get(item.topic, item.topic.rsplit('/', 1)[-1])
            if kind in series:
                series[kind].add(item, joint_of(parameters))
        elif item.name.startswith(PARAMETERS):
            name, _, stamp = item.name.removeprefix(PARAMETERS).partition(':')
            values = {key: json.loads(value) for key, value in item.metadata.items()}
            if stamp and name in parameters:  # else one that told them late
                restarts.append((int(stamp), name, values))
            else:
                parameters[name] = values
        elif item.name == PACKAGE:
            roles = {item.metadata[role]: role for role in ROLES if role in item.metadata}
        elif item.name == 'recording':
            receipt = item.metadata
    states, commands, impulses = (one.in_order() for one in series.values())
    if topics and not len(states):
        raise BagError(f'{path}: no joint_states of joint {joint_of(parameters)!r} among its '
                       f'topics {", ".join(sorted(topics))}')
    return Recording(states=states, commands=commands, impulses=impulses,
                     parameters=parameters, restarts=restarts, receipt=receipt)


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

    def add(self, column: Column, joint: str) -> None:
        """Take the messages of ``joint`` whose place is that of their stamp."""
        rows, known = np.zeros(len(column.time), self._kind), np.zeros(len(column.time), bool)
        layouts = self._layouts(joint)
        for which, content in column.same_size():
            for number, layout in enumerate(layouts):
                good, sec, nanosec, *values = layout.decode_rows(content)
                at = which[good]
                known[at] = True
                rows['stamp'][at] = sec[good] * np.int64(SECOND) + nanosec[good]
                if self._kind is IMPULSE:
                    rows['guard'][at] = number
                for name, value in zip(self._measured, values, strict=True):
                    rows[name][at] = value[good]
        known &= rows['stamp'] == column.stamp
        self._rows.append(rows[known])
        self._times.append(column.time[known])

    @property
    def _measured(self) -> list[str]:
        return [name for name in self._kind.names or () if self._kind[name].kind == 'f']

    def _layouts(self, joint: str) -> list[JointStateLayout]:
        if self._kind is IMPULSE:
            return [JointStateLayout(joint, guard) for guard in GUARDS]
        if self._kind is COMMAND:
            return [JointStateLayout(joint, '', ('effort',))]
        return [JointStateLayout(joint, mark) for mark in ('', RESET_MARK)]

    def in_order(self) -> np.ndarray:
        """Return the rows in the order of their log time."""
        rows, times = np.concatenate(self._rows), np.concatenate(self._times)
        if (times[1:] >= times[:-1]).all():
            return rows
        return rows[np.argsort(times, kind='stable')]
