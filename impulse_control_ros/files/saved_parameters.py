"""Parameter files made from the values of running nodes, and read back for one node."""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.atomic_write import replaced
from impulse_control_ros.files.parameter_file import ANY, read_sections
from impulse_control_ros.files.yaml_file import as_text

# a bag is never overwritten, so the next run needs another one
OF_ONE_RUN = ('bag',)


def node_text(name: str, values: Mapping[str, Any]) -> str:
    """Return the text of a parameter file; ``values`` of the node ``name`` are by full name."""
    return as_text({name: {'ros__parameters': nested(values)}})


def write_experiment(path: Path, values: Mapping[str, Mapping[str, Any]]) -> None:
    """
    Write an experiment, which `load_experiment` reads; raises `OSError`.

    ``values`` are by node, such as 'controller', and by full name. The recorder's bag is left out.
    """
    kept = {
        node: {name: value for name, value in some.items() if name not in OF_ONE_RUN}
        for node, some in values.items()
    }
    text = ''.join(node_text(f'/**/{node}', some) for node, some in kept.items())
    with replaced(path) as made:
        made.write_text(text, encoding='utf-8')


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return nested mappings for dotted names; the inverse of `flattened`.

    A name below another parameter, as a.b below a, stays dotted.
    """
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *groups, last = name.split('.')
        if any('.'.join(groups[: k + 1]) in values for k in range(len(groups))):
            groups, last = [], name
        inner = tree
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[last] = value
    return tree


def values_of_node(
    path: Path, name: str, known: Collection[str], with_wildcard: bool = True
) -> dict[str, Any]:
    """
    Return the values that a parameter file gives to the node of full ``name``, as at its start.

    Of several sections that match the node, the later ones count. Under a wildcard, parameters
    that are not ``known`` are those of other nodes and are left out. ``with_wildcard`` tells
    whether the section ``/**`` is read. Raises `ParameterError` if no section matches.
    """
    sections = list(read_sections(path, with_foreign=True))
    found = [one for one in sections if one.matches(name) and (with_wildcard or one.key != '/**')]
    if not found:
        keys = ', '.join(one.key for one in sections) or 'none'
        raise ParameterError(f'{path}: no section is for {name}; the sections are {keys}')
    return {
        parameter: value
        for one in found
        for parameter, value in one.values.items()
        if one.node not in ANY or parameter in known
    }
