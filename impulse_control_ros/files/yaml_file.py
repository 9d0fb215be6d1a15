"""Read and write YAML with the rules of ROS."""

from collections.abc import Iterable, Mapping
import os
from pathlib import Path
import re
from typing import Any

import yaml

from impulse_control_ros.errors import ParameterError


class _Loader(yaml.SafeLoader):
    """YAML with the scalars of rcl, where 1e-4 is a number and a date is a string."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping, or raise `YAMLError` for a duplicate key."""
        seen = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.YAMLError(
                    f'{key.value} stands twice, again on line {key.start_mark.line + 1}'
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """YAML with quotes around each string that rcl or YAML 1.1 takes for another type."""


_Loader.bool_values = {**_Loader.bool_values, 'y': True, 'n': False}
_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern in (
    ('bool', r'[yYnN]|yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF'),
    ('int', r'[-+]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)'),
    ('float', r'[-+]?(([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|\.?(?i:inf(inity)?|nan))'),
):
    for _kind in (_Loader, _Dumper):
        _kind.add_implicit_resolver(
            f'tag:yaml.org,2002:{_tag}', re.compile(f'(?:{_pattern})$'), None
        )


def parsed(text: str) -> Any:
    """Return the value of a YAML text; raises `YAMLError`."""
    return yaml.load(text, _Loader)  # noqa: S506 (a safe loader)


def as_text(content: Mapping[str, Any]) -> str:
    """Return a mapping as YAML, sorted by name."""
    return yaml.dump(content, Dumper=_Dumper, default_flow_style=False, allow_unicode=True)


def flattened(values: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Flatten nested mappings into one with dotted names."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= flattened(value, f'{prefix}{name}.')
        else:
            flat[f'{prefix}{name}'] = value
    return flat


def read_mapping(path: str | Path, keys: Iterable[str]) -> Mapping[str, Any]:
    """
    Return the mapping in a YAML file; ``keys`` are its allowed keys, for errors only.

    Raises `ParameterError` if the file cannot be read or is not a mapping.
    """
    try:
        content = parsed(Path(os.path.expanduser(path)).read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ParameterError(f'{path}: {" ".join(str(error).split())}') from None
    if not isinstance(content, Mapping):
        raise ParameterError(f'{path}: {content!r}: must be a mapping of {", ".join(keys)}')
    return content
