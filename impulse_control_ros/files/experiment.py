"""
An experiment: the parameters of the three nodes, and the plain ROS parameter file they live in.

The classes below are the one source of the nodes' parameters; the nodes declare them from here.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
import re
from typing import Any

import yaml

from impulse_control_ros.core.axis import Axis
from impulse_control_ros.core.impulse import Controller
from impulse_control_ros.core.parameter import (
    build,
    declared,
    parameter,
    ParameterError,
    Parameters,
    refusal,
)
from impulse_control_ros.core.tick import nanoseconds, SECOND
from impulse_control_ros.files.mcap_file import COMPRESSIONS

# stamps have 32 bits of seconds, with a sign
LAST_SECOND = float(2**31 - 1)
SLOWEST = 1e-3  # Hz


def cpu_core_parameter() -> Any:
    """Make the field that places a node's process."""
    return parameter(-1, '', 'core that the process runs on; -1 for any', lower=-1, upper=4095,
                     read_only=True)


@dataclass(frozen=True, kw_only=True)
class PlantParameters(Axis):
    """Parameters of the node ``plant_simulator``: the axis, and how it is run."""

    joint_name: str = parameter('axis', '', 'name of the joint in the messages', read_only=True)
    duration: float = parameter(
        0.0, 's', 'simulated time after which the run ends; 0 for no end', lower=0.0)
    start_time: float = parameter(
        0.0, 's', 'stamp of the first state; 0 for 1 s in lockstep, and for the wall clock without',
        lower=0.0, upper=LAST_SECOND, read_only=True)
    lockstep: bool = parameter(
        True, '', 'wait for the command of each state; false runs freely on the wall clock',
        read_only=True)
    real_time_factor: float = parameter(
        0.0, '', 'simulated seconds per wall second; 0 for as fast as possible', lower=0.0)
    command_timeout: float = parameter(
        1.0, 's', 'wall time without a command after which another controller may take over',
        lower=0.01, upper=3600.0)
    recorder_timeout: float = parameter(
        10.0, 's', 'wall time without a word of a recorder after which it is not waited for',
        lower=0.1, upper=3600.0)
    clock_rate: float = parameter(
        100.0, 'Hz', 'messages on /clock per simulated second, one a sample at most; 0 for none',
        lower=0.0)
    damping_rate: float = parameter(
        1000.0, 'Hz', 'messages on damping per simulated second, one a sample at most, when it '
        'varies; 0 for none', lower=0.0)
    step_ticks: int = parameter(
        1, 'samples', 'samples that one call of ~/step makes', lower=1)
    wait_for_recorder: bool = parameter(
        False, '', 'whether the first state waits for a recorder', read_only=True)
    cpu_core: int = cpu_core_parameter()

    def check(self) -> None:
        """Stamps are whole nanoseconds within ROS' range; free running needs a pace."""
        super().check()
        nanoseconds(self.start_time, 'start_time')
        if self.start_time + self.duration > LAST_SECOND:
            raise refusal('duration', self.duration,
                          f'<= {LAST_SECOND:g} - start_time = {LAST_SECOND - self.start_time:g},'
                          ' for stamps to fit 32 bits [s]')
        for name in ('clock_rate', 'damping_rate'):
            rate = getattr(self, name)
            if 0.0 < rate < SLOWEST:
                raise refusal(name, rate, f'0 or >= {SLOWEST:g} [Hz]')
        if not self.lockstep and self.real_time_factor == 0.0:
            raise refusal('real_time_factor', self.real_time_factor,
                          '> 0 when lockstep is false')


    def start_ns(self, wall_ns: int) -> int:
        """Return the stamp [ns] of the first state; ``wall_ns`` is the wall clock."""
        if self.start_time:
            return nanoseconds(self.start_time, 'start_time')
        return SECOND if self.lockstep else wall_ns


@dataclass(frozen=True, kw_only=True)
class ControllerParameters(Controller):
    """Parameters of the node ``controller``."""

    joint_name: str = parameter('axis', '', 'name of the joint in the messages', read_only=True)
    state_timeout: float = parameter(
        0.5, 's', 'wall time without a state after which a plant that runs freely is commanded '
        '0 N; 0 for never', lower=0.0, upper=3600.0)
    managed: bool = parameter(
        False, '', 'whether it is a lifecycle node, which commands nothing until it is activated',
        read_only=True)
    cpu_core: int = cpu_core_parameter()


@dataclass(frozen=True, kw_only=True)
class RecorderParameters(Parameters):
    """Parameters of the node ``recorder``."""

    bag: str = parameter(
        '', '', 'folder to create; empty for impulse_<date and time>', read_only=True)
    topics: tuple[str, ...] = parameter(
        ('setpoint', 'damping'), '', 'topics to record beside joint_states, joint_commands, '
        'impulse_events and run_parameters', read_only=True)
    compression: str = parameter(
        'zstd', '', 'compression of the chunks', choices=tuple(COMPRESSIONS), read_only=True)
    cpu_core: int = cpu_core_parameter()


# rclpy's own parameters, which any node has
FOREIGN = ('use_sim_time', 'start_type_description_service')
FOREIGN_PREFIX = 'qos_overrides.'
NODES: dict[str, type[Parameters]] = {
    'plant_simulator': PlantParameters, 'controller': ControllerParameters,
    'recorder': RecorderParameters}


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One complete parameter file."""

    plant_simulator: PlantParameters
    controller: ControllerParameters
    recorder: RecorderParameters


def require_agreement(plant: str, axis: Mapping[str, Any], gains: Mapping[str, Any]) -> None:
    """
    Raise `ParameterError` when a controller's ``gains`` are not for the ``axis`` of ``plant``.

    Both are values by name; what a plant that is none of ours does not tell is not compared.
    """
    for name, unit in (('time_step', ' [s]'), ('joint_name', '')):
        if axis.get(name, gains[name]) != gains[name]:
            raise refusal(name, gains[name], f'that of {plant}, {axis[name]}{unit}')


def axis_of(values: Mapping[str, Any]) -> Axis | None:
    """Return the axis of a plant's values by name; None for a plant that is none of ours."""
    ours = {name: value for name, value in values.items() if not is_foreign(name)}
    if not ours.keys() >= {name for name, _, _ in declared(PlantParameters)}:
        return None  # what it does not tell is not Table I
    try:
        return build(PlantParameters, ours)
    except ParameterError:
        return None


class _Loader(yaml.SafeLoader):
    """YAML as ROS reads it: 1e-4 is a number, which YAML 1.1 calls a string. A key stands once."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping, or raise `YAMLError` for a key that stands twice."""
        seen = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.YAMLError(
                    f'{key.value} stands twice, again on line {key.start_mark.line + 1}')
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$'),
    list('-+0123456789'))


def parsed(text: str) -> Any:
    """Return the value of a YAML text; raises `YAMLError`."""
    return yaml.load(text, _Loader)  # noqa: S506 (a safe loader)


def flattened(values: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Return nested mappings as one with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= flattened(value, f'{prefix}{name}.')
        else:
            flat[f'{prefix}{name}'] = value
    return flat


def is_foreign(name: str) -> bool:
    """Tell whether a parameter belongs to rclpy itself."""
    return name in FOREIGN or name.startswith(FOREIGN_PREFIX)


def read_mapping(path: str | Path, keys: Iterable[str]) -> Mapping[str, Any]:
    """
    Return what a YAML file holds: a mapping of ``keys``, which are not checked.

    Raises `ParameterError` when the file cannot be read or is no mapping.
    """
    try:
        content = parsed(Path(path).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterError(f'{path}: {" ".join(str(error).split())}') from None
    if not isinstance(content, Mapping):
        raise ParameterError(f'{path}: {content!r} is refused: allowed is {", ".join(keys)}')
    return content


def sections(path: str | Path) -> Mapping[str, Any]:
    """Return the sections of a ROS parameter file by the name of the node, as it is written."""
    return dict(_nested_sections(read_mapping(path, NODES)))


def _nested_sections(content: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield (name, section); a mapping of mappings without parameters is a namespace."""
    for key, section in content.items():
        name = f'{prefix}{key}'
        if isinstance(section, Mapping) and 'ros__parameters' not in section and any(
                isinstance(value, Mapping) for value in section.values()):
            yield from _nested_sections(section, f'{name}/')
        else:
            yield name, section


# the key of a node, one of the nodes that it is for, and its parameters
Given = tuple[str, str, dict[str, Any]]


def _given_in(path: str | Path) -> Iterator[Given]:
    """Yield (key, node, parameters) of a ROS parameter file."""
    for name, section in sections(path).items():
        last = name.rsplit('/', 1)[-1]
        meant = list(NODES) if last in ('*', '**') else [last]
        if not set(meant) <= set(NODES):
            raise ParameterError(f'{path}: {name!r} is refused: allowed is {", ".join(NODES)}')
        try:
            given = flattened(section['ros__parameters'])
        except (KeyError, TypeError, AttributeError):
            raise ParameterError(f'{path}: {name} has no ros__parameters') from None
        for node in meant:
            yield '/' + name.lstrip('/'), node, {
                key: value for key, value in given.items() if not is_foreign(key)}


def _merged(given: Iterable[Given]) -> dict[str, dict[str, Any]]:
    """
    Return the parameters of each node.

    As in ROS the last value for a key counts, and of several keys for a node the one that came
    last: a value for ``/**/controller`` does not replace an earlier one for ``controller``.
    """
    keys: dict[str, dict[str, dict[str, Any]]] = {}
    for key, node, parameters in given:
        keys.setdefault(key, {}).setdefault(node, {}).update(parameters)
    values: dict[str, dict[str, Any]] = {node: {} for node in NODES}
    for nodes in keys.values():
        for node, parameters in nodes.items():
            values[node] |= parameters
    return values


def read_values(path: str | Path) -> dict[str, dict[str, Any]]:
    """
    Return what a ROS parameter file names, by the default name of the node and the parameter.

    Raises `ParameterError` when the file cannot be read or names an unknown node.
    """
    return _merged(_given_in(path))


def read_experiment(*paths: str | Path, besides: Sequence[Given] = ()) -> Experiment:
    """
    Read ROS parameter files for the three nodes by their default names, in any namespace.

    Later files count, and after them what is given ``besides``, by ``-p``. Raises
    `ParameterError` when a file cannot be read, names an unknown node or parameter, or holds a
    wrong value; the message names the files, the node, the parameter and its value.
    """
    values = _merged(chain(*map(_given_in, paths), besides))
    source = ', '.join([*map(str, paths), *['-p'] * bool(besides)])
    experiment = Experiment(**{node: _built(source, node, values[node]) for node in NODES})
    try:
        require_agreement('plant_simulator', experiment.plant_simulator.flat(),
                          experiment.controller.flat())
    except ParameterError as error:
        raise ParameterError(f'{source}: controller: {error}') from None
    return experiment


def _built(source: str, node: str, values: Mapping[str, Any]) -> Any:
    try:
        return build(NODES[node], values)
    except ParameterError as error:
        raise ParameterError(f'{source}: {node}: {error}') from None
