"""
ROS parameter files and ``-p`` rules, and the values that each node gets from them.

rcl merges them by node key: the last value of a key counts, and of several keys that match a node
(``controller``, ``/**/controller``, ``/**``) the one that appeared last. A value can therefore
lose to an earlier value of another key. rcl does so silently; this module raises an error.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from pathlib import Path
import re
from typing import Any

from yaml import YAMLError

from impulse_control_ros.core.parameter import build, converted, declared, Parameters, unknown
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import Experiment, is_foreign, NODES, require_agreement
from impulse_control_ros.files.yaml_file import flattened, parsed, read_mapping

RULE = re.compile(r'(?:(\w+):)?([^:=]+):=(.+)', re.DOTALL)
ANY = ('*', '**')


@dataclass(frozen=True, kw_only=True)
class Section:
    """
    The values that a ``source`` (a file or a rule) gives to the nodes that ``key`` matches.

    ``key`` begins with a slash, like the full name of a node; ``values`` are by full name.
    """

    source: str
    key: str
    values: Mapping[str, Any]

    @property
    def node(self) -> str:
        """The name of the node, without its namespace; a wildcard for any."""
        return base(self.key)

    @property
    def is_rule(self) -> bool:
        """Whether the section comes from the command line."""
        return self.source.startswith('-p ')

    @property
    def where(self) -> str:
        """The source as errors name it."""
        return self.source if self.is_rule else f'{self.source}: {self.key}'

    def matches(self, name: str) -> bool:
        """Return whether the section applies to the node of full ``name``."""
        pattern = re.escape(self.key).replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'/\w+')
        return re.fullmatch(pattern, name) is not None

    def values_for(self, kind: type[Parameters]) -> dict[str, Any]:
        """
        Return the values for a node with the parameters of ``kind``.

        Under a wildcard, parameters that only other nodes have are left out. Raises
        `ParameterError` for any other name, a wrong type, or a value out of bounds.
        """
        known = {name: (default, spec) for name, default, spec in declared(kind)}
        others = NAMES if self.node in ANY else ()
        try:
            for name, value in self.values.items():
                if name in known:
                    converted(name, value, *known[name])
                elif name not in others:
                    raise unknown(name, value, {*known, *others})
        except ParameterError as error:
            raise ParameterError(f'{self.where}: {error}') from None
        return {name: value for name, value in self.values.items() if name in known}


def names_of(*kinds: type[Parameters]) -> set[str]:
    """Return the names of the parameters of any of ``kinds``."""
    return {name for kind in kinds for name, _, _ in declared(kind)}


NAMES = names_of(*NODES.values())


def base(name: str) -> str:
    """Return the name of a node without its namespace."""
    return name.rsplit('/', 1)[-1]


def read_sections(path: str | Path, with_foreign: bool = False) -> Iterator[Section]:
    """
    Yield the sections of a ROS parameter file; raises `ParameterError`.

    The parameters of rclpy itself are left out unless ``with_foreign`` is true.
    """
    for name, section in _nested_sections(read_mapping(path, NODES)):
        try:
            values = flattened(section['ros__parameters'])
        except (KeyError, TypeError, AttributeError):
            raise ParameterError(f'{path}: {name} has no ros__parameters') from None
        yield Section(
            source=str(path),
            key='/' + name.lstrip('/'),
            values={
                name: value
                for name, value in values.items()
                if with_foreign or not is_foreign(name)
            },
        )


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


def rule_section(rule: str, namespace: str = '') -> Section:
    """Return the section of a rule [NODE:]NAME:=VALUE, for any node if it names none."""
    try:
        node, name, value = RULE.fullmatch(rule).groups()  # type: ignore[union-attr]
        value = parsed(value)
    except (AttributeError, YAMLError):
        raise ParameterError(f'-p {rule}: must be [NODE:]NAME:=VALUE') from None
    return Section(
        source=f'-p {rule}',
        key=f'{namespace}/{node}' if node else '/**',
        values={} if is_foreign(name) else {name: value},
    )


def command_line_sections(arguments: Sequence[str]) -> Iterator[Section]:
    """Yield the sections of the parameter files and rules on a ROS command line."""
    for flag, value in zip(arguments, arguments[1:], strict=False):
        if flag == '--params-file':
            yield from read_sections(value)
        elif flag in ('-p', '--param'):
            yield rule_section(value)


def merged(sections: Iterable[Section], name: str, kind: type[Parameters]) -> dict[str, Any]:
    """
    Return the values that rcl gives to the node of full ``name``.

    Raises `ParameterError` for values that the node does not accept, and if rcl does not take the
    last value of a parameter.
    """
    keys: dict[str, dict[str, Any]] = {}
    last: dict[str, Section] = {}
    for section in sections:
        if section.matches(name):
            values = keys.setdefault(section.key, {})
            for parameter, value in section.values_for(kind).items():
                values[parameter] = _kept(values.get(parameter), value)
                last[parameter] = section
    taken = {parameter: key for key, values in keys.items() for parameter in values}
    given = {parameter: keys[key][parameter] for parameter, key in taken.items()}
    for parameter, section in last.items():
        if given[parameter] != section.values[parameter]:
            raise ParameterError(
                f'{section.where}: {parameter} = {section.values[parameter]!r} has no effect: '
                f'rcl takes the earlier {given[parameter]!r} of {taken[parameter]}'
            )
    return given


def _kept(before: Any, value: Any) -> Any:
    """Return the value that rcl keeps: an integer over a float, any value over an empty list."""
    dropped = (type(before) is int and type(value) is float) or (before and value == [])
    return before if dropped else value


def unused(sections: Iterable[Section], nodes: Mapping[str, type[Parameters]]) -> Iterator[str]:
    """Yield a message for each source that sets no parameter of some ``nodes``, by full name."""
    known = names_of(*nodes.values())
    kinds = {kind: node for node, kind in NODES.items()}
    for source, group in groupby(sections, attrgetter('source')):
        some = list(group)
        matched = {name for name in nodes if any(one.matches(name) for one in some)}
        named = {one.node for one in some}
        # a file may be only for others of our nodes
        for_others = matched or (named & NODES.keys() and not some[0].is_rule)
        missed = [
            name
            for name in nodes
            if name not in matched and ({base(name), kinds[nodes[name]]} & named or not for_others)
        ]
        if missed:
            yield (
                f'{source}: {", ".join(one.key for one in some)} matches none of '
                f'{", ".join(missed)}; in a file, /**/NAME is a node in any namespace'
            )
        elif some[0].is_rule and some[0].node in ANY and not some[0].values.keys() <= known:
            yield f'{source}: there is no such parameter of {", ".join(nodes)}'


def require_known_nodes(sections: Iterable[Section], names: Iterable[str] = ()) -> None:
    """Raise `ParameterError` for a section of a node neither of this package nor in ``names``."""
    known = {*ANY, *NODES, *map(base, names)}
    for section in sections:
        if section.node not in known:
            raise ParameterError(
                f'{section.source}: invalid node {section.node!r}: must be {", ".join(NODES)}'
            )


def read_parameters(
    nodes: Mapping[str, type[Parameters]], paths: Iterable[str | Path], rules: Iterable[str]
) -> dict[str, dict[str, Any]]:
    """
    Return the values of each of the ``nodes`` by name: first from the files, then the rules.

    The nodes share the one namespace that the files name. Raises `ParameterError` for files that
    cannot be read and values that no node accepts; the message names the file, the parameter and
    its value.
    """
    sections = [section for path in paths for section in read_sections(path)]
    namespaces = {one.key.rpartition('/')[0] for one in sections if '*' not in one.key} or {''}
    if len(namespaces) > 1:
        raise ParameterError(
            f'{", ".join(map(str, paths))}: nodes in the namespaces '
            f'{", ".join(name or "/" for name in sorted(namespaces))}: must be one'
        )
    namespace = namespaces.pop()
    sections += [rule_section(rule, namespace) for rule in rules]
    require_known_nodes(sections)
    full = {f'{namespace}/{node}': kind for node, kind in nodes.items()}
    values = {base(name): merged(sections, name, kind) for name, kind in full.items()}
    for what in unused(sections, full):
        raise ParameterError(what)
    return values


def load_experiment(*paths: str | Path, rules: Sequence[str] = ()) -> Experiment:
    """
    Read the parameters of the three nodes: defaults, then files, then ``rules`` as for ``-p``.

    Raises `ParameterError` as `read_parameters` does, and for values that break a rule.
    """
    given = read_parameters(NODES, paths, rules)
    source = ', '.join([*map(str, paths), *(f'-p {rule}' for rule in rules)])
    node, parts = '', dict[str, Any]()
    try:
        for node, kind in NODES.items():
            parts[node] = build(kind, given[node])
        node = 'controller'
        require_agreement('plant_simulator', parts['plant_simulator'].flat(), parts[node].flat())
    except ParameterError as error:
        raise ParameterError(f'{source}: {node}: {error}') from None
    return Experiment(
        plant=parts['plant_simulator'], gains=parts['controller'], recorder=parts['recorder']
    )
