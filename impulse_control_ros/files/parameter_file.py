"""ROS parameter files: the experiment that they hold, as the nodes would read them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
import re
from typing import Any

import yaml

from impulse_control_ros.core.parameter import build
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import (
    Experiment,
    is_foreign,
    NODES,
    require_agreement,
)


class _Loader(yaml.SafeLoader):
    """YAML as ROS reads it: 1e-4 is a number, which YAML 1.1 calls a string. A key stands once."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping, or raise `YAMLError` for a key that stands twice."""
        seen = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.YAMLError(
                    f'{key.value} stands twice, again on line {key.start_mark.line + 1}'
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$'),
    list('-+0123456789'),
)


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
        raise ParameterError(f'{path}: {content!r}: must be a mapping of {", ".join(keys)}')
    return content


def sections(path: str | Path) -> Mapping[str, Any]:
    """Return the sections of a ROS parameter file by the name of the node, as it is written."""
    return dict(_nested_sections(read_mapping(path, NODES)))


def _nested_sections(content: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield (name, section); a mapping of mappings without parameters is a namespace."""
    for key, section in content.items():
        name = f'{prefix}{key}'
        if (
            isinstance(section, Mapping)
            and 'ros__parameters' not in section
            and any(isinstance(value, Mapping) for value in section.values())
        ):
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
            raise ParameterError(f'{path}: invalid node {name!r}: must be {", ".join(NODES)}')
        try:
            given = flattened(section['ros__parameters'])
        except (KeyError, TypeError, AttributeError):
            raise ParameterError(f'{path}: {name} has no ros__parameters') from None
        for node in meant:
            yield (
                '/' + name.lstrip('/'),
                node,
                {key: value for key, value in given.items() if not is_foreign(key)},
            )


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


def load_experiment(*paths: str | Path, besides: Sequence[Given] = ()) -> Experiment:
    """
    Read ROS parameter files for the three nodes by their default names, in any namespace.

    Later files count, and after them what is given ``besides``, by ``-p``. Raises
    `ParameterError` when a file cannot be read, names an unknown node or parameter, or holds a
    wrong value; the message names the files, the node, the parameter and its value.
    """
    values = _merged(chain(*map(_given_in, paths), besides))
    source = ', '.join([*map(str, paths), *['-p'] * bool(besides)])
    plant, gains, recorder = (_built(source, node, values[node]) for node in NODES)
    try:
        require_agreement('plant_simulator', plant.flat(), gains.flat())
    except ParameterError as error:
        raise ParameterError(f'{source}: controller: {error}') from None
    return Experiment(plant=plant, gains=gains, recorder=recorder)


def _built(source: str, node: str, values: Mapping[str, Any]) -> Any:
    try:
        return build(NODES[node], values)
    except ParameterError as error:
        raise ParameterError(f'{source}: {node}: {error}') from None
