"""Imports point inward: core <- files <- nodes and tools; all but kernels has types."""

import ast
from pathlib import Path
import subprocess
import sys

import pytest

from test.conftest import ROOT

PACKAGE = ROOT / 'impulse_control_ros'


def modules(room: str) -> list[str]:
    return [
        '.'.join(path.relative_to(ROOT).with_suffix('').parts)
        for path in sorted((PACKAGE / room).rglob('*.py'))
        if path.stem != '__init__'
    ]


def loaded_by(names: list[str]) -> set[str]:
    code = f'import sys, {", ".join(names)}; print(" ".join(sys.modules))'
    return set(
        subprocess.run(
            [sys.executable, '-c', code], check=True, capture_output=True, text=True, cwd=ROOT
        ).stdout.split()
    )


@pytest.mark.parametrize(
    ('room', 'outside'),
    [
        (
            'core',
            [
                'rclpy',
                'mcap',
                'pandas',
                'matplotlib',
                'impulse_control_ros.files',
                'impulse_control_ros.nodes',
                'impulse_control_ros.tools',
            ],
        ),
        (
            'files',
            ['rclpy', 'matplotlib', 'impulse_control_ros.nodes', 'impulse_control_ros.tools'],
        ),
        ('tools', ['rclpy', 'impulse_control_ros.nodes']),
    ],
)
def test_a_room_imports_nothing_from_outside_it(room, outside):
    names = modules(room)
    assert names
    loaded = loaded_by(names)
    assert set(names) <= loaded
    assert loaded.isdisjoint(outside)


def test_ctrl_c_is_taken_before_anything_slow_is_imported():
    loaded = loaded_by(['impulse_control_ros.command_line'])
    assert loaded.isdisjoint(['rclpy', 'numba', 'numpy', 'mcap', 'yaml', 'tqdm'])


def test_only_the_nodes_name_rclpy():
    for path in PACKAGE.rglob('*.py'):
        if PACKAGE / 'nodes' not in path.parents:
            lines = path.read_text().splitlines()
            assert not [line for line in lines if line.startswith(('import rclpy', 'from rclpy'))]
    assert Path(PACKAGE, 'nodes', 'spin.py').exists()


def test_every_function_of_core_that_is_no_kernel_has_types():
    untyped = [
        f'{path.name}:{node.lineno} {node.name}'
        for path in sorted((PACKAGE / 'core').glob('*.py'))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
        and node.returns is None
        and not {'compiled', 'kernel'} & names_in(node.decorator_list)
    ]
    assert untyped == []


def names_in(decorators: list[ast.expr]) -> set[str]:
    return {node.id for one in decorators for node in ast.walk(one) if isinstance(node, ast.Name)}
