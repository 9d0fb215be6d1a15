"""Imports point inward: core <- files <- nodes and tools."""

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


def test_only_the_nodes_name_rclpy():
    for path in PACKAGE.rglob('*.py'):
        if path.parent.name != 'nodes':
            lines = path.read_text().splitlines()
            assert not [line for line in lines if line.startswith(('import rclpy', 'from rclpy'))]
    assert Path(PACKAGE, 'nodes', 'spin.py').exists()
