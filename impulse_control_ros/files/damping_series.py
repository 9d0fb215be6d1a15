"""The damping of a bag: messages without a stamp, which belong to a state."""

import numpy as np

from impulse_control_ros.files.joint_state_arrays import DAMPING
from impulse_control_ros.files.mcap_reader import Column
from impulse_control_ros.files.run_choice import OneRun, placed

SIZE = 12  # of a std_msgs/Float64


class DampingSeries:
    """The messages of std_msgs/Float64 on topics called damping."""

    def __init__(self) -> None:
        self._rows: dict[str, list[np.ndarray]] = {}

    def add(self, column: Column, namespace: str) -> None:
        """Take the messages of a column."""
        rows = np.zeros(len(column.stamp), DAMPING)
        rows['stamp'], rows['damping'] = column.stamp, np.nan
        for which, content in column.same_size():
            if content.shape[1] >= SIZE:
                rows['damping'][which] = content[:, 4:SIZE].copy().view('<f8')[:, 0]
        self._rows.setdefault(namespace, []).append(rows)

    def of(self, run: OneRun, is_ours: bool) -> np.ndarray:
        """
        Return that of a run, in the order of time: shape (n,), dtype DAMPING.

        In a bag of our recorder (``is_ours``) the publish times are those of the states. Other
        recorders know only when a message was sent: after the state that it belongs to.
        """
        near = self._rows.get(run.source.namespace)
        parts = [near] if near else [*self._rows.values()]
        rows = np.concatenate([np.zeros(0, DAMPING), *(one for part in parts for one in part)])
        if is_ours:
            return rows
        sent = rows['stamp'].copy()
        rows['stamp'] = placed(run.series.states, sent)
        first, last = run.span
        rows = rows[(rows['stamp'] > 0) & (sent >= first) & (sent < last)]
        return np.sort(rows, order='stamp', kind='stable')
