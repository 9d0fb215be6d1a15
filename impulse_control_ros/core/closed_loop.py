"""
The closed loop of plant and control law, bit-for-bit identical to the nodes.

At sample k the controller answers state k with effort k, which acts over [t_k, t_k+1).
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import COMMAND, control_step, FRESH
from impulse_control_ros.core.jit import compiled
from impulse_control_ros.core.plant import DIVERGED, Plant
from impulse_control_ros.core.plant_step import axis_of, memory_at, plant_step, start_of, STATE
from impulse_control_ros.core.supervision import SUPERVISION
from impulse_control_ros.core.tick import nanoseconds, seconds
from impulse_control_ros.errors import DivergedError

BLOCK = 10_000  # samples


class Trace(NamedTuple):
    """
    The signals of n samples, each an array of shape (n,).

    ``position`` [m] and ``velocity`` [m/s] are the state of the axis; ``applied`` [N] and
    ``damping`` [N s/m] acted over the sample that led to it. The controller saw
    ``measured_position`` and ``measured_velocity`` (nan if not measured) and answered with
    ``effort`` [N], ``area`` [N s], ``guard``, ``used_velocity``, and the ``verdict`` of the
    supervision with its ``ratio``. For an ideal plant, the measured signals share the arrays of
    the true ones; so does the used velocity, for a law without options, which leaves the verdicts
    at 0.
    """

    position: np.ndarray
    velocity: np.ndarray
    applied: np.ndarray
    damping: np.ndarray
    measured_position: np.ndarray
    measured_velocity: np.ndarray
    effort: np.ndarray
    area: np.ndarray
    guard: np.ndarray
    used_velocity: np.ndarray
    verdict: np.ndarray
    ratio: np.ndarray


@compiled
def close_loop(
    plant, hardware, state, memory, gains, options, law_state, law_memory, trace, steps
):
    """
    Fill the n samples of ``trace`` from ``state`` on; return the next states of plant and law.

    ``plant`` and, unless None, ``hardware``, ``memory`` and ``law_memory`` are arrays of shape
    (1,), dtypes PLANT, HARDWARE, HARDWARE_STATE and SUPERVISION.
    ``steps`` is n, or n - 1 to leave the plant at the last sample.
    """
    axis, profile = axis_of(plant[0]), plant[0].damping
    real: Any = None if hardware is None else hardware[0]
    inner: Any = None if hardware is None else memory[0]
    watch: Any = None if options is None else law_memory[0]
    for k in range(len(trace.position)):
        trace.position[k], trace.velocity[k] = state.position, state.velocity
        trace.damping[k] = state.damping
        if hardware is None:
            position, velocity = state.position, state.velocity
        else:
            position, velocity = inner.position, inner.velocity
            trace.applied[k] = state.effort
            trace.measured_position[k], trace.measured_velocity[k] = position, velocity
        command, law_state = control_step(law_state, gains, options, watch, position, velocity)
        trace.effort[k], trace.area[k] = command.effort, command.area
        trace.guard[k] = command.guard
        if options is not None:
            trace.used_velocity[k] = command.velocity
            trace.verdict[k], trace.ratio[k] = command.verdict, command.ratio
        if k < steps:
            state = plant_step(axis, profile, real, state, inner, command.effort)
    return state, law_state


def empty_trace(count: int, ideal: bool = False, plain: bool = False) -> Trace:
    """Return an empty trace for an ``ideal`` plant, and a law without options if ``plain``."""
    position, velocity, damping, effort, area = (np.empty(count) for _ in range(5))
    guard, verdict, ratio = np.empty(count, np.int8), np.zeros(count, np.int8), np.zeros(count)
    applied, x, v = (effort, position, velocity) if ideal else (np.empty(count) for _ in range(3))
    used = v if plain else np.empty(count)
    return Trace(
        position, velocity, applied, damping, x, v, effort, area, guard, used, verdict, ratio
    )


class ClosedLoop:
    """
    A plant and its controller, run sample by sample from the plant's start.

    ``ideal`` compiles the loop without hardware, ``plain`` without options, with the same results
    to the bit. The plant must then stay ideal and the law without options.
    """

    def __init__(
        self, plant: Plant, gains: ControlGains, ideal: bool = False, plain: bool = False
    ) -> None:
        self._ideal, self._plain = ideal, plain
        self._state = start_of(plant)
        self._memory = None if ideal else memory_at(self._state, plant)
        self.forget()
        self.change(plant, gains)

    def change(self, plant: Plant, gains: ControlGains) -> None:
        """Continue with other parameters."""
        self._plant, self._gains = plant.packed(), gains.values
        self._hardware = None if self._ideal else plant.packed_hardware()
        self._options = None if self._plain else gains.options

    def start(self, plant: Plant) -> None:
        """Reset ``plant`` to its start at the next sample; noise and time continue."""
        self._state = start_of(plant, self._state._replace(tick=self._state.tick + 1))
        self._memory = memory_at(self._state, plant)

    def forget(self) -> None:
        """Clear the memory of the controller."""
        self._law_state = FRESH
        self._law_memory = None if self._plain else np.zeros(1, SUPERVISION)

    def fill(self, trace: Trace, step_on: bool = True) -> None:
        """Fill a trace with the next samples; without ``step_on`` the plant stays at the last."""
        steps = len(trace.position) - (0 if step_on else 1)
        self._state, self._law_state = close_loop(
            self._plant,
            self._hardware,
            self._state,
            self._memory,
            self._gains,
            self._options,
            self._law_state,
            self._law_memory,
            trace,
            steps,
        )


def first_diverged(trace: Trace) -> int | None:
    """Return the first sample with a diverged state, or None."""
    x, v = trace.position, trace.velocity
    if np.max([x.max(), -x.min(), v.max(), -v.min()]) < DIVERGED:
        return None
    return int(np.argmin(np.maximum(np.abs(x), np.abs(v)) < DIVERGED))


def measured_states(trace: Trace, tick: int) -> np.ndarray:
    """Return the states from ``tick`` on as published: shape (n,), dtype STATE."""
    states = np.zeros(len(trace.position), STATE)
    states['tick'] = tick + np.arange(len(states))
    states['position'], states['velocity'] = trace.measured_position, trace.measured_velocity
    states['effort'], states['damping'] = trace.applied, trace.damping
    return states


def commands_of(trace: Trace) -> np.ndarray:
    """Return the answers of the controller: shape (n,), dtype COMMAND."""
    commands = np.empty(len(trace.position), COMMAND)
    commands['effort'], commands['area'] = trace.effort, trace.area
    commands['guard'], commands['velocity'] = trace.guard, trace.used_velocity
    commands['verdict'], commands['ratio'] = trace.verdict, trace.ratio
    return commands


def blocks_of(
    plant: Plant, gains: ControlGains, count: int, start_ns: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """
    Yield ``count`` measured states and their answers in blocks: dtypes STATE and COMMAND.

    Memory use does not grow with ``count``. After the last state within bounds, raises
    `DivergedError` with the stamp of the diverged state in a run that starts at ``start_ns``.
    """
    loop = ClosedLoop(plant, gains)
    for first in range(0, count, BLOCK):
        trace = empty_trace(min(BLOCK, count - first))
        loop.fill(trace)
        end = first_diverged(trace)
        good = Trace(*(signal[:end] for signal in trace))
        if len(good.position):
            yield measured_states(good, first), commands_of(good)
        if end is not None:
            stamp_ns = start_ns + (first + end) * nanoseconds(plant.time_step, 'time_step')
            raise DivergedError(trace.position[end], trace.velocity[end], seconds(stamp_ns))
