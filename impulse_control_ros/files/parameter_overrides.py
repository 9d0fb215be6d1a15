"""The parameters on a ROS command line, and the nodes that they are for."""

from collections.abc import Iterator, Sequence
import re

from impulse_control_ros.files.parameter_file import sections

NODE_OF_RULE = re.compile(r'(\w+):[^:=]+:=')


def unused_overrides(arguments: Sequence[str], names: Sequence[str]) -> Iterator[str]:
    """Yield what to say of the parameters that miss the nodes of full ``names``."""
    for source, keys in override_keys(arguments):
        missed = missed_by(keys, names)
        if missed:
            yield (
                f'{source}: {", ".join(keys)} is the name of none of {", ".join(missed)}; '
                'in a file, /**/NAME is a node in any namespace'
            )


def override_keys(arguments: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the sources of parameters on a command line, and the nodes that they name."""
    for flag, value in zip(arguments, arguments[1:], strict=False):
        if flag == '--params-file':
            yield value, list(sections(value))
        elif flag in ('-p', '--param') and NODE_OF_RULE.match(value):
            yield f'{flag} {value}', [value.split(':')[0]]


def missed_by(keys: Sequence[str], names: Sequence[str]) -> list[str]:
    """
    Return the nodes of full ``names`` that the node ``keys`` of a parameter file miss.

    These are the ones that a key is named like but not for, or all when no key is for any.
    """
    reached = [name for name in names if any(is_for(key, name) for key in keys)]
    alike = {key.rsplit('/', 1)[-1] for key in keys}
    return [
        name
        for name in names
        if name not in reached and (not reached or name.rsplit('/', 1)[-1] in alike)
    ]


def is_for(key: str, name: str) -> bool:
    """Tell whether the node ``key`` of a parameter file is for the node of full ``name``."""
    pattern = re.escape('/' + key.lstrip('/'))
    pattern = pattern.replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'/\w+')
    return re.fullmatch(pattern, name) is not None
