"""
An experiment: the parameters of the three nodes.

The nodes declare their parameters from the classes below, the only place that defines them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.parameter import build, declared, parameter, Parameters, refusal
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.protocol import ENDLESS
from impulse_control_ros.core.tick import nanoseconds, samples_between, SECOND, ticks
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.mcap_writer import COMPRESSIONS

# stamps have 32 bits of seconds, with a sign
LAST_SECOND = float(2**31 - 1)
SLOWEST = 1e-3  # Hz
LONGEST_AGE = 3600.0  # s
JOINT_STATE, EFFORT_ARRAY = 'joint_state', 'effort_array'  # command_interface


def cpu_core_parameter() -> Any:
    """Return the field for the core that a node's process runs on."""
    return parameter(
        -1, '', 'core that the process runs on; -1 for any', lower=-1, upper=4095, read_only=True
    )


@dataclass(frozen=True, kw_only=True)
class PlantParameters(Plant):
    """Parameters of the node ``plant_simulator``: the axis and how to run it."""

    joint_name: str = parameter('axis', '', 'name of the joint in the messages', read_only=True)
    duration: float = parameter(
        0.0, 's', 'simulated time after which the run ends; 0 for no end', lower=0.0
    )
    start_time: float = parameter(
        0.0,
        's',
        'stamp of the first state; 0 for 1 s in lockstep, else for the wall clock',
        lower=0.0,
        upper=LAST_SECOND,
        read_only=True,
    )
    lockstep: bool = parameter(
        True,
        '',
        'wait for the command of each state; false runs freely on the wall clock',
        read_only=True,
    )
    real_time_factor: float = parameter(
        0.0, '', 'simulated seconds per wall second; 0 for as fast as possible', lower=0.0
    )
    command_timeout: float = parameter(
        1.0,
        's',
        'wall time without a command after which another controller may take over',
        lower=0.01,
        upper=3600.0,
    )
    max_age: float = parameter(
        0.0,
        's',
        'age above which a command no longer acts, by its stamp and the simulated time, with '
        'lockstep false; 0 for no limit',
        lower=0.0,
        upper=LONGEST_AGE,
    )
    recorder_timeout: float = parameter(
        10.0,
        's',
        'wall time without a word of a recorder after which it is not waited for',
        lower=0.1,
        upper=3600.0,
    )
    clock_rate: float = parameter(
        100.0,
        'Hz',
        'messages on /clock per simulated second, one a sample at most; 0 for none',
        lower=0.0,
    )
    damping_rate: float = parameter(
        1000.0,
        'Hz',
        'messages on damping per simulated second, one a sample at most, when it '
        'varies; 0 for none',
        lower=0.0,
    )
    step_ticks: int = parameter(1, 'samples', 'samples that one call of ~/step makes', lower=1)
    wait_for_recorder: bool = parameter(
        False, '', 'whether the first state waits for a recorder', read_only=True
    )
    start_paused: bool = parameter(
        False,
        '',
        'whether the run starts paused, before its first state, until ~/pause or ~/step',
        read_only=True,
    )
    cpu_core: int = cpu_core_parameter()

    def check(self) -> None:
        """Require stamps of whole nanoseconds in ROS's range, and a pace if free-running."""
        super().check()
        nanoseconds(self.start_time, 'start_time')
        if self.start_time + self.duration > LAST_SECOND:
            raise refusal(
                'duration',
                self.duration,
                f'<= {LAST_SECOND:g} - start_time = {LAST_SECOND - self.start_time:g},'
                ' for stamps to fit 32 bits [s]',
            )
        for name in ('clock_rate', 'damping_rate'):
            rate = getattr(self, name)
            if 0.0 < rate < SLOWEST:
                raise refusal(name, rate, f'0 or >= {SLOWEST:g} [Hz]')
        if not self.lockstep and self.real_time_factor == 0.0:
            raise refusal('real_time_factor', self.real_time_factor, '> 0 when lockstep is false')

    @property
    def last_tick(self) -> int:
        """The tick at which the run is over."""
        return ticks(self.duration, self.time_step) if self.duration else ENDLESS

    @property
    def wall_step(self) -> float:
        """The wall time [s] of a sample, 0 for as fast as possible."""
        return self.time_step / self.real_time_factor if self.real_time_factor else 0.0

    @property
    def damping_every(self) -> int:
        """The number of samples between messages on damping; 0 for none."""
        varies = self.damping.kind != 'constant'
        return varies * samples_between(self.damping_rate, self.time_step)

    def start_ns(self, wall_ns: int) -> int:
        """Return the stamp [ns] of the first state; ``wall_ns`` is the wall clock."""
        if self.start_time:
            return nanoseconds(self.start_time, 'start_time')
        return SECOND if self.lockstep else wall_ns


@dataclass(frozen=True, kw_only=True)
class ControllerParameters(ControlGains):
    """Parameters of the node ``controller``."""

    joint_name: str = parameter('axis', '', 'name of the joint in the messages', read_only=True)
    state_timeout: float = parameter(
        0.5,
        's',
        'wall time without a state after which a plant that runs freely is commanded '
        '0 N; 0 for never',
        lower=0.0,
        upper=3600.0,
    )
    max_age: float = parameter(
        0.0,
        's',
        'age above which a state of a foreign plant counts as lost, by its stamp and the '
        "node's clock; 0 for no limit",
        lower=0.0,
        upper=LONGEST_AGE,
    )
    command_interface: str = parameter(
        JOINT_STATE,
        '',
        'where efforts go: joint_state for joint_commands alone, effort_array for '
        'effort_commands as well, for an effort controller of ros2_control',
        choices=(JOINT_STATE, EFFORT_ARRAY),
        read_only=True,
    )
    command_joints: tuple[str, ...] = parameter(
        (),
        '',
        'joints of the effort controller, in its order; the others are commanded 0 N; empty for '
        'joint_name alone',
        read_only=True,
    )
    lifecycle: bool = parameter(
        False,
        '',
        'whether it is a lifecycle node, which commands nothing until it is activated',
        read_only=True,
    )
    cpu_core: int = cpu_core_parameter()

    def check(self) -> None:
        """Require the controlled joint once among the commanded ones."""
        super().check()
        joints = self.command_joints
        if joints and self.command_interface != EFFORT_ARRAY:
            raise refusal(
                'command_joints', joints, f'empty unless command_interface is {EFFORT_ARRAY}'
            )
        if joints and joints.count(self.joint_name) != 1:
            raise refusal(
                'command_joints', joints, f'empty, or have joint_name = {self.joint_name!r} once'
            )


@dataclass(frozen=True, kw_only=True)
class RecorderParameters(Parameters):
    """Parameters of the node ``recorder``."""

    bag: str = parameter(
        '', '', 'folder to create; empty for impulse_<date and time>', read_only=True
    )
    topics: tuple[str, ...] = parameter(
        ('setpoint', 'damping'),
        '',
        'topics to record beside joint_states, joint_commands, impulse_events and run_parameters',
        read_only=True,
    )
    compression: str = parameter(
        'zstd', '', 'compression of the chunks', choices=tuple(COMPRESSIONS), read_only=True
    )
    cpu_core: int = cpu_core_parameter()


# rclpy's own parameters, which every node has
FOREIGN = ('use_sim_time', 'start_type_description_service')
FOREIGN_PREFIX = 'qos_overrides.'
NODES: dict[str, type[Parameters]] = {
    'plant_simulator': PlantParameters,
    'controller': ControllerParameters,
    'recorder': RecorderParameters,
}


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """The parameters of the three nodes; `simulate` takes ``plant`` and ``gains``."""

    plant: PlantParameters
    gains: ControllerParameters
    recorder: RecorderParameters


def require_agreement(plant: str, axis: Mapping[str, Any], gains: Mapping[str, Any]) -> None:
    """
    Raise `ParameterError` if a controller's ``gains`` do not match the ``axis`` of ``plant``.

    Both are values by name. Values that a foreign plant does not publish are not compared.
    """
    for name, unit in (('time_step', ' [s]'), ('joint_name', '')):
        if axis.get(name, gains[name]) != gains[name]:
            raise refusal(name, gains[name], f'that of {plant}, {axis[name]}{unit}')


def axis_of(values: Mapping[str, Any]) -> Plant | None:
    """Return the axis from a plant's values by name, None for a foreign plant."""
    ours = {name: value for name, value in values.items() if not is_foreign(name)}
    if not ours.keys() >= {name for name, _, _ in declared(PlantParameters)}:
        return None  # do not assume Table I for missing values
    try:
        return build(PlantParameters, ours)
    except ParameterError:
        return None


def is_foreign(name: str) -> bool:
    """Return whether a parameter belongs to rclpy itself."""
    return name in FOREIGN or name.startswith(FOREIGN_PREFIX)
