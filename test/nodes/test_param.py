"""``param`` on running nodes, ours and others, with the words and output of ``ros2 param``."""

from contextlib import closing
from functools import partial
import subprocess
import sys

import pytest
from rclpy.parameter import parameter_dict_from_yaml_file

from impulse_control_ros.core.parameter import declared
from impulse_control_ros.files.experiment import ControllerParameters
from impulse_control_ros.files.parameter_file import load_experiment
from test.command_lines import status_of
from test.conftest import Client, CONFIG, wait_for
from test.processes import die_with_parent, Graph

PATIENCE = ('--timeout', '60')
FOREIGN = """
import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import SingleThreadedExecutor

from impulse_control_ros.nodes.transport import prefer_udp

prefer_udp(rclpy.get_rmw_implementation_identifier())
rclpy.init()
executor = SingleThreadedExecutor()
nodes = [rclpy.create_node('controller', namespace=space) for space in ('left', 'right')]
for name, value in (('gain', 1.5), ('gains', [1.0, 2.0]), ('word', '1e-6'), ('some', [''])):
    nodes[0].declare_parameter(name, value)
nodes[0].declare_parameter('fixed', 'x', ParameterDescriptor(read_only=True))
nodes[0].declare_parameter('any', 1, ParameterDescriptor(dynamic_typing=True))
for node in nodes:
    executor.add_node(node)
executor.spin()
"""
FIXED = 'Trying to set a read-only parameter: fixed.'


@pytest.fixture(scope='module')
def axis(tmp_path_factory):
    """Return the graph of a composed run that stays paused, whatever gains it is given."""
    graph = Graph(tmp_path_factory.mktemp('axis'))
    try:
        process = graph.start(
            'closed_loop',
            config=CONFIG / 'axis.yaml',
            **{'recorder:bag': graph.folder / 'bag', 'plant_simulator:start_paused': True},
        )
        process.says('waiting for')
        yield graph
    finally:
        graph.close()


@pytest.fixture(scope='module')
def values(axis):
    """Return a function that asks a node of the run for the values of parameters."""
    client = Client(axis)
    try:
        yield client.get
    finally:
        client.close()


@pytest.fixture
def param(axis, monkeypatch, capsys):
    """Return a function that runs ``param``: the exit status, and what it printed."""
    return runner(axis, monkeypatch, capsys)


def runner(graph, monkeypatch, capsys):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(graph.domain))

    def run(verb, *arguments, patience=PATIENCE):
        status = status_of('param', verb, *arguments, *patience)
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


def test_several_values_are_set_at_once(param, values):
    assert param('set', '/controller', 'K', '12', 'D', '0.7') == (
        0,
        'Set parameter successful\n',
        '',
    )
    assert values('controller', 'K', 'D') == [12.0, 0.7]


def test_a_refused_value_is_told_with_its_reason_and_changes_nothing(param, values):
    param('set', '/controller', 'K', '12', 'D', '0.7')
    for bad, reason in (
        (('K', '13', 'D', '-2'), 'invalid D = -2.0: must be >= 0 [N s/m]'),
        (('K', '13', 'nope', '1'), 'invalid nope = 1: there is no such parameter'),
    ):
        assert param('set', '/controller', *bad) == (
            1,
            '',
            f'param: Setting parameter failed: {reason}\n',
        )
    assert values('controller', 'K', 'D') == [12.0, 0.7]


def test_values_are_yaml_with_the_numbers_of_ros(param, values):
    given = {'x_r': '-1e-3', 'velocity_deadband': '1e-6', 'K': '2', 'D': '.5', 'impulses': 'off'}
    assert param('set', 'controller', *(text for pair in given.items() for text in pair))[0] == 0
    assert values('controller', *given) == [-0.001, 1e-6, 2.0, 0.5, False]


def test_get_list_and_describe_print_what_ros2_param_prints(param):
    assert param('get', '/controller', 'c') == (0, 'Double value is: 2.0\n', '')
    assert param('get', '/recorder', 'topics')[1] == (
        "String values are: ['setpoint', 'damping']\n"
    )
    assert param('list', '/controller', '--filter', 'K', '--param-type')[1] == (
        '  K (type: double)\n  K_i (type: double)\n'
    )
    assert param('list', '/plant_simulator', '--param-prefixes', 'stribeck')[1] == (
        '  stribeck.F_s\n  stribeck.v_s\n'
    )
    assert param('describe', '/controller', 'time_step')[1] == (
        'Parameter name: time_step\n'
        '  Type: double\n'
        '  Description: sampling period of plant and controller [s]\n'
        '  Constraints:\n'
        '    Read only: true\n'
        '    Min value: 1e-09\n'
        '    Max value: 1.0\n'
        '    Additional constraints: in [1e-09, 1]\n'
    )


def test_an_unknown_parameter_is_named_with_the_one_that_may_be_meant(param):
    assert param('get', '/controller', 'effort_limt') == (
        1,
        '',
        'param: Parameter not set: effort_limt of /controller; is effort_limit meant?\n',
    )
    assert param('describe', '/controller', 'K', 'nope') == (
        1,
        '',
        'param: Parameter not declared: nope of /controller\n',
    )


def test_a_node_that_is_not_there_is_named_with_those_that_are(param, values):
    values('controller', 'K')  # its client is a node too

    def told():
        status, out, said = param('get', '/controler', 'K', patience=('--timeout', '0.5'))
        assert (status, out) == (1, '')
        assert said.startswith('param: Node not found: /controler within 0.5 s; ')
        return said.endswith(
            'the nodes found are /controller, /plant_simulator, /recorder, /test_client\n'
        )

    wait_for(told, 'the nodes that are there')


def test_a_dump_is_what_ros2_param_reads_and_sets_all_again(param, tmp_path):
    param('set', '/controller', 'K', '12', 'velocity_deadband', '1e-6')
    status, text, _ = param('dump', '/controller')
    assert status == 0
    dumped = tmp_path / 'dumped.yaml'
    dumped.write_text(text)
    assert {'K', 'velocity_deadband', 'time_step', 'use_sim_time'} <= {
        *parameter_dict_from_yaml_file(str(dumped))
    }
    param('set', '/controller', 'K', '10', 'velocity_deadband', '0')
    status, out, said = param('load', '/controller', dumped)
    assert (status, said) == (0, '')
    assert 'Set parameter K successful\n' in out
    assert param('dump', '/controller')[1] == text


def test_load_takes_the_sections_of_the_node_and_sets_all_or_nothing(param, values, tmp_path):
    file = tmp_path / 'both.yaml'
    file.write_text(
        '/**: {ros__parameters: {D: 0.3, F_c: 0.5}}\n'
        '/**/controller: {ros__parameters: {m: 0.3}}\n'
        '/plant_simulator: {ros__parameters: {m: 0.4}}\n'
    )
    assert param('load', '/controller', file) == (
        0,
        'Set parameter D successful\nSet parameter m successful\n',
        '',
    )
    assert values('controller', 'D', 'm') == [0.3, 0.3]
    assert values('plant_simulator', 'm') == [0.1]
    assert param('load', '/controller', file, '--no-use-wildcard')[1] == (
        'Set parameter m successful\n'
    )
    file.write_text('/controller: {ros__parameters: {m: 0.1, D: -1}}\n')
    status, out, said = param('load', '/controller', file)
    assert (status, out) == (1, '')
    assert said == (
        f'param: {file}: setting parameters failed: invalid D = -1.0: must be >= 0 [N s/m]\n'
    )
    assert values('controller', 'm') == [0.3]
    status, _, said = param('load', '/recorder', file)
    assert (status, said) == (
        2,
        f'param: {file}: no section is for /recorder; the sections are /controller\n',
    )


def test_the_running_values_are_saved_as_an_experiment(param, values, tmp_path):
    file = tmp_path / 'tuned.yaml'
    param('set', '/controller', 'K', '14', 'x_r', '0.1')
    param('set', '/plant_simulator', 'damping.kind', 'noise', 'damping.upper', '1.25')
    told = f'saved /controller, /plant_simulator, /recorder to {file}\n'
    wait_for(lambda: param('dump', '--save', file)[1] == told, 'the three nodes')
    saved = load_experiment(file)
    assert (saved.gains.K, saved.gains.x_r) == (14.0, 0.1)
    assert (saved.plant.damping.kind, saved.plant.damping.upper) == ('noise', 1.25)
    assert saved.recorder.bag == ''  # the next run needs another one
    for node, parameters in (('controller', saved.gains), ('plant_simulator', saved.plant)):
        flat = parameters.flat()
        told = [list(one) if isinstance(one, tuple) else one for one in flat.values()]
        assert values(node, *flat) == told


@pytest.fixture(scope='module')
def foreign(tmp_path_factory):
    """Return the graph of two nodes that are not of this package, in a process of their own."""
    graph = Graph(tmp_path_factory.mktemp('foreign'))
    process = subprocess.Popen(
        [sys.executable, '-c', FOREIGN], env=graph.env, preexec_fn=die_with_parent
    )
    yield graph
    process.kill()
    process.wait()
    graph.close()


@pytest.fixture
def others(foreign, monkeypatch, capsys):
    """Return ``param`` on the graph of the foreign nodes."""
    return runner(foreign, monkeypatch, capsys)


def test_any_node_is_set_with_the_types_that_it_describes(foreign, others, tmp_path):
    param, left = others, '/left/controller'
    listed = f'{left}:\n  gain\n  gains\n'
    wait_for(lambda: param('list', '--filter', 'gain') == (0, listed, ''), 'both nodes')
    with closing(Client(foreign)) as client:
        values = partial(client.get, 'left/controller')
        assert (
            param('set', left, 'gain', '2', 'gains', '[3, 4.5]', 'some', '[]', 'fixed', 'x')[0]
            == 0
        )
        assert values('gain', 'some') == [2.0, []]
        assert param('get', left, 'gains')[1] == 'Double values are: [3.0, 4.5]\n'
        assert param('get', left, 'some')[1] == 'String values are: []\n'
        assert param('set', left, 'gain', '4', 'fixed', 'y') == (
            1,
            '',
            f'param: Setting parameter failed: {FIXED}\n',
        )
        status, text, _ = param('dump', left)
        assert status == 0
        (tmp_path / 'left.yaml').write_text(text)
        assert param('set', left, 'gain', '9', 'word', 'other')[0] == 0
        assert values('gain', 'word') == [9.0, 'other']
        assert param('load', left, tmp_path / 'left.yaml')[0] == 0
        assert values('gain', 'word', 'some') == [2.0, '1e-6', []]
        assert param('delete', left, 'any') == (0, 'Deleted parameter successfully\n', '')
        status, _, said = param('set', left, 'any', '1')
        assert (status, said.endswith(' (not declared: any)\n')) == (1, True)


def test_an_experiment_is_saved_only_of_one_namespace_and_of_our_nodes(others, tmp_path):
    file = tmp_path / 'saved.yaml'
    brief = ('--spin-time', '0.2', '--timeout', '0.5')

    def told(options, expected):
        status, _, said = others('dump', '--save', file, *options, patience=brief)
        assert status in (1, 2)  # 1: not all were found so soon
        return said == f'param: {expected}\n'

    first = next(name for name, _, _ in declared(ControllerParameters))
    for options, expected in (
        ((), 'our nodes are in /left, /right: choose one with --namespace'),
        (('--namespace', '/left'), f'Parameter not set: {first} of /left/controller'),
    ):
        wait_for(partial(told, options, expected), expected)
    assert not file.exists()


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['set', '/c', 'K'], 'the value of K is missing (see --help)'),
        (['set', '/c', 'K', '1', 'K', '2'], 'K is given twice'),
        (['set', '/c', 'K', '[1'], "invalid K = '[1': must be YAML"),
        (['get', '/c'], 'the following arguments are required: parameter_name (see --help)'),
        (['dump'], 'a node_name or --save FILE is required, not both (see --help)'),
        (
            ['get', '/c', 'K', '--timeout', 'long'],
            "argument --timeout: 'long': must be a number >= 0 [s] (see --help)",
        ),
    ],
)
def test_a_bad_command_line_is_refused_before_any_node_is_asked(capsys, arguments, said):
    assert status_of('param', *arguments) == 2
    assert capsys.readouterr() == ('', f'param: {said}\n')


def test_a_name_that_no_node_can_have_is_refused(param):
    status, out, said = param('get', '/no node', 'K')
    assert (status, out) == (2, '')
    assert said.startswith("param: invalid node '/no node': ")
