"""
Plant, controller and recorder in one process, calling each other directly.

Each message is published and also passed directly to the other node. For SLICE seconds, the loop
passes states to the controller and commands to the plant. Between two slices the recorder writes
the messages passed to it, and the executor serves pending work: parameters, services, setpoint,
timers, discovery. When no message is pending, the executor waits. The loop busy-waits for a paced
sample that is due within SPIN, because the executor waits 0.1 ms too long.
"""

import argparse
from contextlib import ExitStack
import sys
from time import perf_counter
from typing import Any

from rclpy.parameter import Parameter

from impulse_control_ros.command_line import simulated_time, StopRequest
from impulse_control_ros.files.topics import (
    DAMPING,
    IMPULSE_EVENTS,
    JOINT_COMMANDS,
    JOINT_STATES,
    RUN_PARAMETERS,
)
from impulse_control_ros.nodes.child import Child, remappings
from impulse_control_ros.nodes.controller import Controller
from impulse_control_ros.nodes.plant_simulator import PlantSimulator
from impulse_control_ros.nodes.recorder import Recorder
from impulse_control_ros.nodes.spin import main as run_nodes, Maker

SLICE = 0.005
SPIN = 2e-4
BURST = 50


class ClosedLoop:
    """The composed nodes, and the messages in flight between them."""

    def __init__(self) -> None:
        self._plant: PlantSimulator
        self._controller: Controller
        self._state = self._command = b''
        self._bar: Any = None

    def make_plant(self, record: bool) -> PlantSimulator:
        """Make the plant; it waits for the recorder if there is one."""
        self._plant = PlantSimulator(
            composed=True,
            parameter_overrides=[Parameter('wait_for_recorder', Parameter.Type.BOOL, record)],
        )
        return self._plant

    def make_controller(self) -> Controller:
        """Make the controller, connected to this plant only."""
        self._controller = Controller(composed=True)
        self._plant.outputs.parameters.connect(self._controller.plants.on_event)
        self._plant.outputs.states.connect(self._on_state)
        self._controller.answers.commands.connect(self._on_command)
        return self._controller

    def make_recorder(self) -> Recorder:
        """Make the recorder of everything that plant and controller publish."""
        plant, answers = self._plant.outputs, self._controller.answers
        recorder = Recorder(
            outputs={
                JOINT_STATES: [plant.states],
                IMPULSE_EVENTS: [answers.events],
                JOINT_COMMANDS: [answers.commands],
                DAMPING: [plant.damping],
                RUN_PARAMETERS: [plant.parameters, answers.parameters],
            }
        )
        recorder.progress.connect(self._plant.on_progress)
        return recorder

    def _on_state(self, raw: bytes) -> None:
        self._state = raw

    def _on_command(self, raw: bytes) -> None:
        self._command = raw

    def run_slice(self) -> bool:
        """Run samples for SLICE seconds; return whether any was made."""
        began, end = self._plant.clock.tick, perf_counter() + SLICE
        while perf_counter() < end:
            if not self._run_burst() and (self._plant.poll() > SPIN or self._plant.finished):
                break
        self._show()
        return self._plant.clock.tick > began

    def _run_burst(self) -> bool:
        """Pass on up to BURST messages; return False once none is pending."""
        plant, controller = self._plant, self._controller
        for _ in range(BURST):
            if self._state:
                state, self._state = self._state, b''
                controller.on_state(state)
            elif self._command:
                command, self._command = self._command, b''
                plant.on_command(command)
            else:
                return False
        return True

    def _show(self) -> None:
        """Show the progress of simulated time, on a terminal."""
        duration, elapsed = self._plant.parameters.duration, self._plant.clock.elapsed
        if not duration or self._plant.clock.tick < 0:
            return
        if self._bar is None:
            self._bar = simulated_time(duration)
        self._bar.update(elapsed - self._bar.n)

    def close(self) -> None:
        """Remove the progress bar."""
        if self._bar is not None:
            self._bar.close()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that are not ROS arguments."""
    parser.add_argument('--no-recorder', action='store_true', help='run without a recorder')
    parser.add_argument('--dashboard', action='store_true', help='open the dashboard beside it')


def main(stop: StopRequest) -> int:
    """Run the three nodes of a parameter file until the run is over."""
    loop, beside = ClosedLoop(), ExitStack()

    def makers(options: argparse.Namespace) -> list[Maker]:
        record = not options.no_recorder
        if options.dashboard:
            dashboard = Child('dashboard', '--ros-args', *remappings(sys.argv))
            beside.callback(dashboard.end)
        return [
            lambda: loop.make_plant(record),
            loop.make_controller,
            *[loop.make_recorder] * record,
        ]

    try:
        return run_nodes(
            stop,
            'closed_loop',
            'Plant, controller and recorder in one process.',
            makers,
            'controller:K:=12.0',
            add_options,
            loop.run_slice,
        )
    finally:
        loop.close()
        beside.close()
