"""Bags replayed: computed once more to the same bits, and played on the graph."""

from mcap.writer import Writer
import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from impulse_control_ros.core.protocol import parse_command
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.bag import BagWriter, Topic
from impulse_control_ros.files.cdr import encode_float64
from impulse_control_ros.files.mcap_reader import Column, columns
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.files.topics import FLOAT64, SERIES
from test.command_lines import status_of
from test.conftest import CONFIG
from test.files.test_bag import QOS
from test.nodes.runs import stamp_of, STEP
from test.tools.bags import begun, entries, experiment, finished, recorded as simulated
from test.tools.test_analyze import BAD, of_a_robot

LAST = 3_000_000_000


@pytest.fixture
def record(graph):
    """Return a function that makes a bag of an experiment."""

    def recorded(experiment, *arguments):
        bag = graph.folder / experiment
        process = graph.start(
            'closed_loop',
            '--ros-args',
            '--params-file',
            CONFIG / f'{experiment}.yaml',
            '-p',
            f'recorder:bag:={bag}',
            *arguments,
        )
        assert process.wait() == 0, process.output
        return bag

    return recorded


@pytest.fixture
def replay(graph):
    """Return a function that replays a bag: (exit status, what it says)."""

    def replayed(bag, *arguments):
        process = graph.start('replay', bag, *arguments)
        return process.wait(), process.output

    return replayed


@pytest.mark.parametrize('experiment', ['underdamped', 'coulomb', 'time_varying'])
def test_a_run_replayed_is_the_same_to_the_bit(record, replay, experiment):
    bag = record(experiment, '-p', 'plant_simulator:duration:=0.5')
    for how in ('--controller', '--closed-loop'):
        status, said = replay(bag, how)
        assert status == 0, said
        assert ' 5001 compared, 0 differ' in said
        assert 'every message is the same, to the bit' in said


def test_another_gain_gives_the_difference_that_the_law_says(record, replay):
    bag = record('pd_only_upper')
    assert replay(bag, '--controller', '-p', 'K:=10.0')[0] == 0
    status, said = replay(bag, '--controller', '-p', 'K:=12')
    apart = 2.0 * np.abs(read_bag(bag).states['position'])
    assert status == 1, said
    assert 'with K = 12' in said
    assert f'RMS {np.sqrt(np.mean(apart**2)):.6g} N, peak {apart.max():.6g} N at 1.000' in said
    assert 'effort -6.0 was -5.0' in said


def test_an_impulse_that_is_no_longer_fired_is_named(record, replay):
    bag = record('underdamped')
    run = read_bag(bag)
    status, said = replay(bag, '--controller', '-p', 'impulses:=false')
    assert status == 1
    assert f'0 compared, 0 differ, {len(run.events)} only recorded' in said
    first = run.impulses[0]
    assert first['guard'] == 2
    assert 'velocity_zero at 1.000000000 s is only recorded' in said


def test_files_of_parameters_serve_as_well_and_what_they_do_not_name_has_its_default(
    record, replay, graph
):
    bag = record('underdamped')
    assert replay(bag, '--controller', '--params', CONFIG / 'underdamped.yaml')[0] == 0
    status, said = replay(bag, '--controller', '--params', CONFIG / 'pd_only_lower.yaml')
    assert status == 1
    assert 'with impulses = False' in said
    second = graph.folder / 'second.yaml'
    second.write_text('/**/controller:\n  ros__parameters: {impulses: true}\n')
    files = ('--params', CONFIG / 'pd_only_lower.yaml', '--params', second)
    status, said = replay(bag, '--controller', *files)
    assert (status, 'impulses = ' in said) == (0, False), said


def test_a_tuned_run_with_another_controller_in_it_is_replayed_to_the_bit(graph, client, replay):
    bag, config = graph.folder / 'bag', CONFIG / 'time_varying.yaml'
    commands = client.listen('/joint_commands', JointState)
    plant = graph.start(
        'plant_simulator', '--ros-args', '--params-file', config, '-p', 'real_time_factor:=0.05'
    )
    controller = graph.start('controller', config=config)
    client.spin_until(lambda: client.node.count_publishers('/joint_states'), 'the plant')
    recorder = graph.start('recorder', '--ros-args', '--params-file', config, '-p', f'bag:={bag}')
    go_on(client, commands)
    for node, values in (
        ('controller', {'K': 12.0, 'D': 0.7}),
        ('plant_simulator', {'F_c': 0.3}),
        ('controller', {'x_r': 0.2}),
        ('plant_simulator', {'m': 0.12}),
        ('controller', {'alpha_ratio': 0.7, 'effort_limit': 300.0}),
        ('plant_simulator', {'x_0': 0.4, 'damping.upper': 1.0}),
    ):
        assert client.set(node, **values).successful
    assert client.call('/plant_simulator/reset', Trigger, once=True).success
    go_on(client, commands)  # so that all of it acts
    controller.kill()
    first = author_of(commands[-1])
    controller = graph.start(
        'controller', '--ros-args', '--params-file', config, '-p', 'd_bar:=1.25'
    )
    client.spin_until(lambda: author_of(commands[-1]) != first, 'the other controller')
    go_on(client, commands)
    assert client.set('controller', x_r=-0.1).successful
    assert client.set('plant_simulator', F_c=1.5, real_time_factor=0.0).successful
    assert plant.wait() == 0, plant.output
    assert controller.interrupt() == 0  # it waits until all has arrived
    assert recorder.interrupt() == 0
    run = read_bag(bag)
    assert {name for change in run.changes for name in change.changed} == {
        'K',
        'D',
        'F_c',
        'x_r',
        'm',
        'alpha_ratio',
        'effort_limit',
        'x_0',
        'damping.upper',
        'real_time_factor',
    }
    assert sum(run.states['is_reset']) == 2
    assert len({change.node_id for change in run.controllers}) == 2
    for how in ('--controller', '--closed-loop'):
        status, said = replay(bag, how)
        assert status == 0, said
        assert ' 20001 compared, 0 differ' in said or run.recording_summary['missing'] != '0'


def go_on(client, commands):
    """Wait until the run has made some samples."""
    client.spin_until(lambda: commands, 'commands')
    until = stamp_of(commands[-1]) + 10 * STEP
    client.spin_until(lambda: stamp_of(commands[-1]) > until, 'samples')


def author_of(command):
    return parse_command(command.header.frame_id).author


def rewritten(bag, folder, change=lambda topic, number, raw: raw):
    """Return a copy of a bag in which ``change`` has had its way with each message."""
    writer = BagWriter(folder)
    kinds = {f'/{name}': kind for name, kind in {**SERIES, 'damping': FLOAT64}.items()}
    channels, counts, entries = {}, {}, []
    for item in columns(bag / f'{bag.name}_0.mcap'):
        if isinstance(item, Column):
            for at, size, stamp in zip(item.start, item.size, item.stamp, strict=True):
                if item.topic not in channels:
                    channels[item.topic] = writer.add_topic(
                        Topic(name=item.topic, type=kinds[item.topic], qos=(QOS,))
                    )
                counts[item.topic] = number = counts.get(item.topic, -1) + 1
                raw = change(item.topic, number, item.content[at : at + size].tobytes())
                entries.append((int(stamp), channels[item.topic], raw))
        elif hasattr(item, 'metadata') and hasattr(item, 'name') and item.name != 'rosbag2':
            writer.add_metadata(item.name, item.metadata)
    writer.write(sorted(entries, key=lambda entry: entry[0]))
    writer.close()
    return folder


def test_a_bag_that_tells_no_parameters_is_answered_by_those_of_a_file(tmp_path, capsys):
    bag = simulated(tmp_path / 'run', 'underdamped', 0.1)[0]
    other = encode_parameter_event(1, 0, 'run:ffffffff /other', {'m': 1.0}, {})
    bare = rewritten(
        bag,
        tmp_path / 'bare',
        lambda topic, number, raw: other if topic == '/run_parameters' else raw,
    )
    assert status_of('replay', bare, '--controller') == 2
    assert 'replay --controller --params FILE takes them from a file' in capsys.readouterr().err
    assert status_of('replay', bare, '--controller', '-p', 'K:=3') == 2
    capsys.readouterr()
    file = CONFIG / 'underdamped.yaml'
    assert status_of('replay', bare, '--controller', '--params', file) == 0
    said = capsys.readouterr().out
    assert ' 1001 compared, 0 differ' in said
    assert status_of('replay', bare, '--controller', '--params', file, '-p', 'K:=3') == 1
    assert 'it differs' in capsys.readouterr().out


@pytest.mark.parametrize('topic', ['joint_states', 'joint_commands', 'impulse_events', 'damping'])
def test_one_flipped_bit_of_a_message_is_found(record, replay, tmp_path, topic):
    bag = record('time_varying', '-p', 'plant_simulator:duration:=0.2')
    assert replay(rewritten(bag, tmp_path / 'same'), '--closed-loop')[0] == 0

    def flip(name, number, raw):
        # the lowest bit of the last double
        at = len(raw) - 8
        return (
            raw
            if (name, number) != (f'/{topic}', 1)
            else (raw[:at] + bytes([raw[at] ^ 1]) + raw[at + 1 :])
        )

    status, said = replay(rewritten(bag, tmp_path / 'other', flip), '--closed-loop')
    assert status == 1, said
    assert f'first in {topic} at' in said


def test_what_cannot_be_run_again_is_refused_in_one_line(graph, record, replay, tmp_path):
    bag = record('underdamped', '-p', 'plant_simulator:duration:=0.05')
    free = record(
        'axis',
        '-p',
        'plant_simulator:duration:=0.05',
        '-p',
        'plant_simulator:lockstep:=false',
        '-p',
        'plant_simulator:real_time_factor:=0.1',
    )
    bare = BagWriter(tmp_path / 'bare')
    bare.write([])
    bare.close()
    for arguments, said in (
        ((bag, '--controller', '-p', 'K:=-1'), 'K = -1.0: must be > 0'),
        ((bag, '--controller', '-p', 'k:=1'), 'there is no such parameter'),
        ((bag, '--controller', '-p', 'K'), '-p K: must be [NODE:]NAME:=VALUE'),
        ((bag, '--controller', '-p', 'F_c:=1'), '-p F_c:=1: there is no such parameter of'),
        ((bag, '--controller', '-p', 'recorder:bag:=a'), '/recorder matches none of /controller'),
        ((bag, '--controller', '-p', 'K:=['), '-p K:=[: must be [NODE:]NAME:=VALUE'),
        ((bag, '--controller', '-p', 'time_step:=0.001'), 'time_step = 0.001'),
        ((bag, '--controller', '--params', 'nowhere.yaml'), 'nowhere.yaml'),
        ((free, '--closed-loop'), 'lockstep: false'),
        ((tmp_path / 'bare', '--closed-loop'), 'no node of it has the parameters of a plant'),
        ((tmp_path / 'nowhere', '--closed-loop'), 'nowhere'),
        ((tmp_path / 'nowhere',), 'nowhere'),
        ((bag, '--topics', 'elbow'), "topic = 'elbow'"),
        ((bag, '--rate', '0'), 'rate = 0.0'),
        ((bag, '--start-offset', '9'), '[0, 0.05]'),
    ):
        status, output = replay(*arguments)
        assert status == 2, output
        assert said in output
        assert len(output.splitlines()) == 1, output
    assert replay(free, '--controller')[0] == 0


@pytest.mark.parametrize('what', BAD)
def test_a_bad_bag_is_refused_in_one_line(tmp_path, capsys, what):
    bag, bad = simulated(tmp_path / 'run', 'underdamped', 0.01)[0], tmp_path / 'bad'
    BAD[what][0](bad, bag)
    for how in ('--controller', '--closed-loop'):
        assert status_of('replay', bad, how) == 2
        said = capsys.readouterr()
        assert said.out == ''
        line = said.err.splitlines()[-1]
        assert line.startswith('replay: ')
        assert str(bad) in line


def test_a_bag_that_was_cut_off_is_replayed_up_to_there_with_a_warning(tmp_path, capsys):
    bag = simulated(tmp_path / 'run', 'time_varying', 1.0)[0]
    data = (bag / 'run_0.mcap').read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[: len(data) * 2 // 3])
    for how in ('--controller', '--closed-loop'):
        assert status_of('replay', cut, how) == 0
        said = capsys.readouterr()
        assert f'{cut} was cut off: ' in said.err
        count = int(said.out.split(f'{cut}: ')[1].split()[0])
        assert 2000 < count < 10_001
        assert f'joint_commands  {count:>9} compared, 0 differ' in said.out


@pytest.mark.parametrize(
    'other', [['--rate', '2'], ['--loop'], ['--start-offset', '0'], ['--ros-args', '-p', 'K:=3']]
)
def test_what_is_for_playing_is_refused_where_nothing_is_played(tmp_path, capsys, other):
    for how in ('--controller', '--closed-loop'):
        assert status_of('replay', tmp_path, how, *other) == 2
        assert 'are not for --controller' in capsys.readouterr().err


def test_a_bag_lacks_no_command_unsaid_but_that_of_the_state_it_ends_with(tmp_path, capsys):
    bag, last = simulated(tmp_path / 'run', 'underdamped', 0.1)[0], 1000
    for number, expected in ((last, 0), (last - 1, 1)):

        def cut_short(topic, at, raw, gone=('/joint_commands', number)):
            return raw[:8] if (topic, at) == gone else raw

        without = rewritten(bag, tmp_path / f'without_{number}', cut_short)
        for how in ('--controller', '--closed-loop'):
            assert status_of('replay', without, how) == expected
            said = capsys.readouterr().out
            assert '1 only replayed' in said
            assert ('every message is the same, to the bit' in said) == (expected == 0)


def test_a_bag_without_commands_is_no_bag_that_is_the_same(tmp_path, capsys):
    bag = simulated(tmp_path / 'run', 'underdamped', 0.1)[0]
    without = rewritten(
        bag,
        tmp_path / 'without',
        lambda topic, number, raw: (
            raw if topic in ('/joint_states', '/run_parameters') else raw[:8]
        ),
    )
    assert status_of('replay', without, '--controller') == 2
    assert 'no command in it answers one of its states' in capsys.readouterr().err
    foreign = of_a_robot(tmp_path / 'robot', [0.5] * 20)
    file = CONFIG / 'underdamped.yaml'
    assert status_of('replay', foreign, '--controller', '--params', file) == 2
    assert 'no command in it answers one of its states' in capsys.readouterr().err


@pytest.mark.parametrize('value', [np.nan, -np.inf, 1e308])
def test_efforts_near_overflow_differ_and_are_checked_without_a_warning(tmp_path, capsys, value):
    made = experiment('underdamped')
    run = simulate(made.plant, made.gains, 0.01)
    run.effort[5] = value
    writer = begun(tmp_path / 'bag', made)
    writer.write(entries(run))
    bag = finished(writer)
    for how in ('--controller', '--closed-loop'):
        assert status_of('replay', bag, how) == 1
        said = capsys.readouterr().out
        if np.isfinite(value):
            assert 'peak 1e+308 N at 1.000500000 s' in said
        else:
            assert ', 1 that are not finite left out' in said
    assert status_of('analyze', bag, '--check') == 1


def foreign(path, channels):
    """
    Write an MCAP file of (topic, type, encoding, QoS, messages) by channel, in that order.

    A message is (log time [ns], bytes). A type of '' is no schema.
    """
    with path.open('wb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        for topic, kind, encoding, qos, messages in channels:
            schema = writer.register_schema(kind, 'ros2msg', b'') if kind else 0
            metadata = {'offered_qos_profiles': qos}
            channel = writer.register_channel(topic, encoding, schema, metadata)
            for time, raw in messages:
                writer.add_message(channel, time, raw, time)
        writer.finish()
    return path


ONCE = [(10**9, encode_float64(1.0))]
LEFT_OUT = {
    '/unknown': (
        ('strange_msgs/msg/Strange', 'cdr'),
        "'strange_msgs/msg/Strange' is not installed",
    ),
    '/call/_service_event': (('strange/srv/Call_Event', 'cdr'), 'is not installed'),
    '/go/_action/feedback': (('strange/action/Go_FeedbackMessage', 'cdr'), 'is not installed'),
    '/other': (('std_msgs/msg/Float64_Event', 'cdr'), 'is not installed'),
    '/bare': (('', 'cdr'), 'its channel has no schema'),
    '/text': (('std_msgs/msg/Float64', 'json'), 'its messages are json, not cdr'),
    '/no name': (('std_msgs/msg/Float64', 'cdr'), 'Invalid topic name'),
}


def test_what_cannot_be_played_is_left_out_with_its_reason(replay, tmp_path):
    bag = foreign(
        tmp_path / 'bag.mcap',
        [
            *((name, *kind, '', ONCE) for name, (kind, _) in LEFT_OUT.items()),
            # an event that is installed, QoS that is no YAML, too large a message
            ('/switch/_service_event', 'std_srvs/srv/SetBool_Event', 'cdr', '', ONCE),
            ('good', 'std_msgs/msg/Float64', 'cdr', '{[', ONCE),
            ('/large', 'std_msgs/msg/Float64', 'cdr', '', [(10**9, bytes(10**6))]),
        ],
    )
    status, said = replay(bag)
    lines = said.splitlines()
    assert status == 0, said
    for name, (_, reason) in LEFT_OUT.items():
        assert [line for line in lines if f'{name} is left out: ' in line and reason in line], name
    assert 'good: its offered_qos_profiles cannot be read: reliable and volatile are' in said
    assert '/large: a message of 1000000 bytes is left out' in said
    assert '2 messages published, 1 left out' in said
    status, said = replay(bag, '--topics', 'unknown', 'bare')
    assert (status, len(said.splitlines())) == (2, 1), said
    assert 'no topic can be published: /unknown: message type' in said
    assert '; /bare: its channel has no schema' in said


@pytest.mark.parametrize('strange', [0, 2**63 - 1, 2**64 - 1])
def test_messages_with_a_log_time_far_from_all_others_are_left_out(replay, tmp_path, strange):
    now = 1_790_000_000 * 10**9
    times = [now, strange, now + 10**6, now + 10**9]
    bag = foreign(
        tmp_path / 'bag.mcap',
        [('a', 'std_msgs/msg/Float64', 'cdr', '', [(time, ONCE[0][1]) for time in times])],
    )
    bag.write_bytes(bag.read_bytes()[:-8])
    status, said = replay(bag, '--topics', '/a', '--rate', '1e300')
    assert status == 0, said
    assert f'{bag}: it was cut off; 0 bytes at its end cannot be read' in said
    assert '1 messages are left out: their log time' in said
    assert '3 messages published' in said


def test_a_played_bag_reaches_its_subscribers_whole_with_a_clock(graph, client, record):
    # fewer messages than the subscribers' queues hold
    bag = record('underdamped', '-p', 'plant_simulator:duration:=0.05')
    states = client.listen('/joint_states', JointState)
    commands = client.listen('/moved/commands', JointState)
    clock = client.listen('/clock', Clock)
    player = graph.start(
        'replay',
        bag,
        '--start-paused',
        '--rate',
        '0.02',
        '--ros-args',
        '-r',
        '/joint_commands:=/moved/commands',
    )
    client.spin_until(
        lambda: client.call('/replay/pause', SetBool, data=True).message.endswith(
            'at 1.000000000 s, subscribers: 2'
        ),
        'the subscribers',
    )
    assert client.call('/replay/pause', SetBool, data=False).success
    client.spin_until(lambda: states, 'states')
    assert client.call('/replay/pause', SetBool, data=True).success
    assert client.set('replay', rate=0.1).successful
    assert client.get('replay', 'rate') == [0.1]
    assert client.call('/replay/pause', SetBool, data=False).success
    client.spin_until(lambda: len(states) == len(commands) == 501, 'all messages')
    assert player.wait() == 0, player.output
    run = read_bag(bag)
    told = len(run.history)  # plant and controller, once each
    assert f'{2 * 501 + len(run.events) + told} messages published' in player.output
    assert [state.position[0] for state in states] == run.states['position'].tolist()
    assert [command.effort[0] for command in commands] == run.commands['effort'].tolist()
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clock]
    assert times == sorted(times)
    assert 1_000_000_000 <= times[0] < times[-1] <= 1_100_000_000
