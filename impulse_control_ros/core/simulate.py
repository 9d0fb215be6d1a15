"""Offline simulation of the closed loop with the kernels of the nodes, to the same bits."""

from dataclasses import dataclass

import numpy as np

from impulse_control_ros.core.closed_loop import ClosedLoop, empty_trace, first_diverged, Trace
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import NO_IMPULSE
from impulse_control_ros.core.impulse_verdicts import NO_VERDICT
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.tick import require_duration, ticks
from impulse_control_ros.core.trajectory import Trajectory
from impulse_control_ros.errors import DivergedError

EVENT = np.dtype(
    [('tick', 'i8'), ('guard', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('area', 'f8')]
)
VERDICT = np.dtype(
    [('tick', 'i8'), ('verdict', 'i8'), ('position', 'f8'), ('velocity', 'f8'), ('ratio', 'f8')]
)


@dataclass(frozen=True, kw_only=True)
class Run(Trajectory):
    """
    A run of n steps.

    ``time`` [s], ``position`` [m], ``velocity`` [m/s] and ``effort`` [N] (the command that answers
    each state) have shape (n + 1,). ``damping`` [N s/m] and ``applied`` [N] (the mean effort of
    the actuator) act over the sample that starts at each state and have shape (n,). ``events`` has
    dtype EVENT and one row per impulse, ``verdicts`` dtype VERDICT and one row per verdict of the
    supervision (index in VERDICTS), with the jump over the expected one. The controller saw
    ``measured_position`` [m] and ``measured_velocity`` [m/s] (nan if not measured); for an ideal
    axis they are the state itself. ``x_r`` [m] is the set-point.
    """

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    damping: np.ndarray
    events: np.ndarray
    verdicts: np.ndarray
    applied: np.ndarray
    measured_position: np.ndarray
    measured_velocity: np.ndarray
    x_r: float

    @property
    def set_point(self) -> np.ndarray:
        """The set-point [m] at each state."""
        return np.full(len(self.time), self.x_r)

    def impulse_samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return tick and guard of each impulse."""
        return self.events['tick'], self.events['guard']


def steps_of(plant: Plant, gains: ControlGains, duration: float) -> int:
    """
    Return the number of steps in ``duration`` [s].

    Raises `ParameterError` if the time steps of the two differ or there is no step.
    """
    if plant.time_step != gains.time_step:
        raise refusal('time_step', gains.time_step, f'that of the axis, {plant.time_step:g} [s]')
    require_duration(duration)
    steps = ticks(duration, plant.time_step)
    if not steps > 0:
        raise refusal('duration', duration, f'>= {plant.time_step:g} [s]')
    return steps


def simulate(plant: Plant, gains: ControlGains, duration: float) -> Run:
    """
    Run the closed loop for ``duration`` seconds from the start of ``plant``.

    Raises `ParameterError` if ``plant`` and ``gains`` have different time steps or the duration is
    not positive, and `DivergedError` if the motion diverges.
    """
    steps = steps_of(plant, gains, duration)
    ideal = plant.is_ideal
    plain = ideal and not gains.has_options
    trace = empty_trace(steps + 1, ideal, plain)
    ClosedLoop(plant, gains, ideal, plain).fill(trace, step_on=False)
    end = first_diverged(trace)
    if end is not None:
        raise DivergedError(trace.position[end], trace.velocity[end], f'{end * plant.time_step:g}')
    time = np.arange(steps + 1, dtype=float)
    time *= plant.time_step
    return Run(
        time=time,
        position=trace.position,
        velocity=trace.velocity,
        effort=trace.effort,
        damping=trace.damping[1:],
        applied=trace.effort[:-1] if ideal else trace.applied[1:],
        measured_position=trace.measured_position,
        measured_velocity=trace.measured_velocity,
        events=events_of(trace),
        verdicts=verdicts_of(trace),
        x_r=gains.x_r,
    )


def events_of(trace: Trace) -> np.ndarray:
    """Return the impulses of a trace, dtype EVENT."""
    fired = np.flatnonzero(trace.guard != NO_IMPULSE)  # ten times faster on bools
    events = np.empty(len(fired), EVENT)
    events['tick'], events['guard'], events['area'] = fired, trace.guard[fired], trace.area[fired]
    events['position'] = trace.measured_position[fired]
    events['velocity'] = trace.used_velocity[fired]
    return events


def verdicts_of(trace: Trace) -> np.ndarray:
    """Return the verdicts of a trace, dtype VERDICT."""
    judged = np.flatnonzero(trace.verdict != NO_VERDICT)
    verdicts = np.empty(len(judged), VERDICT)
    verdicts['tick'], verdicts['verdict'] = judged, trace.verdict[judged]
    verdicts['position'] = trace.measured_position[judged]
    verdicts['velocity'] = trace.used_velocity[judged]
    verdicts['ratio'] = trace.ratio[judged]
    return verdicts
