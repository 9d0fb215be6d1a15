"""The motion of ``excite`` on a simulated axis, without ROS."""

from dataclasses import dataclass, replace

import numpy as np

from impulse_control_ros.core.excitation import Excitation
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.core.simulated_plant import SimulatedPlant

PERIOD = 0.02  # s between two set-points
LONGEST = 100.0  # s


@dataclass(frozen=True, kw_only=True)
class Moved:
    """A motion: what the controller measured and commanded, each of shape (n,)."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    set_point: np.ndarray

    @property
    def columns(self):
        return {name: getattr(self, name) for name in ('time', 'position', 'velocity', 'effort')}


def excited(plant, gains, limits, period=PERIOD):
    """Return the motion of an axis at 1 kHz, with a set-point each ``period`` [s]."""
    plant = replace(plant, time_step=1e-3)
    gains = replace(gains, time_step=1e-3, impulses=False, x_r=plant.x_0)
    axis, controller = SimulatedPlant(plant), SampledController(gains)
    motion = Excitation(limits, gains.K, gains.D, gains.x_r, plant.x_0)
    rows, told = [], -period
    for tick in range(round(LONGEST / plant.time_step)):
        time = tick * plant.time_step
        position, velocity = axis.measured()
        motion.watch(time, position)
        if time >= told + period:
            told, point = time, motion.next_set_point()
            if point is None:
                return Moved(**dict(zip(Moved.__annotations__, np.array(rows).T, strict=True)))
            if point != gains.x_r:
                gains = replace(gains, x_r=point)
                controller.change(gains)
        effort = controller.answer(position, velocity)[0]
        rows.append((time, position, velocity, effort, gains.x_r))
        axis.step(effort)
    raise AssertionError(f'the motion lasts longer than {LONGEST:g} s')
