"""
A recorded run on its grid of samples: what was measured, and what was commanded.

==========  ====  =========================================================
name        unit  meaning, all of shape (n,)
==========  ====  =========================================================
time        s     since the first state, by the stamps
error       m     e = x - x_r(t)
command     N     u of the command that answers each state
impulse     N     its impulsive part
feedback    N     the rest of it
law         N     the feedback (4) by the gains; 0 where the bag has none
applied     N     the effort that acted from each state to the next
==========  ====  =========================================================
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from impulse_control_ros.core.metric_catalogue import Samples
from impulse_control_ros.core.metrics import impulsive
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.errors import DivergedError
from impulse_control_ros.files.recording import Recording
from impulse_control_ros.files.settings import NO_GAINS, Setting, spans
from impulse_control_ros.tools.analyze.supervision import Supervision, supervision_of
from impulse_control_ros.tools.resimulate import with_velocities


@dataclass(frozen=True, kw_only=True)
class Run:
    """
    A recorded run by its ``name``, as shown, and the ``path`` of its bag, as given.

    ``x_r`` is the set-point [m] if the bag is not to tell it.
    """

    name: str
    path: Path
    recording: Recording
    x_r: float | None = None

    @cached_property
    def states(self) -> np.ndarray:
        """Return the states, shape (n,), with the velocities that the controller took."""
        return with_velocities(self.recording)

    @cached_property
    def time(self) -> np.ndarray:
        """Return the time since the first state [s], shape (n,)."""
        return self.recording.time

    @cached_property
    def settings(self) -> list[Setting]:
        """Return what the controller was set to; a set-point of 0 where nobody tells one."""
        told = self.recording.settings or [Setting(0, NO_GAINS)]
        if self.x_r is None:
            return told
        return [Setting(first, {**values, 'x_r': self.x_r}) for first, values in told]

    @cached_property
    def error(self) -> np.ndarray:
        """Return e = x - x_r(t) [m], shape (n,)."""
        error = self.recording.position.copy()
        for part, values in spans(self.settings, len(error)):
            error[part] -= values['x_r']
        return error

    @cached_property
    def applied(self) -> np.ndarray:
        """
        Return the effort [N] from each state to the next, as the next one tells it, shape (n,).

        Where it does not, it is what was commanded last; nan where nothing was. It goes on
        behind the last state.
        """
        effort, commands = self.states['effort'], self.recording.commands
        applied = np.append(effort[1:], effort[-1:])
        last = np.searchsorted(commands['stamp'], self.states['stamp'], 'right')
        held = np.insert(commands['effort'], 0, np.nan)[last]
        return np.where(np.isnan(applied), held, applied)

    @cached_property
    def command(self) -> np.ndarray:
        """Return the effort [N] of each state's command, or what was applied without one, (n,)."""
        command = self.recording.effort
        return np.where(np.isnan(command), self.applied, command)

    @cached_property
    def law(self) -> np.ndarray:
        """Return the feedback [N] that the gains give, nan without a velocity, shape (n,)."""
        law = np.zeros(len(self.states))
        for part, values in spans(self.settings, len(self.states)):
            limit, D = values['effort_limit'] or np.inf, values['D']
            braking = D * self.states['velocity'][part] if D else 0.0
            law[part] = np.clip(-values['K'] * self.error[part] - braking, -limit, limit)
        return law

    @cached_property
    def fired(self) -> np.ndarray:
        """Return the index of the state of each impulse, shape (k,)."""
        return self.recording.impulse_samples()[0]

    @cached_property
    def impulse(self) -> np.ndarray:
        """Return the impulsive part of the command [N], shape (n,)."""
        fired = np.zeros(len(self.states), bool)
        fired[self.fired] = True
        return impulsive(self.command, self.law, fired)

    def panel(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return time [s] and values, shape (n,), of what one of the `PANELS` shows."""
        time = self.time
        if name == 'damping':
            damping = self.recording.damping
            time, values = (damping['stamp'] - self.states['stamp'][0]) / SECOND, damping[name]
        else:
            values = self.states[name] if name in ('position', 'velocity') else getattr(self, name)
        # no axis can show what is near overflow
        return time, np.where(np.abs(values) < DivergedError.bound, values, np.nan)

    def shows(self, name: str) -> bool:
        """Tell whether one of the `PANELS` has a finite value."""
        return bool(np.isfinite(self.panel(name)[1]).any())

    @cached_property
    def supervision(self) -> Supervision:
        """Return what the supervision has learnt and suspended."""
        return supervision_of(self.recording)

    @property
    def feedback(self) -> np.ndarray:
        """Return the command without its impulsive part [N], shape (n,)."""
        return self.command - self.impulse

    @cached_property
    def responses(self) -> list[slice]:
        """
        Return the spans of states from each change of x_r, or reset, to the next.

        The first begins with the first answered state: a plant may be there before a controller.
        Where no command has the stamp of a state, it begins with the first effort that acts.
        """
        answered = self.recording.places(self.recording.commands['stamp'][:1]).tolist()
        if not answered:
            acted = np.flatnonzero(np.nan_to_num(self.states['effort']))
            answered = [max(acted[0] - 1, 0)] if len(acted) else [0]
        starts = set(np.flatnonzero(self.states['is_reset']).tolist())
        starts |= {
            after.first
            for before, after in pairwise(self.settings)
            if before.values['x_r'] != after.values['x_r']
        }
        inside = sorted(start for start in starts if answered[0] < start < len(self.states))
        return [slice(*ends) for ends in pairwise([*answered, *inside, len(self.states)])]

    def samples(self, span: slice) -> Samples:
        """Return the samples of a ``span`` of the states, for its metrics."""
        impulses = self.recording.impulses[(self.fired >= span.start) & (self.fired < span.stop)]
        judged = self.recording.places(self.recording.verdicts['stamp'])
        verdicts = self.recording.verdicts[(judged >= span.start) & (judged < span.stop)]
        states, steps = self.states[span], np.diff(self.states['stamp'][span])
        gaps = np.rint(steps / int(np.median(steps))) - 1 if len(steps) else steps
        return Samples(
            time=self.time[span],
            position=states['position'],
            error=self.error[span],
            velocity=states['velocity'],
            command=self.command[span],
            impulse=self.impulse[span],
            applied=self.applied[span],
            guard=impulses['guard'],
            area=impulses['area'],
            missing=int(np.maximum(gaps, 0).sum()),
            verdict=verdicts['verdict'],
            **self.supervision.over(states['stamp']),
        )
