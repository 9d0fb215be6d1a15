"""Plant, controller and recorder composed in one process, on one executor."""

import argparse
from functools import partial
import sys

from rclpy.parameter import Parameter
from tqdm import tqdm

from impulse_control_ros.core.parameter import ParameterError
from impulse_control_ros.files.experiment import read_experiment
from impulse_control_ros.nodes.controller import Controller
from impulse_control_ros.nodes.plant_simulator import PlantSimulator
from impulse_control_ros.nodes.recorder import Recorder
from impulse_control_ros.nodes.spin import parse, run, StopRequest

PROG = 'closed_loop'


class Progress:
    """A progress bar of simulated time, on a terminal."""

    def __init__(self) -> None:
        self.plant: PlantSimulator | None = None
        self._bar: tqdm | None = None

    def make_plant(self, record: bool) -> PlantSimulator:
        """Make the plant that is shown; it waits for the recorder when there is one."""
        self.plant = PlantSimulator(parameter_overrides=[
            Parameter('wait_for_recorder', Parameter.Type.BOOL, record)])
        return self.plant

    def show(self) -> None:
        """Redraw, at most as often as tqdm thinks fit."""
        if not self.plant or not self.plant.parameters.duration or self.plant.tick < 0:
            return
        step = self.plant.parameters.time_step
        if self._bar is None:
            self._bar = tqdm(
                total=self.plant.parameters.duration, unit='s', disable=None, leave=False,
                bar_format='{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated, {rate_fmt}')
        self._bar.update(self.plant.tick * step - self._bar.n)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.close()


def parameter_files(arguments: list[str]) -> list[str]:
    """Return the values of --params-file."""
    return [value for flag, value in zip(arguments, arguments[1:], strict=False)
            if flag == '--params-file']


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what is not for ROS."""
    parser.add_argument('--no-recorder', action='store_true', help='run without a recorder')


def main() -> int:
    """Run the three nodes of a parameter file until the run is over."""
    stop, progress = StopRequest(), Progress()
    options = parse(PROG, 'Plant, controller and recorder in one process.', add_options)
    try:
        for path in parameter_files(sys.argv):
            read_experiment(path)
    except ParameterError as error:
        print(f'{PROG}: {error}', file=sys.stderr)
        return 2
    makers = [partial(progress.make_plant, not options.no_recorder), Controller]
    if not options.no_recorder:
        makers.append(Recorder)
    status = run(PROG, makers, stop, progress.show if sys.stderr.isatty() else None)
    progress.close()
    return status
