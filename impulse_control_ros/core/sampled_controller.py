"""The control law as the controller node holds it: its memory, its gains, and the kernel."""

import sys
from typing import Any

import numpy as np

from impulse_control_ros.core.careful import control_carefully, fresh_watch, packed_law
from impulse_control_ros.core.impulse import ANSWER, ControlGains, fresh_memory
from impulse_control_ros.core.jit import machine_code


class SampledController:
    """A control law under changing gains, one sample at a time."""

    def __init__(self, gains: ControlGains) -> None:
        self._answer = np.zeros(1, ANSWER)
        self.change(gains)
        self.forget()
        self._control = machine_code(
            control_carefully,
            fresh_memory(),
            fresh_watch(),
            self._gains,
            self._care,
            0.0,
            0.0,
            np.zeros(1, ANSWER),
        )

    def change(self, gains: ControlGains) -> None:
        """Answer the next sample with other gains."""
        self._gains, self._care = packed_law(gains)
        self.largest = gains.effort_limit or sys.float_info.max

    def forget(self) -> None:
        """Begin afresh: the next sample is the first one."""
        self._memory, self._watch = fresh_memory(), fresh_watch()

    def answer(self, position: float, velocity: float) -> Any:
        """Return (effort [N], area [N s], guard, velocity [m/s] that the law took)."""
        self._control(
            self._memory, self._watch, self._gains, self._care, position, velocity, self._answer
        )
        return self._answer.item()
