"""Write docs/reference/parameters.md: every parameter of every node, from its one declaration."""

import sys

from impulse_control_ros.core.parameter import declared, Parameters
from impulse_control_ros.files.experiment import NODES

HEAD = """# Parameters

Made by `python scripts/parameter_table.py`. All can be set while the nodes run (`ros2 param set`
or `param set`), except those marked fixed. Numbers in parentheses are equations of the paper.
Values that bind each other: `damping.lower` <= `damping.upper`; `stribeck.F_s` is 0 or at least
`F_c`; `m` + `payload.mass` > 0; `disturbance.end` is 0 or after its start; plant and controller
have the same `time_step` and `joint_name`; `lockstep: false` needs a `real_time_factor` above 0.
"""


def rows(kind: type[Parameters]) -> list[str]:
    """Return the Markdown table of a node's parameters."""
    lines = ['| parameter | default | unit | allowed | meaning |', '|---|---|---|---|---|']
    for name, default, spec in declared(kind):
        shown = (
            ', '.join(default)
            if isinstance(default, tuple)
            else str(default).lower()
            if isinstance(default, bool)
            else str(default)
        )
        fixed = ' (fixed)' if spec.read_only else ''
        allowed = spec.allowed(type(default)).removeprefix('in ').replace('|', '\\|')
        lines.append(
            f'| `{name}` | {shown} | {spec.unit} | {allowed} | {spec.description}{fixed} |'
        )
    return lines


def document() -> str:
    """Return the whole file."""
    parts = [HEAD]
    for node, kind in NODES.items():
        parts.append('\n'.join([f'## {node}', '', *rows(kind), '']))
    return '\n'.join(parts)


if __name__ == '__main__':
    sys.stdout.write(document())
