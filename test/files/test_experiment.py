"""Parameter files: complete, plain, and refused by name."""

import pytest
import yaml

from impulse_control_ros.core.parameter import declared
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import axis_of, NODES, PlantParameters
from impulse_control_ros.files.parameter_file import flattened, load_experiment
from test.conftest import CONFIG

FILES = sorted(CONFIG.glob('*.yaml'))


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_every_experiment_is_complete_and_has_nothing_else(path):
    load_experiment(path)
    content = yaml.safe_load(path.read_text())
    for node, kind in NODES.items():
        given = set(flattened(content[f'/**/{node}']['ros__parameters']))
        # a run names its own bag
        assert given == {name for name, _, _ in declared(kind)} - {'bag'}


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
