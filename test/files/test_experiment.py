"""The experiments that come with the package, and parameter files that are refused by name."""

import re

import pytest
import yaml

from impulse_control_ros.core.parameter import build, declared
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import axis_of, NODES, PlantParameters
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.yaml_file import flattened
from test.conftest import CONFIG, ROOT

FILES = sorted(CONFIG.glob('*.yaml'))
SHORT = [path for path in FILES if path.stem != 'axis'] + [
    ROOT / 'examples' / 'mujoco_axis' / 'axis.yaml'
]
SHOWN = {'m', 'K', 'D', 'd_bar', 'c'}  # in every experiment


def given_in(text):
    """Return the parameters of each node as a file names them."""
    return {
        key.removeprefix('/**/'): flattened(section['ros__parameters'])
        for key, section in yaml.safe_load(text).items()
    }


def comments_in(text):
    """Return the comments of the parameters, in order; a comment may go on in the next lines."""
    found = []
    for line in text.splitlines():
        if new := re.match(r' +\w+: .*?# (.*)', line):
            found.append(new[1])
        elif more := re.match(r' +#   (.*)', line):
            found[-1] += f' {more[1]}'
    return found


def comment_on(value, default, spec):
    """Return what axis.yaml is to say of a parameter: its unit, meaning, choices and default."""
    said = f'[{spec.unit}] {spec.description}' if spec.unit else spec.description
    if spec.choices:
        said += f'; one of {", ".join(map(str, spec.choices))}'
    return said if value == default else f'{said}; default {yaml.safe_dump(default).split()[0]}'


def test_axis_yaml_has_every_parameter_with_its_unit_meaning_and_default():
    text = (CONFIG / 'axis.yaml').read_text().replace('# bag: NAME', "bag: ''    ")
    given = given_in(text)
    names = [(node, name) for node in given for name in given[node]]
    assert dict(zip(names, comments_in(text), strict=True)) == {
        (node, name): comment_on(build(kind, given[node]).flat()[name], default, spec)
        for node, kind in NODES.items()
        for name, default, spec in declared(kind)
    }


@pytest.mark.parametrize('path', SHORT, ids=lambda path: path.stem)
def test_every_other_experiment_names_its_gains_and_what_it_changes(path):
    text = path.read_text()
    given = given_in(text)
    assert given['controller'].keys() >= SHOWN
    for node, values in given.items():
        made = build(NODES[node], values).flat()
        for name, default, _ in declared(NODES[node]):
            assert name not in values or name in SHOWN or made[name] != default
    assert re.match(r'# .*\n/', text)
    assert len(text.splitlines()) <= 20


def test_plant_and_controller_agree_in_every_experiment():
    for path in FILES:
        experiment = load_experiment(path)
        plant, controller = experiment.plant, experiment.gains
        assert (plant.m, plant.time_step, plant.joint_name) == (
            controller.m,
            controller.time_step,
            controller.joint_name,
        )


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('controller:\n  ros__parameters:\n    K: ten\n', "controller: invalid K = 'ten'"),
        ('controller:\n  ros__parameters:\n    Kp: 1.0\n', 'Kp = 1.0'),
        ('contoller:\n  ros__parameters:\n    K: 1.0\n', "'contoller'"),
        ('controller:\n  K: 1.0\n', 'controller has no ros__parameters'),
        ('controller: [\n', 'expected'),
        ('plant_simulator:\n  ros__parameters:\n    damping: {kind: wavy}\n', "kind = 'wavy'"),
        ('controller:\n  ros__parameters: {K: 1.0, K: 2.0}\n', 'K stands twice, again on line 2'),
        ('- K\n', ': must be a mapping of plant_simulator'),
    ],
)
def test_a_wrong_file_is_refused_by_name(tmp_path, text, said):
    path = tmp_path / 'wrong.yaml'
    path.write_text(text)
    with pytest.raises(ParameterError) as refused:
        load_experiment(path)
    assert said in str(refused.value)
    assert 'wrong.yaml' in str(refused.value)
    assert '\n' not in str(refused.value)


def test_a_node_is_known_in_any_namespace(tmp_path):
    path = tmp_path / 'namespaced.yaml'
    path.write_text('/arm/controller:\n  ros__parameters:\n    K: 3.0\n')
    assert load_experiment(path).gains.K == 3.0


@pytest.mark.parametrize(
    'text',
    [
        '/**:\n  ros__parameters: {use_sim_time: false}\n',
        'arm:\n  controller:\n    ros__parameters: {K: 3.0}\n',
        'controller:\n  ros__parameters:\n    qos_overrides: {/joint_states: {depth: 5}}\n',
    ],
)
def test_what_ros_takes_is_taken(tmp_path, text):
    path = tmp_path / 'legal.yaml'
    path.write_text(text)
    assert (3.0 if 'K: 3.0' in text else 10.0) == load_experiment(path).gains.K


@pytest.mark.parametrize(('name', 'value'), [('time_step', 0.001), ('joint_name', 'elbow')])
def test_a_controller_for_another_plant_is_refused(tmp_path, name, value):
    path = tmp_path / 'two.yaml'
    path.write_text(f'controller:\n  ros__parameters:\n    {name}: {value}\n')
    with pytest.raises(
        ParameterError, match=f'controller: invalid {name} = .* that of plant_simulator'
    ):
        load_experiment(path)


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        ('start_time: 3.0e9', 'start_time = 3000000000.0'),
        ('start_time: 2.0e9, duration: 2.0e8', 'duration = 200000000.0'),
    ],
)
def test_stamps_that_ros_cannot_hold_are_refused(tmp_path, values, said):
    path = tmp_path / 'late.yaml'
    path.write_text(f'plant_simulator:\n  ros__parameters: {{{values}}}\n')
    with pytest.raises(ParameterError, match=said):
        load_experiment(path)


@pytest.mark.parametrize(
    ('values', 'said'),
    [
        ('command_joints: [elbow, axis]', 'empty unless command_interface is effort_array'),
        (
            'command_interface: effort_array, command_joints: [elbow]',
            "empty, or have joint_name = 'axis' once",
        ),
        ('command_interface: effort', 'one of joint_state, effort_array'),
    ],
)
def test_joints_without_the_controlled_one_cannot_be_commanded(tmp_path, values, said):
    path = tmp_path / 'array.yaml'
    path.write_text(f'controller:\n  ros__parameters: {{{values}}}\n')
    with pytest.raises(ParameterError, match=re.escape(said)):
        load_experiment(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ParameterError, match='nowhere.yaml'):
        load_experiment(tmp_path / 'nowhere.yaml')


def test_numbers_are_read_as_ros_reads_them(tmp_path):
    path = tmp_path / 'short.yaml'
    path.write_text('controller:\n  ros__parameters:\n    position_deadband: 1e-4\n    K: 12\n')
    controller = load_experiment(path).gains
    assert (controller.position_deadband, controller.K) == (1e-4, 12.0)


@pytest.mark.parametrize('left_out', ['', 'm', 'F_c', 'damping.kind'])
def test_only_a_plant_that_tells_all_has_an_axis(left_out):
    told = PlantParameters(F_c=0.5).flat() | {'use_sim_time': False}
    told.pop(left_out, None)
    axis = axis_of(told)
    assert axis is None if left_out else axis.F_c == 0.5
    assert axis_of({'use_sim_time': False}) is None
