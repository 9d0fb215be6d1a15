"""The paper's Fig. 2 and Fig. 5 as plain numbers, for every contestant alike."""

from dataclasses import dataclass
from pathlib import Path

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.hybrid import Reading, Solution, solve
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.files.parameter_file import load_experiment

CONFIG = Path(__file__).parent.parent / 'config'
FIGURES = {'fig2': 'underdamped.yaml', 'fig5': 'coulomb.yaml'}


@dataclass(frozen=True, kw_only=True)
class Case:
    """
    The closed loop m x'' + (d + D) x' + K x + F_c sign(x') = 0 from (x_0, 0), and its jumps.

    SI units. At x = 0, v becomes ``bounce`` v; at v = 0, it becomes -``kick`` x: (17) with (19)
    and (26). ``axis`` and ``controller`` are the same as our own contestants take it.
    """

    m: float
    d: float
    F_c: float
    K: float
    D: float
    x_0: float
    bounce: float
    kick: float
    time_step: float
    seconds: float
    axis: Plant
    controller: ControlGains

    @property
    def steps(self) -> int:
        """Return the number of time steps."""
        return round(self.seconds / self.time_step)

    def exact(self, reading: str) -> Solution:
        """Solve it exactly."""
        return solve(self.axis, self.controller, self.seconds, reading=Reading[reading])


def read_case(figure: str, seconds: float) -> Case:
    """Read the experiment of a figure."""
    experiment = load_experiment(CONFIG / FIGURES[figure])
    axis, controller = experiment.plant, experiment.gains
    return Case(
        m=axis.m,
        d=axis.damping.value,
        F_c=axis.F_c,
        K=controller.K,
        D=controller.D,
        x_0=axis.x_0,
        bounce=1.0 - 2.0 * controller.alpha_ratio,
        kick=controller.d_bar / (2.0 * controller.m),
        time_step=axis.time_step,
        seconds=seconds,
        axis=axis,
        controller=controller,
    )
