"""An axis one sample at a time, as a plant holds it: its state, its hardware, and the kernel."""

from typing import Any

from impulse_control_ros.core.jit import machine_code
from impulse_control_ros.core.nonidealities import at_rest
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.plant_step import plant_step, put_to_start


class SimulatedAxis:
    """
    An axis under changing parameters; what it does is a function of those and of the commands.

    One kernel serves every axis: of an ideal one it makes the bits of core/plant.py.
    """

    def __init__(self, axis: Plant) -> None:
        self._real_step = machine_code(
            plant_step, *axis.packed(), axis.packed_hardware(), axis.start(), at_rest(), 0.0
        )
        self.change(axis)
        self.start()

    def change(self, axis: Plant) -> None:
        """Let the next sample be made with other parameters."""
        self._parameters = axis
        self._axis, self._profile = axis.packed()
        self._hardware = axis.packed_hardware()

    def start(self) -> None:
        """Put the axis to its start, at tick 0."""
        self._state = self._parameters.start()
        self._begin()

    def reset(self) -> None:
        """Make one sample in which the axis comes back to its start; noise and time go on."""
        self._state['tick'] += 1
        self._begin()

    def _begin(self) -> None:
        self._hidden = put_to_start(self._parameters, self._state)
        self._measured = self._hidden.view('f8')[:2]  # a view is read faster than two fields

    def step(self, command: float) -> None:
        """Make one sample under ``command`` [N]."""
        self._real_step(
            self._axis, self._profile, self._hardware, self._state, self._hidden, command
        )

    def state(self) -> tuple[Any, ...]:
        """Return the fields of STATE."""
        return self._state.item()

    def measured(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s] as the sensor has them; nan for no velocity."""
        position, velocity = self._measured.tolist()
        return position, velocity
