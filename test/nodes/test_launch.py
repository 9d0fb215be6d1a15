"""The launch file, where launch is installed: it is not on PyPI."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import NODES
from test.processes import BIN, CONFIG, die_with_parent, PATIENCE, ROOT

pytest.importorskip('launch_ros')

LAUNCH = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

path, *arguments = sys.argv[1:]
source = PythonLaunchDescriptionSource(path)
given = [one.split(':=', 1) for one in arguments]
service = LaunchService()
service.include_launch_description(IncludeLaunchDescription(source, launch_arguments=given))
sys.exit(service.run())
"""


@pytest.fixture
def launch(graph):
    """Return a function from launch arguments to the finished launch."""
    prefix = graph.folder / 'prefix'
    share, lib = prefix / 'share' / 'impulse_control_ros', prefix / 'lib' / 'impulse_control_ros'
    index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
    for folder in (share, lib, index):
        folder.mkdir(parents=True)
    (share / 'config').symlink_to(CONFIG)
    (index / 'impulse_control_ros').touch()
    for node in NODES:
        (lib / node).symlink_to(BIN / node)
    (graph.folder / 'short.yaml').write_text(
        '/**/plant_simulator:\n  ros__parameters: {duration: 0.1, wait_for_recorder: true}\n'
    )

    def run(*arguments):
        path = os.pathsep.join([str(prefix), os.environ.get('AMENT_PREFIX_PATH', '')])
        return subprocess.run(
            [sys.executable, '-c', LAUNCH, ROOT / 'launch/closed_loop.launch.py', *arguments],
            capture_output=True,
            text=True,
            check=False,
            cwd=graph.folder,
            env={**graph.env, 'AMENT_PREFIX_PATH': path, 'HOME': str(graph.folder)},
            timeout=PATIENCE,
            preexec_fn=die_with_parent,
        )

    return run


@pytest.mark.parametrize('bag', ['2024_01_01', '1e5', 'true', '~/bag'])
def test_the_bag_has_the_name_that_was_given(launch, graph, bag):
    done = launch('params_file:=~/short.yaml', f'bag:={bag}', 'namespace:=arm')
    assert done.returncode == 0, done.stdout
    recorded = read_bag(graph.folder / Path(bag).name)
    assert len(recorded.states) == 1001
    assert '[arm.plant_simulator]: the run is over' in done.stdout + done.stderr


def test_without_a_recorder_the_plant_does_not_wait_for_one(launch, graph):
    done = launch('params_file:=short.yaml', 'record:=false', 'real_time_factor:=1e-1')
    assert done.returncode == 0, done.stdout
    assert '[recorder' not in done.stdout + done.stderr
    assert not list(graph.folder.glob('impulse_*'))


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['params_file:=nowhere.yaml'], 'params_file: there is no file nowhere.yaml'),
        (['params_file:=short.yaml', 'bag:=prefix'], 'recorder has failed (exit status 2)'),
        (['record:=maybe'], "Valid options are: ['true', 'false']"),
        (['real_time_factor:=fast'], "invalid real_time_factor = 'fast': must be a number"),
        (['real_time_factor:=-1'], 'plant_simulator has failed (exit status 2)'),
    ],
)
def test_an_error_ends_the_launch_with_its_reason(launch, arguments, said):
    done = launch(*arguments)
    assert done.returncode == 1
    assert said in done.stdout + done.stderr
