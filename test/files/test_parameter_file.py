"""Several parameter files and rules: what each node gets is what rcl gives it, or is refused."""

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from impulse_control_ros.core.parameter import RENAMED
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import ControllerParameters, NODES, PlantParameters
from impulse_control_ros.files.parameter_file import (
    command_line_sections,
    load_experiment,
    merged,
    unused,
)

TEXTS = {
    'named': 'controller:\n  ros__parameters: {K: 12.0, D: 1.0}\n',
    'anywhere': '/**/controller:\n  ros__parameters: {K: 14.0, c: 1.0}\n',
    'shared': '/**:\n  ros__parameters: {m: 0.2, D: 0.7, F_c: 0.5}\n',
    'level': '/*:\n  ros__parameters: {K: 16.0}\n',
    'nested': 'arm:\n  controller:\n    ros__parameters: {K: 18.0, x_r: 1e-1}\n',
    'deep': '/arm/**/controller:\n  ros__parameters: {K: 20, alpha_ratio: 0.7}\n',
    'other': '/**/controller:\n  ros__parameters: {K: 14.5, x_r: 0.3}\n',
    'whole': '/**/controller:\n  ros__parameters: {K: 15}\n',
}


SCALARS = """
1 -2 +3 010 0x1f 08 1_000 1.5 -1. .5 1e-4 +2.E3 1e 1:30 .inf -.Inf inf .nan ~ null y No on TRUE
tRUE 2024-01-01 2024_01_01 '1' =
"""


@pytest.fixture
def files(tmp_path):
    """Return a function from texts by name to the paths of their files."""

    def written(*names, **texts):
        made = [(name, TEXTS[name]) for name in names] + list(texts.items())
        for name, text in made:
            (tmp_path / f'{name}.yaml').write_text(text)
        return [tmp_path / f'{name}.yaml' for name, _ in made]

    return written


@pytest.fixture(scope='module')
def given_by_rcl():
    """Return a function from ROS arguments to the parameters and the full name of a controller."""

    def given(arguments):
        context = Context()
        rclpy.init(args=arguments, context=context)
        node = Node('controller', context=context)
        values = {name: item.value for name, item in node._parameter_overrides.items()}
        name = node.get_fully_qualified_name()
        node.destroy_node()
        rclpy.shutdown(context=context)
        return values, name

    return given


@pytest.mark.parametrize('namespace', ['/', '/arm', '/arm/left'])
@pytest.mark.parametrize(
    ('names', 'rules'),
    [
        (['named'], []),
        (['anywhere', 'named'], []),
        (['named', 'anywhere'], []),
        (['anywhere', 'other'], []),
        (['anywhere', 'other', 'named'], []),
        (['shared', 'anywhere', 'level'], []),
        (['nested', 'deep'], []),
        (['deep', 'level', 'nested'], []),
        (['other', 'whole'], []),
        (['named'], ['K:=1.5', 'x_r:=2e-1']),
        (['named', 'shared'], ['controller:K:=1.5', 'D:=2.5', 'm:=3']),
        (['other'], ['K:=2.5', 'controller:K:=1.5', 'use_sim_time:=true']),
    ],
)
def test_a_node_gets_what_rcl_gives_it(files, given_by_rcl, names, rules, namespace):
    arguments = ['--ros-args', '-r', f'__ns:={namespace}']
    for path in files(*names):
        arguments += ['--params-file', str(path)]
    for rule in rules:
        arguments += ['-p', rule]
    values, name = given_by_rcl(arguments)
    known = ControllerParameters().flat()
    ours = merged(command_line_sections(arguments), name, ControllerParameters)
    assert ours == {name: value for name, value in values.items() if name in known}


@pytest.mark.parametrize('text', SCALARS.split())
def test_a_value_has_the_type_that_rcl_gives_it(given_by_rcl, text):
    values, _ = given_by_rcl(['--ros-args', '-p', f'x:={text}'])
    found = next(command_line_sections(['-p', f'x:={text}'])).values['x']
    assert (type(found), str(found)) == (type(values['x']), str(values['x']))


@pytest.mark.parametrize(
    ('names', 'rules', 'rcl_takes', 'said'),
    [
        (['anywhere', 'named', 'other'], [], 12.0, 'other.yaml: /**/controller: K = 14.5'),
        (['whole', 'anywhere'], [], 15, 'anywhere.yaml: /**/controller: K = 14.0'),
        (['shared', 'named'], ['K:=1.5'], 12.0, '-p K:=1.5: K = 1.5'),
        ([], ['K:=2', 'K:=3.5'], 2, '-p K:=3.5: K = 3.5'),
    ],
)
def test_a_last_value_that_rcl_does_not_take_is_refused(
    files, given_by_rcl, names, rules, rcl_takes, said
):
    arguments = ['--ros-args']
    for path in files(*names):
        arguments += ['--params-file', str(path)]
    for rule in rules:
        arguments += ['-p', rule]
    assert given_by_rcl(arguments)[0]['K'] == rcl_takes
    with pytest.raises(ParameterError) as refused:
        load_experiment(*files(*names), rules=rules)
    assert f'{said} has no effect: rcl takes the earlier {rcl_takes} of /' in str(refused.value)


def test_later_files_and_then_rules_count_for_each_node(files):
    made = load_experiment(*files('anywhere', 'other', 'shared'), rules=['x_r:=0.4', 'F_c:=0.1'])
    assert (made.gains.K, made.gains.c, made.gains.x_r) == (14.5, 1.0, 0.4)
    assert made.plant.m == made.gains.m == 0.2
    assert made.plant.F_c == 0.1


def test_a_tilde_in_a_path_is_the_home_folder(files, tmp_path, monkeypatch):
    files('named')
    monkeypatch.setenv('HOME', str(tmp_path))
    assert load_experiment('~/named.yaml').gains.K == 12.0


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('/**/controller:\n  ros__parameters: {Kp: 1.0}\n', 'invalid Kp = 1.0: there is no such'),
        ('/**:\n  ros__parameters: {F_k: 1.0}\n', 'invalid F_k = 1.0: there is no such'),
        (
            '/**/controller:\n  ros__parameters: {F_c: 1.0}\n',
            'invalid F_c = 1.0: there is no such',
        ),
        ('/**:\n  ros__parameters: {K: -1.0}\n', 'invalid K = -1.0: must be > 0 [N/m]'),
        *(
            (f'/**/controller:\n  ros__parameters: {{{old}: 1}}\n', f'its name is now {new}')
            for old, new in RENAMED.items()
        ),
    ],
)
def test_what_is_wrong_in_the_second_file_is_refused_with_its_name(files, text, said):
    with pytest.raises(ParameterError) as refused:
        load_experiment(*files('anywhere', second=text))
    assert 'second.yaml: /**' in str(refused.value)
    assert 'anywhere.yaml' not in str(refused.value)
    assert said in str(refused.value)


def test_values_that_do_not_fit_together_are_refused_with_all_files(files):
    one, two = files(
        one='/**/plant_simulator:\n  ros__parameters: {start_time: 2.0e9}\n',
        two='/**/plant_simulator:\n  ros__parameters: {duration: 2.0e8}\n',
    )
    with pytest.raises(ParameterError, match='duration = 200000000.0') as refused:
        load_experiment(one, two)
    assert str(refused.value).startswith(f'{one}, {two}: plant_simulator: ')


def test_files_for_two_namespaces_are_refused(files):
    with pytest.raises(ParameterError, match='in the namespaces /, /arm: must be one'):
        load_experiment(*files('named', 'nested'))
    assert load_experiment(*files('nested'), rules=['controller:D:=0.9']).gains.D == 0.9


@pytest.mark.parametrize(
    'rule',
    ['K', 'K:', 'K:=', ':=1', 'K=1', 'node:K:=1', 'Kp:=1', '/controller:K:=1', 'K:=[', 'a b:=1'],
)
def test_a_wrong_rule_is_refused_by_its_text(rule):
    with pytest.raises(ParameterError) as refused:
        load_experiment(rules=[rule])
    assert f'-p {rule}' in str(refused.value)


ALONE = {'/arm/controller': ControllerParameters}
ALL = {f'/arm/{name}': kind for name, kind in NODES.items()}
RENAMED_ONE = {'/other': ControllerParameters}
RENAMED_ALL = {'/plant_simulator': PlantParameters, **RENAMED_ONE}
MISSED = '/**/NAME is a node in any namespace'


@pytest.mark.parametrize(
    ('name', 'nodes', 'said'),
    [
        ('named', ALONE, f'/controller matches none of /arm/controller; in a file, {MISSED}'),
        ('named', ALL, f'/controller matches none of /arm/controller; in a file, {MISSED}'),
        ('anywhere', RENAMED_ONE, f'/**/controller matches none of /other; in a file, {MISSED}'),
        ('anywhere', RENAMED_ALL, f'/**/controller matches none of /other; in a file, {MISSED}'),
        ('nested', ALL, ''),
        ('plant', ALONE, ''),
        ('typo', ALONE, f'/**/contoller matches none of /arm/controller; in a file, {MISSED}'),
    ],
)
def test_a_file_that_misses_the_nodes_is_named(files, name, nodes, said):
    written = files(
        'named',
        'anywhere',
        'nested',
        **{
            'plant': '/**/plant_simulator:\n  ros__parameters: {F_c: 0.0}\n',
            'typo': '/**/contoller:\n  ros__parameters: {K: 1.0}\n',
        },
    )
    path = next(path for path in written if path.stem == name)
    sections = list(command_line_sections(['--params-file', str(path)]))
    assert list(unused(sections, nodes)) == [f'{path}: {said}'] * bool(said)


@pytest.mark.parametrize(
    ('rule', 'nodes', 'said'),
    [
        ('F_c:=1.0', ALONE, 'there is no such parameter of /arm/controller'),
        ('F_c:=1.0', ALL, ''),
        ('use_sim_time:=true', ALONE, ''),
        ('recorder:bag:=a', ALONE, '/recorder matches none of /arm/controller'),
    ],
)
def test_a_rule_that_no_node_of_the_process_takes_is_named(rule, nodes, said):
    found = list(unused(list(command_line_sections(['--param', rule])), nodes))
    assert [one.split(';')[0] for one in found] == [f'-p {rule}: {said}'] * bool(said)
