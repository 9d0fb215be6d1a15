"""Bad input: one line that names it, exit status 2, nothing left behind."""

import pytest

from test.conftest import CONFIG

REFUSED = {
    'alpha_ratio: 1.0': ('alpha_ratio: 0.6', ['alpha_ratio = 1.0', '(19)', '[0.5, 1)']),
    'd_bar: 0.0': ('d_bar: 1.5', ['d_bar = 0.0', '> 0', '[N s/m]']),
    'm: -1.0': ('m: 0.1', ['m = -1.0', '> 0', '[kg]']),
    'm: -1': ('m: 0.1', ['m = -1.0', '> 0', '[kg]']),
    'K: "ten"': ('K: 10.0', ["K = 'ten'", 'a number', '[N/m]']),
    'D: .nan': ('D: 0.5', ['D = nan', '>= 0']),
    'Kp: 10.0': ('K: 10.0', ['Kp = 10.0', 'no such parameter']),
    'kind: random': ('kind: constant', ["damping.kind = 'random'", 'constant, noise']),
    'time_step: 1.5e-10': ('time_step: 0.0001', ['time_step = 1.5e-10']),
    'lockstep: 1': ('lockstep: true', ['lockstep = 1', 'true or false']),
    'compression: rar': ('compression: zstd', ["compression = 'rar'", 'none, lz4, zstd']),
}


@pytest.mark.parametrize('wrong', REFUSED)
def test_a_wrong_file_is_refused_in_one_line_and_leaves_no_bag(graph, wrong):
    right, said = REFUSED[wrong]
    config, bag = graph.folder / 'wrong.yaml', graph.folder / 'bag'
    text = (CONFIG / 'underdamped.yaml').read_text()
    assert right in text
    config.write_text(text.replace(right, wrong, 1))
    process = graph.start('closed_loop', '--ros-args', '-p', f'recorder:bag:={bag}',
                          config=config)
    assert process.wait() == 2
    assert len(process.output.splitlines()) == 1
    for text in (*said, 'wrong.yaml'):
        assert text in process.output
    assert not bag.exists()


@pytest.mark.parametrize(('node', 'arguments', 'said'), [
    ('controller', '-p alpha_ratio:=1.0', 'alpha_ratio = 1.0'),
    ('controller', '-p K:=ten', "K = 'ten'"),
    ('plant_simulator', '-p F_c:=-1.0', 'F_c = -1.0'),
    ('plant_simulator', '-p lockstep:=false', 'real_time_factor = 0.0'),
    ('plant_simulator', '-p dampin.kind:=noise', 'damping.kind meant'),
    ('plant_simulator', '-p clock_rate:=1.0e-300', 'clock_rate = 1e-300'),
    ('plant_simulator', '-p x_0:=1.0e+100', 'x_0 = 1e+100'),
    ('recorder', '-p topics:=setpoint', "topics = 'setpoint'"),
    ('controller', '--nonsense', "unknown ROS arguments ['--nonsense']"),
    ('controller', '--params-file nowhere.yaml', 'nowhere.yaml'),
    ('controller', '--log-level nonsense', 'nonsense'),
])
def test_a_node_refuses_a_wrong_argument_in_one_line(graph, node, arguments, said):
    process = graph.start(node, '--ros-args', *arguments.split())
    assert process.wait() == 2
    assert len(process.output.splitlines()) == 1
    assert said in process.output


def test_an_unknown_option_is_refused(graph):
    process = graph.start('controller', '--bogus')
    assert process.wait() == 2
    assert '--bogus' in process.output


@pytest.mark.parametrize('node', ['plant_simulator', 'controller', 'recorder', 'closed_loop'])
def test_help_is_given(graph, node):
    process = graph.start(node, '--help')
    assert process.wait() == 0
    assert '--params-file' in process.output


def test_an_existing_bag_is_refused_and_left_as_it_is(graph):
    bag = graph.folder / 'bag'
    bag.mkdir()
    (bag / 'mine.txt').write_text('precious')
    process = graph.start('recorder', '--ros-args', '-p', f'bag:={bag}')
    assert process.wait() == 2
    assert 'exists' in process.output
    assert len(process.output.splitlines()) == 1
    assert [path.name for path in bag.iterdir()] == ['mine.txt']


def test_a_misspelt_node_in_the_file_is_refused(graph):
    config = graph.folder / 'typo.yaml'
    config.write_text('contoller:\n  ros__parameters:\n    K: 3.0\n')
    process = graph.start('closed_loop', config=config)
    assert process.wait() == 2
    assert "'contoller'" in process.output
    assert 'controller' in process.output
