"""The plant of the simulator node, sample by sample: its state, its hardware, and the kernel."""

from typing import Any

import numpy as np

from impulse_control_ros.core.jit import machine_code
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.plant_step import (
    FIRST,
    memory_at,
    PlantState,
    start_of,
    STATE,
    step_in_place,
)


class SimulatedPlant:
    """
    A plant under changing parameters; its motion depends only on these and on the commands.

    One kernel serves every plant; for an ideal one it computes the bits of core/plant.py.
    """

    def __init__(self, plant: Plant) -> None:
        self.change(plant)
        self.start()
        self._step = machine_code(
            step_in_place, self._plant, self._hardware, self._state, self._memory, 0.0
        )
        self.start()  # undoes the step that machine_code ran

    def change(self, plant: Plant) -> None:
        """Use other parameters from the next sample on."""
        self._parameters = plant
        self._plant, self._hardware = plant.packed(), plant.packed_hardware()

    def start(self) -> None:
        """Reset the plant to its start, at tick 0."""
        self._begin(FIRST)

    def reset(self) -> None:
        """Return the plant to its start within one sample; noise and time continue."""
        before = PlantState(*self.state())
        self._begin(before._replace(tick=before.tick + 1))

    def _begin(self, before: PlantState) -> None:
        start = start_of(self._parameters, before)
        self._state, self._memory = np.array([start], STATE), memory_at(start, self._parameters)
        self._measured = self._memory.view('f8')[:2]  # a view is read faster than two fields

    def step(self, command: float) -> None:
        """Step the plant by one sample under ``command`` [N]."""
        self._step(self._plant, self._hardware, self._state, self._memory, command)

    def state(self) -> Any:
        """Return the fields of a `PlantState`."""
        return self._state.item()

    def measured(self) -> tuple[float, float]:
        """Return the measured position [m] and velocity [m/s], nan if it is not measured."""
        position, velocity = self._measured.tolist()
        return position, velocity
