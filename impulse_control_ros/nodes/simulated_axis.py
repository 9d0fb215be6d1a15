"""The axis as the plant node holds it: its state, its hardware, and the kernel that fits them."""

from impulse_control_ros.core.axis import Axis, plant_step
from impulse_control_ros.core.hardware import at_rest
from impulse_control_ros.core.kernel import machine_code
from impulse_control_ros.core.plant import real_step, sense


class SimulatedAxis:
    """An axis under changing parameters; what it does is a function of those and the efforts."""

    def __init__(self, axis: Axis) -> None:
        self._state, self._hidden = axis.start(), at_rest()
        scratch = axis.packed()
        self._plant_step = machine_code(plant_step, *scratch, axis.start(), 0.0)
        self._real_step = machine_code(
            real_step, *scratch, axis.packed_hardware(), axis.start(), at_rest(), 0.0)
        self.change(axis)
        self.start()

    def change(self, axis: Axis) -> None:
        """Let the next sample be made with other parameters."""
        self._parameters, self._is_ideal = axis, axis.is_ideal
        self._axis, self._profile = axis.packed()
        self._hardware = axis.packed_hardware()

    def start(self) -> None:
        """Put the axis to its start, at tick 0."""
        self._state = self._parameters.start()
        self._measure_anew()

    def reset(self) -> None:
        """Make one sample in which the axis comes back to its start."""
        tick, noise = self._state['tick'] + 1, self._state['noise']
        damping = self._state['damping']
        self._state = self._parameters.start()
        self._state['tick'], self._state['noise'], self._state['damping'] = tick, noise, damping
        self._measure_anew()

    def _measure_anew(self) -> None:
        self._hidden = at_rest()
        sense(self._axis, self._hardware, self._state, self._hidden)

    def step(self, command: float) -> None:
        """Make one sample under ``command`` [N]."""
        if self._is_ideal:
            self._plant_step(self._axis, self._profile, self._state, command)
        else:
            self._real_step(self._axis, self._profile, self._hardware, self._state, self._hidden,
                            command)

    def state(self) -> tuple[int, float, float, float, float]:
        """Return tick, position [m], velocity [m/s], effort [N] and damping [N s/m]."""
        return self._state.item()[:5]

    def measured(self) -> tuple[float, float]:
        """Return position [m] and velocity [m/s] as the sensor has them; nan for no velocity."""
        if self._is_ideal:
            return self._state.item()[1:3]
        hidden = self._hidden[0]
        return float(hidden['position']), float(hidden['velocity'])
