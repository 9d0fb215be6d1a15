"""Bad input: one line that names it, exit status 2, nothing left behind."""

import pytest
import rclpy
import yaml

from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.nodes.controller import Controller
from impulse_control_ros.nodes.plant_simulator import PlantSimulator
from impulse_control_ros.nodes.recorder import Recorder
from test.nodes.runs import composed, UNDERDAMPED

FIRST_START = 'compiling for this machine'  # may come before the refusal
REFUSED = [
    ('controller', {'alpha_ratio': 1.0}, ['alpha_ratio = 1.0', '(19)', '[0.5, 1)']),
    ('controller', {'d_bar': 0.0}, ['d_bar = 0.0', '> 0', '[N s/m]']),
    ('plant_simulator', {'m': -1}, ['m = -1.0', '> 0', '[kg]']),
    ('controller', {'K': 'ten'}, ["K = 'ten'", 'number', '[N/m]']),
    ('controller', {'D': float('nan')}, ['D = nan', '>= 0']),
    ('controller', {'Kp': 10.0}, ['Kp']),
    ('plant_simulator', {'damping': {'kind': 'random'}}, ["damping.kind = 'random'", 'noise']),
    ('plant_simulator', {'time_step': 1.5e-10}, ['time_step = 1.5e-10']),
    ('plant_simulator', {'lockstep': 1}, ['lockstep = 1']),
    ('recorder', {'compression': 'rar'}, ["compression = 'rar'", 'zstd']),
]


def written(graph, node, values):
    """Return a file to come behind that of an experiment, in which one thing is wrong."""
    path = graph.folder / 'wrong.yaml'
    path.write_text(yaml.safe_dump({f'/**/{node}': {'ros__parameters': values}}))
    return path


@pytest.mark.parametrize(('node', 'values', 'said'), REFUSED, ids=lambda one: str(one)[:30])
def test_a_wrong_file_is_refused_with_its_name_the_parameter_and_what_is_allowed(
    graph, node, values, said
):
    with pytest.raises(ParameterError) as refused:
        load_experiment(UNDERDAMPED, written(graph, node, values))
    for text in (*said, 'wrong.yaml', node):
        assert text in str(refused.value)
    assert '\n' not in str(refused.value)


def assert_refused(process, *said):
    assert process.wait() == 2, process.output
    (line,) = (one for one in process.output.splitlines() if FIRST_START not in one)
    for text in said:
        assert text in line


def test_composed_a_wrong_file_is_refused_in_one_line_and_leaves_no_bag(graph):
    wrong = graph.folder / 'typo.yaml'
    wrong.write_text('contoller:\n  ros__parameters:\n    K: 3.0\n')
    misspelt = graph.start('closed_loop', config=wrong)
    files = [UNDERDAMPED, written(graph, 'controller', {'alpha_ratio': 1.0})]
    process, alone = composed(graph, files), graph.start('controller', config=files)
    assert_refused(process, 'wrong.yaml: /**/controller: invalid alpha_ratio = 1.0: must be in [')
    assert_refused(alone, 'wrong.yaml: /**/controller: invalid alpha_ratio = 1.0: must be in [')
    assert_refused(misspelt, "'contoller'", 'controller')
    assert not (graph.folder / 'bag').exists()


@pytest.mark.parametrize(
    ('node', 'arguments', 'said'),
    [
        (Controller, 'alpha_ratio:=1.0', 'alpha_ratio = 1.0'),
        (Controller, 'K:=ten', "K = 'ten'"),
        (PlantSimulator, 'F_c:=-1.0', 'F_c = -1.0'),
        (PlantSimulator, 'lockstep:=false', 'real_time_factor = 0.0'),
        (PlantSimulator, 'dampin.kind:=noise', 'damping.kind'),
        (PlantSimulator, 'clock_rate:=1.0e-300', 'clock_rate = 1e-300'),
        (PlantSimulator, 'x_0:=1.0e+100', 'x_0 = 1e+100'),
        (Recorder, 'topics:=setpoint', "topics = 'setpoint'"),
    ],
)
def test_a_node_refuses_a_wrong_parameter(client, node, arguments, said):
    with pytest.raises(ParameterError) as refused:
        node(
            context=client.node.context,
            use_global_arguments=False,
            cli_args=['--ros-args', '-p', arguments],
        )
    assert said in str(refused.value)
    assert '\n' not in str(refused.value)
    assert rclpy.ok(context=client.node.context)


def test_executables_refuse_wrong_arguments_in_one_line(graph):
    started = [
        (graph.start(node, '--ros-args', *arguments.split()), said)
        for node, arguments, said in (
            ('controller', '-p K:=ten', "K = 'ten'"),
            ('controller', '-p F_c:=0.5', 'there is no such parameter of /controller'),
            ('recorder', '-p recorder:F_c:=0.5', 'invalid F_c = 0.5: there is no such parameter'),
            ('controller', '-p lead:=0.5', 'its name is now guard_lookahead'),
            ('controller', '--nonsense', '--nonsense'),
            ('plant_simulator', '--params-file nowhere.yaml', 'nowhere.yaml'),
            ('recorder', '--log-level nonsense', 'nonsense'),
            ('recorder', '-p bag:=/proc/nowhere/bag', '/proc/nowhere/bag'),
            ('recorder', f'-p bag:={"b" * 300}', 'bbb'),
        )
    ]
    for process, said in started:
        assert_refused(process, said)
    bogus = graph.start('controller', '--bogus')
    assert bogus.wait() == 2
    assert '--bogus' in bogus.output


def test_help_is_given(graph):
    for process in [
        graph.start(node, '--help')
        for node in ('plant_simulator', 'controller', 'recorder', 'closed_loop')
    ]:
        assert process.wait() == 0
        assert '--params-file' in process.output


def test_an_existing_bag_is_refused_and_left_as_it_is(graph):
    bag = graph.folder / 'bag'
    bag.mkdir()
    (bag / 'mine.txt').write_text('precious')
    assert_refused(graph.start('recorder', bag=bag), 'exists')
    assert [path.name for path in bag.iterdir()] == ['mine.txt']
