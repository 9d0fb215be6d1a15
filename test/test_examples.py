"""The examples, run as their text says; the MuJoCo axis is in nodes/test_mujoco_axis.py."""

import os
from xml.etree import ElementTree

from nbclient import NotebookClient
import nbformat
import numpy as np
import pytest
import yaml

from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from test.processes import BIN, CONFIG, ROOT

EXAMPLES = ROOT / 'examples'
K, D, X_R = 12.0, 0.5, 0.1


def test_a_controller_of_ones_own_answers_every_state_and_the_axis_settles(graph):
    bag, config = graph.folder / 'bag', CONFIG / 'pd_only_upper.yaml'
    recorder = graph.start('recorder', config=config, bag=bag)
    controller = graph.start('python', EXAMPLES / 'my_controller.py', K=K, D=D, x_r=X_R)
    # the recorder may discover the others late: the plant waits for it for command_timeout
    how = {'duration': 2.0, 'time_step': 1e-3, 'command_timeout': 30.0}
    plant = graph.start('plant_simulator', config=config, **how)
    assert plant.wait() == 0, plant.output
    assert recorder.interrupt() == controller.interrupt() == 0, controller.output
    assert plant.totals['accepted'] == plant.totals['steps'] + 1
    run = read_bag(bag)
    assert len(run.time) == 2001
    recorded = np.isfinite(run.effort)  # not before the recorder has discovered the controller
    assert recorded.any()
    law = -K * (run.position - X_R) - D * run.velocity
    assert np.array_equal(run.effort[recorded], law[recorded])
    assert run.position[0] == 0.5
    assert run.position[-1] == pytest.approx(X_R, abs=1e-6)


def test_the_files_of_the_ros2_control_example_name_the_same_joint_topics_and_period():
    folder = EXAMPLES / 'ros2_control'
    ours = load_experiment(folder / 'axis.yaml')
    manager = yaml.safe_load((folder / 'controllers.yaml').read_text())
    names = manager['controller_manager']['ros__parameters']
    hardware = ElementTree.parse(folder / 'axis.urdf').find('ros2_control')
    given = {one.get('name'): one.text for one in hardware.iterfind('hardware/param')}
    launched = (folder / 'ros2_control.launch.py').read_text()
    assert given['joint_states_topic'] == '/hardware/joint_states'
    assert given['joint_commands_topic'] == '/hardware/joint_commands'
    assert given['trigger_joint_command_threshold'] == '-1'
    assert "namespace='/hardware'" in launched
    assert "('effort_commands', '/forward_effort_controller/commands')" in launched
    assert 'forward_effort_controller' in names
    assert (
        hardware.find('joint').get('name'),
        *manager['forward_effort_controller']['ros__parameters']['joints'],
        *manager['pid_controller']['ros__parameters']['dof_names'],
    ) == (ours.gains.joint_name,) * 3
    assert names['update_rate'] * ours.gains.time_step == pytest.approx(1.0)
    assert ours.plant.clock_rate == names['update_rate']


def test_the_notebook_runs_from_top_to_bottom(monkeypatch):
    monkeypatch.setenv('PATH', f'{BIN}{os.pathsep}{os.environ["PATH"]}')
    notebook = nbformat.read(EXAMPLES / 'first_steps.ipynb', as_version=4)
    assert not any(cell.get('outputs') for cell in notebook.cells)
    NotebookClient(notebook, resources={'metadata': {'path': str(EXAMPLES)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get('outputs', [])]
    assert sum('image/png' in output.get('data', {}) for output in shown) == 3
    assert not [output.text for output in shown if output.get('name') == 'stderr']
    print(*(output.text for output in shown if output.get('name') == 'stdout'))
