"""The control law of the controller node: its memory, its gains, and the kernel."""

import sys
from typing import Any

import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import COMMAND, control_in_place, STATES
from impulse_control_ros.core.jit import machine_code
from impulse_control_ros.core.learnt import Learnt, learnt_from
from impulse_control_ros.core.supervision import SUPERVISION


class SampledController:
    """A control law under changing gains, one sample at a time."""

    def __init__(self, gains: ControlGains) -> None:
        self._command = np.zeros(1, COMMAND)
        self._control = machine_code(
            control_in_place,
            np.zeros(STATES),
            np.zeros(1, SUPERVISION),
            gains.packed().view(float),
            0.0,
            0.0,
            np.zeros(1, COMMAND),
        )
        self.change(gains)
        self.forget()

    def change(self, gains: ControlGains) -> None:
        """Use other gains from the next sample on."""
        self._gains, self._law = gains, gains.packed().view(float)
        self.largest = gains.effort_limit or sys.float_info.max

    def forget(self) -> None:
        """Clear the memory; the next sample counts as the first one."""
        self._state, self._memory = np.zeros(STATES), np.zeros(1, SUPERVISION)

    def answer(self, position: float, velocity: float) -> Any:
        """Return (effort [N], area [N s], guard, velocity [m/s] used, verdict, ratio)."""
        self._control(self._state, self._memory, self._law, position, velocity, self._command)
        return self._command.item()

    @property
    def suspended(self) -> bool:
        """Whether the supervision suspends impulses."""
        return bool(self._memory['suspension']['left'][0] > 0.0)

    def learnt(self) -> Learnt:
        """Return what the supervision has learnt."""
        return learnt_from(self._memory, self._gains)
