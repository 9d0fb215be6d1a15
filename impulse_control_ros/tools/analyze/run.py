"""
A recorded run on its grid of samples: what was measured, and what it was to do.

==============  =====  ==================================================================
name            unit   meaning
==============  =====  ==================================================================
time            s      since the first state, by the stamps
error           m      e = x - x_r(t)
effort          N      u of the command that answers each state
impulse         N      its impulsive part
feedback        N      the rest of it
law             N      the feedback as the gains have it (4); 0 where the bag tells none
applied         N      the effort that acted from each state to the next
==============  =====  ==================================================================
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.metrics import impulsive
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.recording import Recording
from impulse_control_ros.tools.resimulate import with_velocities

NO_GAINS = {'x_r': 0.0, 'K': 0.0, 'D': 0.0, 'effort_limit': 0.0}


class Setting(NamedTuple):
    """Parameters of the controller, those of `NO_GAINS`, that act from the state ``first`` on."""

    first: int
    values: Mapping[str, float]


def settings_of(recording: Recording) -> list[Setting]:
    """
    Return what the controller was set to over the run: the one place that x_r(t) comes from.

    Empty where no controller of the bag tells a set-point; the first one has had it all along.
    """
    told = [change for change in recording.controllers if 'x_r' in change.values]
    firsts = np.searchsorted(recording.states['stamp'], [change.stamp for change in told])
    firsts[:1] = 0
    return [
        Setting(first, {name: change.values.get(name, value) for name, value in NO_GAINS.items()})
        for first, change in zip(firsts.tolist(), told, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class Run:
    """A recorded run by its ``name``, as shown, and the ``path`` of its bag, as given."""

    name: str
    path: Path
    recording: Recording

    @cached_property
    def states(self) -> np.ndarray:
        """Return the states, shape (n,), with the velocities that the controller took."""
        return with_velocities(self.recording)

    @cached_property
    def time(self) -> np.ndarray:
        """Return the time since the first state [s], shape (n,)."""
        stamps = self.states['stamp']
        return (stamps - stamps[0]) / SECOND

    @cached_property
    def settings(self) -> list[Setting]:
        """Return what the controller was set to; a set-point of 0 where nobody tells one."""
        return settings_of(self.recording) or [Setting(0, NO_GAINS)]

    @cached_property
    def error(self) -> np.ndarray:
        """Return e = x - x_r(t) [m], shape (n,)."""
        error = self.states['position'].copy()
        for part, values in self._spans():
            error[part] -= values['x_r']
        return error

    @cached_property
    def applied(self) -> np.ndarray:
        """
        Return the effort [N] from each state to the next, as the next one tells it, shape (n,).

        Where it does not, it is what was commanded last.
        """
        applied, commands = np.append(self.states['effort'][1:], 0.0), self.recording.commands
        last = np.searchsorted(commands['stamp'], self.states['stamp'], 'right')
        held = np.insert(commands['effort'], 0, 0.0)[last]
        return np.where(np.isnan(applied), held, applied)

    @cached_property
    def effort(self) -> np.ndarray:
        """Return the effort [N] of each state's command, or what was applied without one, (n,)."""
        effort, commands = self.applied.copy(), self.recording.commands
        place = self._places(commands['stamp'])
        answers = self.states['stamp'][place] == commands['stamp']
        effort[place[answers]] = commands['effort'][answers]
        return effort

    @cached_property
    def law(self) -> np.ndarray:
        """Return the feedback [N] that the gains give, shape (n,)."""
        law = np.zeros(len(self.states))
        for part, values in self._spans():
            limit = values['effort_limit'] or np.inf
            law[part] = np.clip(
                -values['K'] * self.error[part] - values['D'] * self.states['velocity'][part],
                -limit,
                limit,
            )
        return law

    @cached_property
    def fired(self) -> np.ndarray:
        """Return the index of the state of each impulse, shape (k,)."""
        return self._places(self.recording.impulses['stamp'])

    @cached_property
    def impulse(self) -> np.ndarray:
        """Return the impulsive part of the effort [N], shape (n,)."""
        fired = np.zeros(len(self.states), bool)
        fired[self.fired] = True
        return impulsive(self.effort, self.law, fired)

    @property
    def feedback(self) -> np.ndarray:
        """Return the effort without the impulses [N], shape (n,)."""
        return self.effort - self.impulse

    def _places(self, stamps: np.ndarray) -> np.ndarray:
        """Return the index of the state of each of ``stamps``, or of the next one."""
        return np.minimum(np.searchsorted(self.states['stamp'], stamps), len(self.states) - 1)

    @cached_property
    def responses(self) -> list[slice]:
        """
        Return the spans of states from each change of x_r, or reset, to the next.

        The first begins with the first answered state: a plant may be there before a controller.
        """
        answered = self._places(self.recording.commands['stamp'][:1]).tolist() or [0]
        starts = set(np.flatnonzero(self.states['is_reset']).tolist())
        starts |= {
            after.first
            for before, after in pairwise(self.settings)
            if before.values['x_r'] != after.values['x_r']
        }
        inside = sorted(start for start in starts if answered[0] < start < len(self.states))
        return [slice(*ends) for ends in pairwise([*answered, *inside, len(self.states)])]

    def _spans(self) -> list[tuple[slice, Mapping[str, float]]]:
        """Return each setting with its span of states."""
        ends = [setting.first for setting in self.settings[1:]] + [len(self.states)]
        return [
            (slice(setting.first, end), setting.values)
            for setting, end in zip(self.settings, ends, strict=True)
        ]
