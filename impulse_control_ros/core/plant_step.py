"""
The plant as its controller sees it: the axis with its actuator and its sensor.

An ideal plant has no hardware; its step is compiled without it.
"""

from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.damping import damping_at
from impulse_control_ros.core.jit import compiled, record
from impulse_control_ros.core.nonidealities import (
    actuate,
    begin,
    disturb,
    HARDWARE_STATE,
    measure,
)
from impulse_control_ros.core.plant import axis_step, Plant
from impulse_control_ros.core.stribeck import stribeck_step


class PlantState(NamedTuple):
    """
    The plant at a sample: tick, position [m], velocity [m/s], and the noise of its damping.

    ``effort`` [N] and ``damping`` [N s/m] acted over the sample that led to it.
    """

    tick: int
    position: float
    velocity: float
    effort: float
    damping: float
    noise: float


FIRST = PlantState(0, 0.0, 0.0, 0.0, 0.0, 0.0)
STATE = record([('tick', 'i8'), *((name, 'f8') for name in PlantState._fields[1:])])


class Axis(NamedTuple):
    """Moving mass [kg], Coulomb friction [N] and sampling period [s] of a PLANT record."""

    m: float
    F_c: float
    time_step: float


@compiled
def axis_of(plant):
    """Return the `Axis` of a PLANT record."""
    return Axis(plant.m, plant.F_c, plant.time_step)


@compiled
def plant_step(axis, profile, hardware, state, memory, command):
    """
    Return the `PlantState` one sample later, under ``command`` [N].

    ``profile`` is a record of dtype DAMPING. ``hardware`` and ``memory`` are records of dtypes
    HARDWARE and HARDWARE_STATE, None for an ideal plant. ``memory`` receives the measured state.
    """
    damping, noise = damping_at(profile, state.noise, state.tick)
    if hardware is None:
        position, velocity = axis_step(
            state.position, state.velocity, command, damping, axis.m, axis.F_c, axis.time_step
        )
        return PlantState(state.tick + 1, position, velocity, command, damping, noise)
    effort = actuate(hardware, memory, state.tick, command)
    force = effort + disturb(hardware, memory, state.tick) if hardware.force != 0.0 else effort
    m = axis.m + hardware.mass if state.tick >= hardware.mass_time else axis.m
    if hardware.F_s > axis.F_c:
        position, velocity = stribeck_step(
            state.position,
            state.velocity,
            force,
            damping,
            m,
            axis.F_c,
            hardware.F_s,
            hardware.v_s,
            axis.time_step,
        )
    else:
        position, velocity = axis_step(
            state.position, state.velocity, force, damping, m, axis.F_c, axis.time_step
        )
    after = PlantState(state.tick + 1, position, velocity, effort, damping, noise)
    measure(hardware, after, memory, 1.0 / axis.time_step)
    return after


@compiled
def step_in_place(plant, hardware, state, memory, command):
    """Do `plant_step` on arrays, shape (1,): dtypes PLANT, HARDWARE, STATE, HARDWARE_STATE."""
    now = state[0]
    before = PlantState(now.tick, now.position, now.velocity, now.effort, now.damping, now.noise)
    after = plant_step(
        axis_of(plant[0]), plant[0].damping, hardware[0], before, memory[0], command
    )
    now.tick, now.position, now.velocity, now.effort, now.damping, now.noise = after


def start_of(plant: Plant, before: PlantState = FIRST) -> PlantState:
    """Return the start of a plant; tick and noise continue from ``before``."""
    return before._replace(position=plant.x_0, velocity=plant.v_0, effort=0.0)


def memory_at(start: PlantState, plant: Plant) -> np.ndarray:
    """Return the memory of the hardware at the start: shape (1,), dtype HARDWARE_STATE."""
    memory = np.zeros(1, HARDWARE_STATE)
    begin(plant.packed_hardware()[0], start, memory[0], 1.0 / plant.time_step)
    return memory
