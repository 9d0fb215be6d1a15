"""Plant, controller and recorder composed in one process, on one executor."""

import argparse
from functools import partial
import sys
from typing import Any

from rclpy.parameter import Parameter
from tqdm import tqdm

from impulse_control_ros.files.experiment import read_experiment
from impulse_control_ros.nodes.controller import Controller
from impulse_control_ros.nodes.plant_simulator import PlantSimulator
from impulse_control_ros.nodes.recorder import Recorder
from impulse_control_ros.nodes.spin import main as run_nodes
from impulse_control_ros.nodes.spin import Maker


class Progress:
    """A progress bar of simulated time, on a terminal."""

    def __init__(self) -> None:
        self.plant: PlantSimulator | None = None
        self._bar: Any = None

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


def checked_files(arguments: list[str]) -> None:
    """Refuse a parameter file with a node that is none of the three: rcl would pass it over."""
    for flag, path in zip(arguments, arguments[1:], strict=False):
        if flag == '--params-file':
            read_experiment(path)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what is not for ROS."""
    parser.add_argument('--no-recorder', action='store_true', help='run without a recorder')


def main() -> int:
    """Run the three nodes of a parameter file until the run is over."""
    progress = Progress()

    def makers(options: argparse.Namespace) -> list[Maker]:
        checked_files(sys.argv)
        record = not options.no_recorder
        return [partial(progress.make_plant, record), Controller, *[Recorder] * record]

    status = run_nodes('closed_loop', 'Plant, controller and recorder in one process.', makers,
                       add_options, progress.show if sys.stderr.isatty() else None)
    progress.close()
    return status
