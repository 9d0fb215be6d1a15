"""
The loop of examples/ros2_control without ROS, and the tables of its measurements.

``python -m scripts.ros2_control_loop`` prints them. A controller at the rate of a controller
manager drives an axis of Table I with F_c = 1 N. Its efforts act after a delay, as behind the
manager and the drive, and a share of the states may be lost.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import sys
from typing import Any

import numpy as np

from impulse_control_ros.command_line import exit_status
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.metrics import overshoot, peak, settling_time
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.core.simulated_plant import SimulatedPlant
from impulse_control_ros.files.parameter_file import load_experiment

CONFIG = Path(__file__).parent.parent / 'examples' / 'ros2_control' / 'axis.yaml'
FINE = 5e-4  # s, a step of the axis
AT_REST = 0.3  # s, when a response is to be over
NEAR = 0.01  # m
STEPS = (0.3, 0.55)  # m
KHZ: dict[str, Any] = {'time_step': 1e-3, 'position_deadband': 4e-3, 'stiction_wait_samples': 10}
PD: dict[str, Any] = {'impulses': False, 'D': 0.5}
LAWS: dict[str, dict[str, Any]] = {
    'PD, `impulses: false`, D = 0.5 N s/m': PD,
    'PID, K_i = 20 N/(m s)': {**PD, 'K_i': 20.0},
    'PID, K_i = 50 N/(m s)': {**PD, 'K_i': 50.0},
    'impulses, `supervision: false`': {'supervision': False},
    'impulses, supervised': {},
}
LIMITS = (100.0, 40.0, 20.0)  # N
DELAYS = (0.0, 0.005, 0.01, 0.02, 0.03, 0.05)  # s

# (position [m], velocity [m/s]) -> (effort [N], whether an impulse starts)
Answer = Callable[[float, float], tuple[float, bool]]


class DelayedAxis:
    """
    The axis, sampled at ``rate`` [Hz]; efforts act ``delay`` [s] late, +- ``jitter`` [s].

    ``lost`` is the share of the states that do not arrive: the last effort is held then. Both are
    drawn with ``seed``. ``cycles`` counts the periods.
    """

    def __init__(
        self, rate: int, delay: float = 5e-3, jitter: float = 0.0, lost: float = 0.0, seed: int = 1
    ) -> None:
        self.rate, self.cycles = rate, 0
        self._steps, self._lost = round(1 / (rate * FINE)), lost
        self._delay, self._jitter = round(delay / FINE), round(jitter / FINE)
        self._random, self._random_delay = np.random.default_rng(seed).spawn(2)
        self._axis = SimulatedPlant(Plant(F_c=1.0, x_0=0.0, time_step=FINE))
        self._made, self._effort = 0, 0.0
        self._sent: deque[tuple[int, float]] = deque()  # steps at which efforts act

    @property
    def position(self) -> float:
        """The position [m]."""
        return float(self._axis.measured()[0])

    def cycle(self, answer: Answer) -> bool:
        """Move the axis by a period; return whether an impulse started."""
        started = False
        self.cycles += 1
        if self._random.random() >= self._lost:
            effort, started = answer(*self._axis.measured())
            late = self._delay + int(self._random_delay.integers(-self._jitter, self._jitter + 1))
            self._sent.append((self._made + late, effort))
        for _ in range(self._steps):
            while self._sent and self._sent[0][0] <= self._made:
                self._effort = self._sent.popleft()[1]
            self._axis.step(self._effort)
            self._made += 1
        return started


@dataclass(frozen=True, kw_only=True)
class Response:
    """
    A response to a set-point ``step`` [m] away, by sample of ``period`` [s].

    ``errors`` [m], positive beyond the set-point, and ``impulses`` [bool] have shape (samples,).
    """

    step: float
    period: float
    errors: np.ndarray
    impulses: np.ndarray

    @property
    def settled(self) -> float:
        """The time [s] from which abs(e) stays within 1 cm; nan if it does not."""
        return settling_time(np.arange(len(self.errors)) * self.period, self.errors, NEAR)

    @property
    def overshoot(self) -> float:
        """The largest error [m] beyond the set-point, at least 0."""
        return overshoot(self.errors)

    @property
    def excursion(self) -> float:
        """The largest abs(e) over the step."""
        return peak(self.errors) / self.step

    @property
    def impulses_at_rest(self) -> float:
        """Impulses per second from AT_REST on."""
        late = self.impulses[round(AT_REST / self.period) :]
        return float(late.sum() / (len(late) * self.period))


def respond(axis: DelayedAxis, answer: Answer, x_r: float, last: float) -> Response:
    """Return the response to ``x_r`` [m] during the ``last`` [s]."""
    step = x_r - axis.position
    errors, impulses = [], []
    for _ in range(round(last * axis.rate)):
        errors.append(axis.position - x_r)
        impulses.append(axis.cycle(answer))
    return Response(
        step=abs(step),
        period=1.0 / axis.rate,
        errors=np.sign(step) * np.array(errors),
        impulses=np.array(impulses),
    )


def responses(
    axis: DelayedAxis, answer: Answer, set_point: Callable[[float], None], count: int, last: float
) -> Iterator[Response]:
    """
    Yield ``count`` responses of ``last`` [s] each, to random steps to and fro.

    ``set_point`` gives the next x_r [m] to what answers.
    """
    random = np.random.default_rng(1)
    for k in range(count):
        x_r = axis.position + float(random.uniform(*STEPS) * (-1) ** k)
        set_point(x_r)
        yield respond(axis, answer, x_r, last)


def simulated(axis: DelayedAxis, count: int, last: float, **changed: Any) -> list[Response]:
    """Return the responses under the gains of the example, but for those ``changed``."""
    gains: ControlGains = replace(load_experiment(CONFIG).gains, **changed)
    law = SampledController(gains)

    def answer(position: float, velocity: float) -> tuple[float, bool]:
        effort, _, guard, *_ = law.answer(position, velocity)
        return effort, bool(guard)

    def set_point(x_r: float) -> None:
        law.change(replace(gains, x_r=x_r))

    return list(responses(axis, answer, set_point, count, last))


def row(name: str, found: Sequence[Response]) -> str:
    """Return a row of a table: how many settle, how fast, overshoot, final error, impulses."""
    times = [one.settled for one in found if one.settled == one.settled]
    cells = (
        name,
        f'{len(times)} of {len(found)}',
        f'{min(times):.3g} to {max(times):.3g} s' if times else '',
        f'{1e3 * max(one.overshoot for one in found):.3g} mm',
        f'{1e3 * max(abs(one.errors[-1]) for one in found):.3g} mm',
        f'{max(one.excursion for one in found):.3g}',
        f'{np.mean([one.impulses_at_rest for one in found]):.3g}',
    )
    return f'| {" | ".join(cells)} |'


def table(rows: Sequence[str]) -> str:
    """Return a table of such rows."""
    heads = (
        *('', 'within 1 cm', 'after', 'overshoot up to', 'final error up to'),
        *('largest error / step', 'impulses/s at rest'),
    )
    return '\n'.join([f'| {" | ".join(heads)} |', '|---' * len(heads) + '|', *rows, ''])


def main() -> int:
    """Print the tables; return the exit status."""
    print('500 Hz, 5 ms, 20 responses of 8 s')
    print(table([row(law, simulated(DelayedAxis(500), 20, 8.0, **LAWS[law])) for law in LAWS]))
    print('1 kHz, 5 ms, 17 % of the states lost, 20 responses of 2 s')
    print(
        table(
            [
                row(law, simulated(DelayedAxis(1000, lost=0.17), 20, 2.0, **KHZ, **LAWS[law]))
                for law in LAWS
            ]
        )
    )
    print('500 Hz, 20 responses of 2 s, by delay')
    print(
        table(
            [
                row(f'{1e3 * delay:g} ms, {law}', simulated(DelayedAxis(500, delay), 20, 2.0, **g))
                for delay in DELAYS
                for law, g in of_delay(delay).items()
            ]
        )
    )
    print('500 Hz, 4 to 6 ms, 100 responses of 2 s, by effort_limit')
    rows = []
    for limit in LIMITS:
        for law, changed in list(LAWS.items())[-2:]:
            axis = DelayedAxis(500, jitter=1e-3)
            found = simulated(axis, 100, 2.0, **changed, effort_limit=limit)
            rows.append(row(f'{limit:g} N, {law}', found))
    print(table(rows))
    return 0


def of_delay(delay: float) -> dict[str, dict[str, Any]]:
    """Return the laws for a ``delay`` [s]: without supervision it must be told."""
    wait = {'stiction_wait_samples': round(delay * 500) + 3}
    return {
        'PD': {'impulses': False},
        'unsupervised': {'supervision': False, **wait},
        'supervised': {},
    }


if __name__ == '__main__':
    sys.exit(exit_status('ros2_control_loop', main))
