"""Several parameter files, and parameters of a command line, in the order of ROS."""

import pytest

from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.parameter_rules import given_by

ONE = """
/**/controller:
  ros__parameters: {K: 10.0, D: 1.0, c: 1.0}
controller:
  ros__parameters: {K: 12.0}
"""
TWO = """
/**/controller:
  ros__parameters: {K: 14.0, D: 2.0}
"""


@pytest.fixture
def files(tmp_path):
    paths = tmp_path / 'one.yaml', tmp_path / 'two.yaml'
    for path, text in zip(paths, (ONE, TWO), strict=True):
        path.write_text(text)
    return paths


def controller_of(*paths, rules=()):
    return load_experiment(*paths, besides=[one for rule in rules for one in given_by(rule)]).gains


@pytest.mark.parametrize(
    ('order', 'rules', 'expected'),
    [
        # what rclpy's nodes get from the same files and arguments
        ((0,), [], (12.0, 1.0, 1.0)),
        ((0, 1), [], (12.0, 2.0, 1.0)),
        ((1, 0), [], (12.0, 1.0, 1.0)),
        ((0,), ['K:=1.5'], (1.5, 1.0, 1.0)),
        ((0,), ['controller:K:=1.5'], (1.5, 1.0, 1.0)),
        ((1,), ['controller:K:=1.5', 'K:=2.5'], (2.5, 2.0, 2.0)),
        ((1,), ['K:=2.5', 'controller:K:=1.5', 'K:=3.5'], (1.5, 2.0, 2.0)),
        ((0,), ['D:=1e-4'], (12.0, 1e-4, 1.0)),
    ],
)
def test_the_last_value_of_a_key_and_the_last_key_count(files, order, rules, expected):
    found = controller_of(*(files[number] for number in order), rules=rules)
    assert (found.K, found.D, found.c) == expected


def test_a_rule_without_a_node_is_for_each_that_has_the_parameter(files):
    made = load_experiment(files[0], besides=given_by('time_step:=2e-4'))
    assert made.plant.time_step == made.gains.time_step == 2e-4
    assert [node for _, node, _ in given_by('damping.kind:=noise')] == ['plant_simulator']


@pytest.mark.parametrize(
    'rule',
    ['K', 'K:', 'K:=', ':=1', 'K=1', 'node:K:=1', 'Kp:=1', '/controller:K:=1', 'K:=[', 'a b:=1'],
)
def test_a_wrong_rule_is_refused_by_its_text(rule):
    with pytest.raises(ParameterError) as error:
        given_by(rule)
    assert f'-p {rule}' in str(error.value)


def test_an_error_names_all_files_and_the_parameter(files):
    with pytest.raises(ParameterError) as error:
        controller_of(*files, rules=['K:=ten'])
    assert str(error.value) == (
        f"{files[0]}, {files[1]}, -p: controller: invalid K = 'ten': must be a number [N/m]"
    )
