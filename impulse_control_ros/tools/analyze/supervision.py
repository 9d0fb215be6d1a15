"""
The learnt values and the suspensions of a recorded run, recomputed with the law.

The law answers the recorded states again. If its verdicts are not the recorded ones, as in a bag
that begins in mid-run, nothing is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.learnt import Learnt
from impulse_control_ros.core.replay import learnt_at
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import BagError, ParameterError
from impulse_control_ros.files.recording import Recording
from impulse_control_ros.tools.resimulate import answered_states

FAILED = tuple(map(VERDICTS.index, ('absent', 'out_of_band', 'reversed')))  # of one impulse


@dataclass(frozen=True, kw_only=True)
class Supervision:
    """
    The k verdicts of a run, shape (k,); empty if they are not known.

    ``stamp`` [ns] is that of the verdict, ``learnt`` has the learnt values at it, and ``resumed``
    [ns] is the stamp at which impulses act again, 0 for a verdict that does not suspend them.
    """

    stamp: np.ndarray
    learnt: Sequence[Learnt]
    resumed: np.ndarray

    @property
    def suspensions(self) -> np.ndarray:
        """Return the first stamp of each suspension and the one after it [ns], shape (k, 2)."""
        return np.column_stack((self.stamp, self.resumed))[self.resumed > 0]

    def over(self, stamps: np.ndarray) -> dict[str, float]:
        """Return the fields of `Samples` for states with these ``stamps`` [ns]."""
        before = int(np.searchsorted(self.stamp, stamps[-1], 'right'))
        if not before:
            return {}
        learnt, spans = self.learnt[before - 1], np.clip(self.suspensions, stamps[0], stamps[-1])
        return {
            'learnt_mass': learnt.mass,
            'learnt_delay': learnt.delay,
            'suspended': float(np.sum(spans[:, 1] - spans[:, 0])) / SECOND,
        }


UNKNOWN = Supervision(stamp=np.zeros(0, int), learnt=(), resumed=np.zeros(0, int))


def supervision_of(recording: Recording) -> Supervision:
    """Answer the states of a recording once more, and return what the law has learnt."""
    recorded = recording.verdicts
    if not len(recorded):
        return UNKNOWN
    try:
        states, pieces, answers = answered_states(recording, {})
    except (BagError, ParameterError):
        return UNKNOWN
    judged = np.flatnonzero(answers['verdict'])
    stamps, verdicts = states['stamp'][judged], answers['verdict'][judged]
    if not (
        np.array_equal(stamps, recorded['stamp']) and np.array_equal(verdicts, recorded['verdict'])
    ):
        return UNKNOWN
    learnt = learnt_at(judged.tolist(), states['position'], states['velocity'], pieces)
    step = pieces[0].gains.time_step
    left = [round(one.suspended / step) if one.is_suspended_anew else 0 for one in learnt]
    until = states['stamp'][np.minimum(judged + left, len(states) - 1)]
    return Supervision(stamp=stamps, learnt=learnt, resumed=np.where(left, until, 0))


def failed_impulses(recording: Recording) -> np.ndarray:
    """Return the index of the state of each impulse that was not confirmed, shape (k,)."""
    fired, _ = recording.impulse_samples()
    verdicts = recording.verdicts
    judged = recording.places(verdicts['stamp'][np.isin(verdicts['verdict'], FAILED)])
    before = np.searchsorted(fired, judged) - 1
    return np.unique(fired[before[before >= 0]])
