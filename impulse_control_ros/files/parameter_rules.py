"""Parameters of a command line without ROS, by the rules that ``-p`` of ROS takes."""

from itertools import chain
import re

import yaml

from impulse_control_ros.core.parameter import declared, meant
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import NODES
from impulse_control_ros.files.parameter_file import Given, parsed

_RULE = re.compile(r'(?:(\w+):)?([\w.]+):=(.+)', re.DOTALL)


def given_by(rule: str) -> list[Given]:
    """
    Return what a rule [NODE:]NAME:=VALUE gives; without a node, to all nodes that have it.

    Raises `ParameterError` for anything else, and for what no node has.
    """
    found = _RULE.fullmatch(rule)
    try:
        value = parsed(found[3]) if found else None
    except yaml.YAMLError:
        found = None
    if found is None:
        raise ParameterError(f'-p {rule}: must be [NODE:]NAME:=VALUE')
    node, name = found[1], found[2]
    if node not in (None, *NODES):
        raise ParameterError(f'-p {rule}: invalid node {node!r}: must be {", ".join(NODES)}')
    known = {one: [item for item, _, _ in declared(kind)] for one, kind in NODES.items()}
    nodes = [node] if node else [one for one, names in known.items() if name in names]
    if not nodes:
        hint = meant(name, chain.from_iterable(known.values()))
        raise ParameterError(f'-p {rule}: no node has a parameter {name}{hint}')
    return [(f'/{node or "**"}', one, {name: value}) for one in nodes]
