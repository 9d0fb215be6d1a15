"""``simulate``: the bag of an experiment, against messages that are encoded one by one."""

import fcntl
import json
import math
import os
import pty
import struct
import subprocess
import sys
import termios

from mcap.reader import make_reader
import pytest
from rosbags.rosbag2 import Reader
import yaml

from impulse_control_ros import __version__
from impulse_control_ros.core import closed_loop
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.tick import stamp
from impulse_control_ros.errors import DivergedError
from impulse_control_ros.files.bag import PACKAGE
from impulse_control_ros.files.cdr import encode_float64, JointStateLayout
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from test.conftest import BIN, CONFIG, Process, wait_for

STATES, EVENTS, COMMANDS, PARAMETERS, DAMPING = (
    '/joint_states',
    '/impulse_events',
    '/joint_commands',
    '/run_parameters',
    '/damping',
)
STEP = 100_000


@pytest.fixture
def start(tmp_path):
    started = []

    def run(*arguments):
        command = [str(BIN / 'simulate'), *map(str, arguments)]
        started.append(Process('simulate', command, tmp_path / f'{len(started)}.log', {}))
        return started[-1]

    yield run
    for process in started:
        process.kill()


def file_in(bag):
    return bag / f'{bag.name}_0.mcap'


def messages_of(bag):
    """Return (topic, log time, publish time, bytes) in the order of the file, and its metadata."""
    with file_in(bag).open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]
        return found, {record.name: record.metadata for record in reader.iter_metadata()}


def author_in(found):
    """Return the id that the controller has drawn."""
    raw = next(raw for topic, *_, raw in found if topic == COMMANDS)
    return raw[16:].split(b'\0')[0].decode().split(' ')[1]


def encoded(made, run, author, duration):
    """Yield (topic, stamp [ns], bytes) of an experiment, message by message."""
    plant, controller = made.plant, made.gains
    start_ns = round((plant.start_time or 1.0) * 1e9)
    first = stamp(0, start_ns, STEP)
    for node, values in (
        ('/plant_simulator', {**plant.flat(), 'wait_for_recorder': True}),
        (author, controller.flat()),
    ):
        yield PARAMETERS, start_ns, encode_parameter_event(*first, f'run:{run} {node}', values, {})
    simulated = simulate(plant, controller, duration)
    fired = {int(event['tick']): event for event in simulated.events}
    judged = {int(one['tick']): one for one in simulated.verdicts}
    joint, prefix = plant.joint_name, f'run:{run}.0'
    for k in range(len(simulated.time)):
        at, ns = stamp(k, start_ns, STEP), start_ns + k * STEP
        position, velocity = simulated.measured_position[k], simulated.measured_velocity[k]
        applied = simulated.applied[k - 1] if k else 0.0
        frame_id = f'{prefix} {author}' if k else prefix
        if math.isnan(velocity):
            yield (
                STATES,
                ns,
                JointStateLayout(joint, frame_id, ('position', 'effort')).encode(
                    *at, position, applied
                ),
            )
        else:
            yield (
                STATES,
                ns,
                JointStateLayout(joint, frame_id).encode(*at, position, velocity, applied),
            )
        frame_id = f'{prefix} {author}'
        event, verdict = fired.get(k), judged.get(k)
        if event is not None or verdict is not None:
            frame_id += ' -' if event is None else f' {GUARDS[event["guard"]]}'
            frame_id += '' if verdict is None else f' {VERDICTS[verdict["verdict"]]}'
            one, area = (verdict, 0.0) if event is None else (event, event['area'])
            layout = JointStateLayout(joint, frame_id)
            yield EVENTS, ns, layout.encode(*at, one['position'], one['velocity'], area)
        yield (
            COMMANDS,
            ns,
            JointStateLayout(joint, frame_id, ('effort',)).encode(*at, simulated.effort[k]),
        )
        if plant.damping.kind != 'constant' and k and k % 10 == 0:
            yield DAMPING, ns, encode_float64(simulated.damping[k - 1])


@pytest.mark.parametrize(
    ('name', 'rules', 'duration'),
    [
        ('underdamped', [], 1.5),
        ('coulomb', [], 1.2),
        ('time_varying', [], 1.2),
        ('encoder', [], 1.2),
        ('encoder', ['sensor.velocity:=difference', 'actuator.delay:=3'], 1.1),
        ('encoder', ['sensor.velocity:=none', 'velocity_deadband:=0.1', 'F_c:=0.0'], 1.1),
        (
            'underdamped',
            ['start_time:=1234.5', 'joint_name:=wheel', 'damping.kind:=sinusoidal'],
            0.02,
        ),
    ],
)
def test_every_message_is_the_one_that_is_encoded_alone(tmp_path, start, name, rules, duration):
    config, bag, rules = (
        CONFIG / f'{name}.yaml',
        tmp_path / 'run',
        [*rules, f'duration:={duration}'],
    )
    assert start(config, bag, *(item for rule in rules for item in ('-p', rule))).wait() == 0
    made = load_experiment(config, rules=rules)
    found, metadata = messages_of(bag)
    author, run = author_in(found), metadata[PACKAGE]['run']
    expected = list(encoded(made, run, author, duration))
    assert [(topic, raw) for topic, _, _, raw in found] == [
        (topic, raw) for topic, _, raw in expected
    ]
    for time in (1, 2):
        assert [one[time] for one in found] == [ns for _, ns, _ in expected]
    assert {topic for topic, *_ in found} >= {STATES, EVENTS, COMMANDS, PARAMETERS}


@pytest.fixture(scope='module')
def varying(tmp_path_factory):
    bag = tmp_path_factory.mktemp('bags') / 'varying'
    said = subprocess.run(
        [BIN / 'simulate', CONFIG / 'time_varying.yaml', bag],
        check=True,
        capture_output=True,
        text=True,
    )
    assert said.stderr == ''
    assert said.stdout.startswith(f'{bag}: 42024 messages, 2 s simulated in ')
    return bag


def test_a_bag_says_what_one_of_the_recorder_says(varying):
    found, metadata = messages_of(varying)
    run = metadata[PACKAGE].pop('run')
    assert author_in(found).startswith('/controller#')
    assert metadata[PACKAGE] == {
        'version': __version__,
        'joint_states': STATES,
        'impulse_events': EVENTS,
        'joint_commands': COMMANDS,
        'run_parameters': PARAMETERS,
    }
    wall = metadata['recording'].pop('wall_seconds')
    assert float(wall) > 0.0
    assert metadata['recording'] == {
        'messages': str(len(found)),
        'missing': '0',
        'repeated': '0',
        'foreign': '0',
    }
    recording = read_bag(varying)
    assert recording.run == run
    assert len(recording.states) == len(recording.commands) == 20_001
    assert set(recording.parameters) == {'/plant_simulator', '/controller'}


def test_another_reader_finds_topics_qualities_of_service_and_messages(varying):
    with Reader(varying) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        durable = {
            connection.topic: connection.ext.offered_qos_profiles[0].durability.name
            for connection in reader.connections
        }
        stamps = [stamp for _, stamp, _ in reader.messages()]
    assert counts == {STATES: 20_001, EVENTS: 20, COMMANDS: 20_001, PARAMETERS: 2, DAMPING: 2000}
    assert stamps == sorted(stamps)
    assert {topic for topic, kind in durable.items() if kind == 'TRANSIENT_LOCAL'} == {PARAMETERS}


def test_a_run_replays_to_the_same_bits(varying):
    said = subprocess.run(
        [BIN / 'replay', '--closed-loop', varying], check=True, capture_output=True, text=True
    )
    assert 'every message is the same, to the bit' in said.stdout


def test_later_files_and_then_the_command_line_count(tmp_path, start):
    (tmp_path / 'one.yaml').write_text(
        '/**/controller:\n  ros__parameters: {K: 11.0, D: 0.6}\n'
        'plant_simulator:\n  ros__parameters: {duration: 5, F_c: 0.1, x_0: 0.2}\n'
    )
    (tmp_path / 'two.yaml').write_text(
        '/**/controller:\n  ros__parameters: {D: 7e-1, c: 1.0}\n'
        '/**:\n  plant_simulator:\n    ros__parameters: {x_0: 0.4}\n'
    )
    bag = tmp_path / 'run'
    assert (
        start(
            tmp_path / 'one.yaml',
            '-p',
            'duration:=0.01',
            tmp_path / 'two.yaml',
            bag,
            '-p',
            'controller:c:=2.0',
            '-p',
            'recorder:topics:=[]',
        ).wait()
        == 0
    )
    values = read_bag(bag).parameters
    controller, plant = values['/controller'], values['/plant_simulator']
    assert (controller['K'], controller['D'], controller['c']) == (11.0, 0.7, 2.0)
    assert (plant['x_0'], plant['F_c'], plant['duration']) == (0.4, 0.1, 0.01)
    assert len(read_bag(bag).states) == 101
    topics = yaml.safe_load((bag / 'metadata.yaml').read_text())['rosbag2_bagfile_information'][
        'topics_with_message_count'
    ]
    assert [one['topic_metadata']['name'] for one in topics] == [
        STATES,
        EVENTS,
        COMMANDS,
        PARAMETERS,
    ]


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (
            ['axis.yaml', 'run'],
            'invalid plant_simulator.duration = 0.0: must be > 0 [s], e.g. '
            'with -p plant_simulator:duration:=2.0',
        ),
        (['axis.yaml', 'run', '-p', 'lockstep:=false'], 'lockstep = False'),
        (
            ['underdamped.yaml', 'run', '-p', 'F_c:=-1'],
            'simulate: -p F_c:=-1: invalid F_c = -1.0: must be >= 0 [N]',
        ),
        (
            ['underdamped.yaml', 'run', '-p', 'plant_simulator:K:=1.0'],
            '-p plant_simulator:K:=1.0: invalid K = 1.0: there is no such parameter',
        ),
        (
            ['underdamped.yaml', 'run', '-p', 'F_x:=1'],
            '-p F_x:=1: invalid F_x = 1: there is no such',
        ),
        (['underdamped.yaml', 'run', '-p', 'plant:F_c:=1'], "node 'plant'"),
        (['underdamped.yaml', 'run', '-p', 'F_c=1'], '-p F_c=1: must be [NODE:]NAME:=VALUE'),
        (['underdamped.yaml', 'run', '-p', 'topics:=['], '-p topics:=['),
        (
            ['underdamped.yaml', 'run', '-p', 'controller:time_step:=2e-4'],
            'controller: invalid time_step = 0.0002',
        ),
        (['none.yaml', 'run'], 'none.yaml: [Errno 2] No such file'),
        (['underdamped.yaml'], 'the following arguments are required: BAG'),
    ],
)
def test_what_cannot_be_simulated_is_refused_in_one_line(tmp_path, arguments, said):
    result = subprocess.run(
        [BIN / 'simulate', *(CONFIG / one if one.endswith('.yaml') else one for one in arguments)],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert (result.returncode, result.stdout) == (2, '')
    assert result.stderr.startswith('simulate: ')
    assert said in result.stderr
    assert result.stderr.count('\n') == 1
    assert not list(tmp_path.iterdir())


def test_a_folder_that_exists_is_refused_and_left_alone(tmp_path, start):
    (tmp_path / 'run').mkdir()
    process = start(CONFIG / 'underdamped.yaml', tmp_path / 'run')
    assert process.wait() == 2
    assert process.output == f"simulate: bag '{tmp_path / 'run'}' exists; name a new folder\n"
    assert not list((tmp_path / 'run').iterdir())


def test_a_loop_that_diverges_ends_with_the_samples_before(tmp_path, start):
    bag = tmp_path / 'run'
    process = start(CONFIG / 'underdamped.yaml', bag, '-p', 'D:=2500.0', '-p', 'impulses:=false')
    assert process.wait() == 1
    assert process.output.startswith('simulate: the loop has diverged: at 1.')
    assert process.output.count('\n') == 1
    recording, seconds = read_bag(bag), float(process.output.split(' at ')[1].split(' ')[0])
    assert len(recording.states) == len(recording.commands) > 100
    assert abs(recording.states['position'][-1]) < 1e100 > abs(recording.states['velocity'][-1])
    assert recording.states['stamp'][-1] + STEP == round(seconds * 1e9)
    assert recording.recording_summary['messages'] == str(2 + 2 * len(recording.states))


def test_ctrl_c_leaves_a_finished_bag_with_all_up_to_then(tmp_path, start):
    bag = tmp_path / 'run'
    process = start(CONFIG / 'underdamped.yaml', bag, '-p', 'duration:=100000.0')
    wait_for(lambda: file_in(bag).exists() and file_in(bag).stat().st_size > 2**20, 'a chunk')
    assert process.interrupt() == 1
    recording = read_bag(bag)
    assert recording.unread is None
    assert len(recording.states) == len(recording.commands) > closed_loop.BLOCK
    last = (recording.states['stamp'][-1] - recording.states['stamp'][0]) / 1e9
    assert process.output == (
        f'simulate: interrupted at {last:g} s; the bag is finished with its '
        f'first {recording.recording_summary["messages"]} messages\n'
    )


def test_a_full_disk_ends_the_run_with_what_fits(tmp_path, start):
    bag = tmp_path / 'run'
    process = start(CONFIG / 'underdamped.yaml', bag, '-p', 'duration:=100000.0')
    process.limit_files(2**20)
    assert process.wait() == 1
    assert process.output.startswith(f'simulate: {bag}: File too large; the bag is finished with ')
    assert len(read_bag(bag).states) > 1000


def test_no_ros_is_imported(tmp_path):
    code = (
        'import json, sys\n'
        'from impulse_control_ros.command_line import StopRequest\n'
        'from impulse_control_ros.tools.simulate import main\n'
        'assert main(StopRequest()) == 0\n'
        'print(json.dumps(list(sys.modules)))'
    )
    said = subprocess.run(
        [sys.executable, '-c', code, CONFIG / 'time_varying.yaml', tmp_path / 'run'],
        check=True,
        capture_output=True,
        text=True,
    )
    loaded = {name.split('.')[0] for name in json.loads(said.stdout.splitlines()[-1])}
    assert 'impulse_control_ros' in loaded
    assert not [
        name
        for name in loaded
        if name in ('rclpy', 'rpyutils', 'rosidl_runtime_py')
        or name.endswith(('_msgs', '_interfaces', '_srvs'))
    ]


def test_progress_is_drawn_on_a_terminal(tmp_path):
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack('4H', 24, 80, 0, 0))
    process = subprocess.Popen(
        [BIN / 'simulate', CONFIG / 'underdamped.yaml', tmp_path / 'run', '-p', 'duration:=3.0'],
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    )
    assert process.wait(60) == 0
    drawn = os.read(ours, 2**16).decode()
    os.close(theirs)
    os.close(ours)
    assert '/3.00 s simulated' in drawn


def samples_of(sizes, plant, controller, count):
    for states, _ in closed_loop.blocks_of(plant, controller, count, 10**9):
        sizes.append(len(states))


@pytest.mark.parametrize('size', [1, 7, 100, 10_000])
def test_a_loop_diverges_at_the_same_sample_whatever_the_blocks(monkeypatch, size):
    made = load_experiment(CONFIG / 'underdamped.yaml', rules=['D:=2500.0', 'impulses:=false'])
    plant, controller = made.plant, made.gains
    with pytest.raises(DivergedError) as expected:
        simulate(plant, controller, 2.0)
    monkeypatch.setattr(closed_loop, 'BLOCK', size)
    sizes = []
    with pytest.raises(DivergedError) as found:
        samples_of(sizes, plant, controller, 20_001)
    first = float(str(expected.value).split(' at ')[1].split(' ')[0])
    assert sum(sizes) == round(first / 1e-4)
    assert str(found.value) == str(expected.value).replace(f'{first:g} s', f'{1.0 + first:.9f} s')
