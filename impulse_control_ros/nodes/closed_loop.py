"""
Plant, controller and recorder composed in one process.

The hot path is one thread that publishes and takes: the plant publishes a state, and because
both ends live in this process DDS has delivered it when publish returns; the loop takes it from
the controller's subscription, which publishes the command, takes that from the plant's, which
publishes the next state, and so on for SLICE seconds. Every message still goes over DDS, so
outside subscribers see all of them. Between two slices the recorder empties its subscriptions,
and the executor serves what waits: parameters, reset/pause/step, setpoint, timers, discovery.
The subscriptions that the loop takes from are hidden from the executor. When nothing moves
(paused, held by an outside recorder), the executor waits instead. A paced sample that is due
within SPIN is awaited here, busily: the executor's waits are 0.1 ms too long.
"""

import argparse
from functools import partial
import sys
from time import perf_counter
from typing import Any

from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from tqdm import tqdm

from impulse_control_ros.files.experiment import read_experiment
from impulse_control_ros.nodes.controller import Controller
from impulse_control_ros.nodes.plant_simulator import PlantSimulator
from impulse_control_ros.nodes.recorder import Recorder
from impulse_control_ros.nodes.spin import main as run_nodes, Maker
from impulse_control_ros.stop import StopRequest

SLICE = 0.005
SPIN = 2e-4
BURST = 50


class ClosedLoop:
    """The composed nodes, and the loop that takes their messages directly."""

    def __init__(self) -> None:
        self._plant: PlantSimulator
        self._controller: Controller
        self._recorder: Recorder | None = None
        self._bar: Any = None

    def make_plant(self, record: bool) -> PlantSimulator:
        """Make the plant; it waits for the recorder when there is one."""
        self._plant = plant = PlantSimulator(parameter_overrides=[
            Parameter('wait_for_recorder', Parameter.Type.BOOL, record)])
        plant.taken_directly = {plant.commands}
        return plant

    def make_controller(self) -> Controller:
        """Make the controller."""
        self._controller = controller = Controller()
        controller.standby.alone = True  # our plant begins with no other one, and stops with us
        controller.trust(self._plant.get_fully_qualified_name(), self._plant.parameters.flat())
        controller.taken_directly = {controller.states}
        return controller

    def make_recorder(self) -> Recorder:
        """Make the recorder."""
        self._recorder = Recorder()
        return self._recorder

    def run_slice(self) -> bool:
        """Run samples for a while; returns whether any was made."""
        began, end = self._plant.tick, perf_counter() + SLICE
        while perf_counter() < end:
            moved = self._run_burst()
            if self._recorder:
                self._recorder.take()
            if not moved and (self._plant.poll() > SPIN or self._plant.finished):
                break
        self._show()
        return self._plant.tick > began

    def _run_burst(self) -> bool:
        """Take up to BURST messages from each end; returns False once none waits."""
        plant, controller = self._plant, self._controller
        take_state = controller.states.handle.take_message
        take_command = plant.commands.handle.take_message
        for _ in range(BURST):
            state = take_state(JointState, True)
            if state:
                controller.on_state(state[0])
            command = take_command(JointState, True)
            if command:
                plant.on_command(command[0])
            if not (state or command):
                return False
        return True

    def _show(self) -> None:
        """Draw the progress of simulated time, on a terminal."""
        parameters = self._plant.parameters
        if not parameters.duration or self._plant.tick < 0:
            return
        if self._bar is None:
            tqdm.monitor_interval = 0  # no thread beside ours
            self._bar = tqdm(
                total=parameters.duration, unit='s', disable=None, leave=False,
                bar_format='{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated, {rate_fmt}')
        self._bar.update(self._plant.tick * parameters.time_step - self._bar.n)

    def close(self) -> None:
        """Take the progress bar away."""
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


def main(stop: StopRequest) -> int:
    """Run the three nodes of a parameter file until the run is over."""
    loop = ClosedLoop()

    def makers(options: argparse.Namespace) -> list[Maker]:
        checked_files(sys.argv)
        record = not options.no_recorder
        return [partial(loop.make_plant, record), loop.make_controller,
                *[loop.make_recorder] * record]

    try:
        return run_nodes(stop, 'closed_loop', 'Plant, controller and recorder in one process.',
                         makers, 'controller:K:=12.0', add_options, loop.run_slice)
    finally:
        loop.close()
