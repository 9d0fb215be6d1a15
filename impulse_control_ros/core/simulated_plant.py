"""A plant one sample at a time, as a node holds it: its state, its hardware, and the kernel."""

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
    A plant under changing parameters; what it does is a function of those and of the commands.

    One kernel serves every plant: of an ideal one it makes the bits of core/plant.py.
    """

    def __init__(self, plant: Plant) -> None:
        self.change(plant)
        self.start()
        self._step = machine_code(
            step_in_place, self._plant, self._hardware, self._state, self._memory, 0.0
        )
        self.start()  # the compiled step has been tried

    def change(self, plant: Plant) -> None:
        """Let the next sample be made with other parameters."""
        self._parameters = plant
        self._plant, self._hardware = plant.packed(), plant.packed_hardware()

    def start(self) -> None:
        """Put the plant to its start, at tick 0."""
        self._begin(FIRST)

    def reset(self) -> None:
        """Make one sample in which the plant comes back to its start; noise and time go on."""
        before = PlantState(*self.state())
        self._begin(before._replace(tick=before.tick + 1))

    def _begin(self, before: PlantState) -> None:
        start = start_of(self._parameters, before)
        self._state, self._memory = np.array([start], STATE), memory_at(start, self._parameters)
        self._measured = self._memory.view('f8')[:2]  # a view is read faster than two fields

    def step(self, command: float) -> None:
        """Make one sample under ``command`` [N]."""
        self._step(self._plant, self._hardware, self._state, self._memory, command)

    def state(self) -> Any:
        """Return the fields of a `PlantState`."""
        return self._state.item()

    def measured(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s] as the sensor has them; nan for no velocity."""
        position, velocity = self._measured.tolist()
        return position, velocity
