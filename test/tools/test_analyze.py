"""The table of ``analyze``, and what it refuses."""

from contextlib import redirect_stderr, redirect_stdout
import csv
from dataclasses import replace
from io import StringIO
import json
import re
import signal
import struct
import subprocess

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.metric_catalogue import METRICS
from impulse_control_ros.core.metrics import COUNTS, figures, work
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.bag import BagWriter
from impulse_control_ros.files.cdr import (
    encode_float64,
    FIELDS,
    JointStateLayout,
    LITTLE_ENDIAN_CDR,
    string,
)
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.tools.analyze.command import NAME
from test.command_lines import status_of
from test.conftest import BIN, CONFIG, wait_for
from test.files.test_bag import START, STATE, topic
from test.tools.bags import (
    all_told,
    begun,
    CONTROLLER,
    entries,
    experiment,
    finished,
    PARAMETERS,
    recorded,
    recorded_elsewhere,
    sent,
    STATES,
    told,
)


def analyzed(capsys, *arguments):
    """Return exit status, stdout and the lines of stderr."""
    code = status_of('analyze', *arguments)
    said = capsys.readouterr()
    return code, said.out, said.err.splitlines()


def responses(capsys, *arguments):
    """Return what JSON says."""
    code, out, err = analyzed(capsys, *arguments, '--format', 'json')
    assert code == 0, err
    return json.loads(out)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp('bags') / 'run', 'underdamped', 0.5)[0]


# -- supervision ------------------------------------------------------------------------------


def test_verdicts_the_learnt_mass_and_the_time_of_suspension_are_told(tmp_path, capsys):
    heavy, _ = recorded(tmp_path / 'heavy', 'underdamped', 0.5, {'m': 0.25})
    light, run = recorded(tmp_path / 'light', 'underdamped', 1.5, {'m': 0.048}, learn_mass=False)
    plain, _ = recorded(tmp_path / 'plain', 'underdamped', 0.5, supervision=False)
    learnt, wrong, none = responses(capsys, heavy, light, plain)
    assert learnt['confirmed'] == learnt['impulses'] > 5
    assert learnt['learnt_mass'] == pytest.approx(0.25, rel=0.01)
    assert (learnt['learnt_delay'], learnt['suspended_time']) == (0.0, 0.0)
    assert wrong['out_of_band'] == np.count_nonzero(run.verdicts['verdict'] == 3) > 2
    assert wrong['learnt_mass'] == pytest.approx(0.048, rel=0.01)
    assert 1.0 < wrong['suspended_time'] < 1.5
    assert [none[name] for name in ('confirmed', 'learnt_mass', 'suspended_time')] == [
        0,
        None,
        None,
    ]
    _, out, _ = analyzed(capsys, light)
    assert re.search(r'verdicts out of band +[3-9]\n', out)


# -- figures ----------------------------------------------------------------------------------


@pytest.mark.parametrize('name', ['underdamped', 'pd_only_lower', 'time_varying', 'coulomb'])
def test_the_figures_of_a_bag_are_those_of_its_simulation(tmp_path, capsys, name):
    path, run = recorded(tmp_path / name, name, 1.3)
    (got,) = responses(capsys, path)
    error = run.position - experiment(name).gains.x_r
    expected = figures(run.time, error, run.velocity, run.effort, run.events, (1e-2, 1e-3))[0]
    for key, value in zip(
        ('settling_time_0.01', 'settling_time_0.001'), expected['settling_time'], strict=True
    ):
        assert got[key] == (None if np.isnan(value) else pytest.approx(value, rel=1e-12))
    for key in (
        'overshoot',
        'iae',
        'ise',
        'final_error',
        'peak_velocity',
        'impulse_area',
        'peak_effort',
        *COUNTS,
    ):
        assert got[key] == pytest.approx(expected[key], rel=1e-9), key
    for guard in COUNTS:
        area = np.abs(run.events['area'][run.events['guard'] == GUARDS.index(guard)]).sum()
        assert got[f'{guard}_area'] == pytest.approx(area, rel=1e-12)
    assert (got['start'], got['end'], got['samples']) == (0.0, 1.3, 13_001)
    assert (got['impulses'], got['missing']) == (len(run.events), 0)


@pytest.mark.parametrize(
    ('name', 'axis'), [('underdamped', {}), ('time_varying', {}), ('coulomb', {'x_0': 0.4})]
)
def test_the_work_is_the_kinetic_energy_and_what_damping_and_friction_take(
    tmp_path, capsys, name, axis
):
    path, run = recorded(tmp_path / name, name, 0.5, axis)
    plant = experiment(name).plant
    (got,) = responses(capsys, path)
    middle = 0.5 * (run.velocity[1:] + run.velocity[:-1])
    taken = np.sum((run.damping * middle**2 + plant.F_c * np.abs(middle)) * plant.time_step)
    kinetic = 0.5 * plant.m * (run.velocity[-1] ** 2 - run.velocity[0] ** 2)
    assert got['work'] == pytest.approx(kinetic + taken, rel=2e-2)
    fired = run.events['tick']
    jumps = 0.5 * plant.m * np.sum(run.velocity[fired + 1] ** 2 - run.velocity[fired] ** 2)
    assert got['impulse_work'] == pytest.approx(jumps, rel=1e-1)


@pytest.mark.parametrize('limit', [0.0, 100.0, 20.0])
def test_impulses_are_told_from_the_feedback_whatever_the_effort_limit(tmp_path, capsys, limit):
    path, run = recorded(tmp_path / 'run', 'underdamped', 0.5, effort_limit=limit)
    (got,) = responses(capsys, path)
    assert got['peak_effort'] == np.abs(run.effort).max()
    assert got['peak_feedback'] == pytest.approx(5.0)
    gains = experiment('underdamped').gains
    feedback = np.clip(
        -gains.K * run.position - gains.D * run.velocity,
        *((-limit, limit) if limit else (-np.inf, np.inf)),
    )
    rest = run.effort - feedback
    assert got['impulse_work'] == pytest.approx(work(run.position, rest), rel=1e-9)


def test_pd_alone_sticks_where_friction_holds_it(tmp_path, capsys):
    path, run = recorded(tmp_path / 'run', 'coulomb', 1.0, impulses=False)
    (got,) = responses(capsys, path)
    stands = np.flatnonzero(run.velocity != 0.0)[-1] + 1
    assert got['stuck'] == 1
    assert got['stuck_time'] == pytest.approx(1.0 - run.time[stands])
    assert got['settling_time_0.01'] is None


# -- set-points -------------------------------------------------------------------------------


@pytest.fixture
def stepped(tmp_path):
    """Return a bag whose set-point goes from 0 to 0.2 m at 0.5 s, and the runs in it."""
    made = experiment('underdamped')
    first = simulate(made.plant, made.gains, 0.5)
    axis = replace(made.plant, x_0=float(first.position[-1]), v_0=float(first.velocity[-1]))
    gains = replace(made.gains, x_r=0.2)
    second = simulate(axis, gains, 0.7)
    writer = begun(tmp_path / 'stepped', made)
    writer.write(entry for entry in entries(first) if entry[0] < START + 500_000_000)
    writer.write([told(CONTROLLER, gains.flat(), tick=5000)])
    writer.write(entries(second, 5000))
    return finished(writer), first, second


def test_the_last_response_is_judged_from_its_set_point_change_on(stepped, capsys):
    path, _, second = stepped
    (got,) = responses(capsys, path)
    assert (got['bag'], got['start'], got['end']) == ('stepped', 0.5, 1.2)
    error = second.position - 0.2
    expected = figures(
        second.time, error, second.velocity, second.effort, second.events, (1e-2, 1e-3)
    )[0]
    assert got['settling_time_0.01'] == pytest.approx(expected['settling_time'][0])
    assert got['overshoot'] == expected['overshoot']
    assert got['iae'] == pytest.approx(expected['iae'], rel=1e-9)
    assert got['impulses'] == len(second.events)
    assert got['peak_feedback'] == pytest.approx(2.0, rel=1e-3)


def test_all_responses_of_a_bag_are_judged_one_by_one(stepped, capsys):
    path, first, second = stepped
    got = responses(capsys, path, '--all')
    assert [item['bag'] for item in got] == ['stepped:1', 'stepped:2']
    assert [item['impulses'] for item in got] == [
        np.count_nonzero(first.events['tick'] < 5000),
        len(second.events),
    ]
    assert got[0]['settling_time_0.01'] == pytest.approx(0.1186)
    assert [item['samples'] for item in got] == [5000, 7001]


def test_a_reset_begins_another_response(tmp_path, capsys):
    made = experiment('underdamped')
    run = simulate(made.plant, made.gains, 0.3)
    writer = begun(tmp_path / 'run', made)
    writer.write(entries(run))
    writer.write(entries(run, 3001, episode=1))
    finished(writer)
    one, two = responses(capsys, tmp_path / 'run', '--all')
    assert two['start'] == pytest.approx(0.3001)
    for name in ('settling_time_0.001', 'work', 'impulses', 'overshoot', 'samples'):
        assert one[name] == pytest.approx(two[name]), name


def test_missing_samples_are_counted_and_do_not_shift_the_time(tmp_path, capsys):
    made = experiment('pd_only_lower')
    run = simulate(made.plant, made.gains, 2.0)
    writer = begun(tmp_path / 'run', made)
    lost = {START + k * 100_000 for k in range(700, 800)}
    writer.write(entry for entry in entries(run) if entry[0] not in lost)
    code, out, err = analyzed(capsys, finished(writer), '--format', 'json')
    assert (code, err) == (
        0,
        [f'analyze: warning: {tmp_path}/run: incomplete: 100 states are missing'],
    )
    (got,) = json.loads(out)
    assert got['missing'] == 100
    assert got['settling_time_0.01'] == pytest.approx(1.1145)
    assert got['iae'] == pytest.approx(0.11116, rel=1e-3)


# -- formats ----------------------------------------------------------------------------------


def test_the_formats_hold_the_same_figures(bag, capsys):
    code, text, err = analyzed(capsys, bag)
    assert (code, err) == (0, [])
    (exact,) = responses(capsys, bag)
    rows = list(csv.DictReader(analyzed(capsys, bag, '--format', 'csv')[1].splitlines()))
    assert len(rows) == 1
    assert list(rows[0]) == list(exact) == ['bag', 'path', *METRICS]
    for name, value in exact.items():
        assert rows[0][name] == ('' if value is None else str(value))
    lines = text.splitlines()
    assert lines[0].split() == ['run']
    assert len(lines) == 1 + len(METRICS)
    assert 'settling time to 0.01 m [s]' in text
    assert float(lines[3].split()[-1]) == pytest.approx(exact['settling_time_0.01'], rel=1e-4)


def test_what_never_settles_is_never_and_null_and_empty(tmp_path, capsys):
    path, _ = recorded(tmp_path / 'run', 'pd_only_lower', 0.1)
    assert 'never' in analyzed(capsys, path)[1]
    assert responses(capsys, path)[0]['settling_time_0.01'] is None
    (row,) = csv.DictReader(analyzed(capsys, path, '--format', 'csv')[1].splitlines())
    assert row['settling_time_0.01'] == ''


def test_bags_of_one_name_are_told_apart(tmp_path, capsys):
    paths = [recorded(tmp_path / name / 'run', 'underdamped', 0.01)[0] for name in 'ab']
    assert [item['bag'] for item in responses(capsys, *paths)] == [str(path) for path in paths]


def test_help_says_what_is_measured_from_where():
    said = subprocess.run([BIN / NAME, '--help'], check=True, capture_output=True, text=True)
    for words in ('--report', '--figure', 'last change of the set-point', 'v = 0'):
        assert words in said.stdout


@pytest.mark.parametrize(('suffix', 'magic'), [('png', b'\x89PNG'), ('pdf', b'%PDF')])
def test_a_figure_is_drawn_the_same_again(tmp_path, capsys, bag, suffix, magic):
    other, _ = recorded(tmp_path / 'other', 'time_varying', 0.3)
    path = tmp_path / f'figure.{suffix}'
    drawn = []
    for _ in range(2):
        code, _, err = analyzed(capsys, bag, other, '--figure', path)
        assert (code, err) == (0, [f'analyze: wrote {path}'])
        drawn.append(path.read_bytes())
    assert drawn[0].startswith(magic)
    assert drawn[0] == drawn[1]


# -- bags that lack something -----------------------------------------------------------------


def of_a_robot(folder, *fields):
    """Return the bag of a driver that measures some of the `FIELDS`, in their order."""
    layout = JointStateLayout('axis', 'base', FIELDS[: len(fields)])
    return recorded_elsewhere(
        folder,
        sent(
            (START, STATES, layout.encode(1, k * 10**6, *values))
            for k, values in enumerate(zip(*fields, strict=True))
        ),
    )


def test_a_bag_without_velocities_is_drawn_without_them(tmp_path, capsys):
    bag = of_a_robot(tmp_path / 'bag', np.linspace(0.5, 0.0, 100))
    file = tmp_path / 'figure.png'
    code, out, err = analyzed(capsys, bag, '--figure', file)
    assert (code, err) == (
        0,
        [
            f'analyze: warning: {bag}: incomplete: there are no commands',
            f'analyze: warning: {bag}: no node tells its set-point x_r: 0 m is taken',
            f'analyze: wrote {file}',
        ],
    )
    (got,) = responses(capsys, bag)
    empty = {name for name, value in got.items() if value is None}
    assert empty == {
        *('peak_velocity', 'peak_effort', 'peak_feedback', 'work', 'stuck', 'stuck_time'),
        *UNSUPERVISED,
    }
    for name in empty:
        assert f'\n{METRICS[name].label}'.ljust(47) + '\n' in out


def test_without_commands_the_response_begins_with_the_first_effort(tmp_path, capsys):
    position, effort = np.full(100, 0.5), np.repeat([0.0, -1.0], 50)
    position[50:] = np.linspace(0.5, 0.0, 50)
    (got,) = responses(capsys, of_a_robot(tmp_path / 'bag', position, np.zeros(100), effort))
    assert (got['start'], got['end']) == (pytest.approx(0.049), pytest.approx(0.099))


UNSUPERVISED = ('learnt_mass', 'learnt_delay', 'suspended_time')
UNKNOWN = {
    'position': (),
    'velocity': ('peak_velocity', 'stuck', 'stuck_time'),
    'effort': ('peak_feedback', 'peak_effort', 'work'),
}


@pytest.mark.parametrize('value', [np.nan, np.inf])
@pytest.mark.parametrize('field', FIELDS)
def test_a_metric_that_cannot_be_computed_is_empty_in_each_format(tmp_path, capsys, field, value):
    fields = {
        'position': np.linspace(0.5, 0.0, 100),
        'velocity': np.full(100, -1.0),
        'effort': np.ones(100),
    }
    fields[field][[20, 50]] = value
    bag = of_a_robot(tmp_path / 'bag', *fields.values())
    is_left_out = field == 'position' or (field == 'velocity' and not np.isnan(value))
    empty = {*UNSUPERVISED, *(() if is_left_out else UNKNOWN[field])}
    code, text, _ = analyzed(capsys, bag, '--format', 'json')
    (got,) = json.loads(text, parse_constant=lambda name: pytest.fail(f'{name} is no JSON'))
    assert code == 0
    assert (got['samples'], got['settling_time_0.001']) == (98 if is_left_out else 100, 0.099)
    (row,) = csv.DictReader(analyzed(capsys, bag, '--format', 'csv')[1].splitlines())
    lines = dict(zip(METRICS, analyzed(capsys, bag)[1].splitlines()[1:], strict=True))
    assert {name for name, value in got.items() if value is None} == empty
    assert {name for name, value in row.items() if not value} == empty
    assert {name for name, line in lines.items() if line.endswith(' ')} == empty


def test_a_figure_and_a_page_leave_out_what_no_axis_can_show(tmp_path, capsys):
    fields = np.linspace(0.5, 0.0, 100), np.full(100, -1.0), np.ones(100)
    for at, value in enumerate((np.nan, np.inf, 1.7e308)):
        for field in fields:
            field[10 * at + 20] = value
    bag = of_a_robot(tmp_path / 'bag', *fields)
    files = tmp_path / 'figure.png', tmp_path / 'page.html'
    code, _, err = analyzed(capsys, bag, '--figure', files[0], '--report', files[1])
    assert (code, err[-2:]) == (0, [f'analyze: wrote {file}' for file in files[::-1]])


@pytest.mark.parametrize('value', [np.nan, np.inf])
def test_states_without_a_position_are_left_out_with_a_warning(tmp_path, capsys, value):
    moves = 0.5 * np.exp(-np.arange(600) / 50) * np.cos(np.arange(600) / 20)
    bags = [
        of_a_robot(tmp_path / name, positions)
        for name, positions in (
            ('whole', moves[5:]),
            ('bag', np.where(np.arange(600) < 5, value, moves)),
        )
    ]
    expected, got = responses(capsys, *bags)
    for name in ('overshoot', 'iae', 'settling_time_0.01', 'samples'):
        assert got[name] == pytest.approx(expected[name])
    assert (
        f'analyze: warning: {bags[1]}: 5 states are left out: their position is not finite, or '
        'position or velocity is beyond 1e+100'
    ) in analyzed(capsys, bags[1])[2]


def test_states_that_cannot_be_read_are_left_out_with_the_reason(tmp_path, capsys):
    states = [STATE.encode(1, k, 0.5, 0.0, 0.0) for k in range(8)]
    states[2:4] = joint_state(2, 1), joint_state(2, 1)
    states[5] = b'\0\0' + states[5][2:]
    bag = recorded_elsewhere(tmp_path / 'bag', sent((0, STATES, raw) for raw in states))
    code, _, err = analyzed(capsys, bag)
    assert code == 0
    for reason in (
        '2 messages on /joint_states are left out: position has 1 values for 2 joints',
        '1 messages on /joint_states are left out: they are big-endian CDR',
    ):
        assert reason in err[0]
    assert responses(capsys, bag)[0]['samples'] == 5


def test_a_bag_that_begins_in_mid_run_says_so(tmp_path, capsys):
    made = experiment('underdamped')
    run = simulate(made.plant, made.gains, 0.3)
    writer = begun(tmp_path / 'bag', made)
    writer.write(entry for entry in entries(run) if entry[0] >= START + 10**8)
    code, _, err = analyzed(capsys, finished(writer))
    assert (code, err) == (
        0,
        [
            f'analyze: warning: {tmp_path}/bag: incomplete: the bag begins in mid-run, at '
            '1.100000000 s; the controller may already have been active',
            f'analyze: warning: {tmp_path}/bag: settling times count from the first state, '
            'although the run began before',
        ],
    )


def moving_robot(folder):
    """Return a bag that begins while a robot moves; its set-point changes after 0.2 s."""
    layout, values = JointStateLayout('axis', 'base'), {'x_r': 0.1}
    messages = [
        (START, STATES, layout.encode(1, k * 10**6, 0.5 - 0.001 * k, -1.0 * (k < 300), 0.0))
        for k in range(400)
    ]
    for at, changed in ((200, {'x_r': 0.2}), (0, {})):
        raw = encode_parameter_event(1, at * 10**6, '/law', values | changed, changed)
        messages.insert(at, (START, PARAMETERS, raw))
    return recorded_elsewhere(folder, sent(messages))


def test_a_response_of_a_bag_that_begins_in_mid_run_is_chosen_by_its_number(tmp_path, capsys):
    bag = moving_robot(tmp_path / 'bag')
    every = responses(capsys, bag, '--all')
    assert [one['samples'] for one in every] == [200, 200]
    assert responses(capsys, bag) == [{**every[1], 'bag': 'bag'}]
    for number in (1, 2):
        (got,) = responses(capsys, bag, '--set-point-change', number)
        assert got == every[number - 1]
        _, _, err = analyzed(capsys, bag, '--set-point-change', number)
        assert 'at 1.000000000 s; the axis is already moving' in err[0]
        assert err[-1].endswith('--set-point-change selects another response') == (number == 1)
    for number in (0, 3):
        code, _, err = analyzed(capsys, bag, '--set-point-change', number)
        assert code == 2
        assert err[-1].endswith(
            f'--set-point-change {number}: must be in [1, 2], the responses that --all shows'
        )


def test_a_set_point_that_is_given_counts_in_place_of_what_the_bag_tells(tmp_path, capsys):
    bag = moving_robot(tmp_path / 'bag')
    for x_r in (0.2, -0.5):
        (got,) = responses(capsys, bag, '--set-point', x_r)
        assert got['samples'] == 400
        assert got['final_error'] == pytest.approx(0.101 - x_r)
    bag = of_a_robot(tmp_path / 'robot', np.linspace(0.5, 0.0, 100))
    (got,) = responses(capsys, bag, '--set-point', 0.1)
    assert got['final_error'] == pytest.approx(-0.1)
    assert 'x_r' not in '\n'.join(analyzed(capsys, bag, '--set-point', 0.1)[2])


def test_a_run_of_several_is_analysed_by_its_name(tmp_path, capsys):
    made = experiment('underdamped')
    runs = {
        name: simulate(made.plant, made.gains, seconds)
        for name, seconds in (('0123abcd', 0.02), ('89abcdef', 0.03))
    }
    bag = recorded_elsewhere(
        tmp_path / 'bag',
        (
            message
            for number, (name, run) in enumerate(runs.items())
            for message in sent(
                [*all_told(made, name), *entries(run, run=name)], (number + 1) * 10**15
            )
        ),
    )
    assert responses(capsys, bag)[0]['samples'] == 301
    assert responses(capsys, bag, '--run', '0123abcd')[0]['samples'] == 201
    code, out, err = analyzed(capsys, bag, '--run', 'x')
    assert (code, out) == (2, '')
    assert err[0].endswith('run x is not in it; its runs: 0123abcd, 89abcdef')


# -- bad bags ---------------------------------------------------------------------------------


def empty_folder(path, bag):
    path.mkdir()


def content(data):
    return lambda path, bag: path.write_bytes(data)


def whole(bag):
    return bytearray(next(bag.glob('*.mcap')).read_bytes())


def flipped(path, bag):
    data = whole(bag)
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)


def cut_before_a_chunk(path, bag):
    data = whole(bag)
    path.write_bytes(data[: data.index(b'/impulse_events') + 50])


def with_topic(name, kind, raw):
    def make(path, bag):
        writer = BagWriter(path)
        writer.write([(START, writer.add_topic(topic(name, kind)), raw)])
        writer.close()

    return make


def one_state(path, bag):
    with_topic('/joint_states', 'sensor_msgs/msg/JointState', STATE.encode(1, 0, 0, 0, 0))(
        path, bag
    )


def other_joints(path, bag):
    raw = JointStateLayout('elbow', joints=('elbow', 'wrist')).encode(1, 0, 0, 0, 0)
    with_topic('/joint_states', 'sensor_msgs/msg/JointState', raw)(path, bag)


def of_states(raw):
    return with_topic('/joint_states', 'sensor_msgs/msg/JointState', raw)


def joint_state(joints, positions):
    """Return a JointState with that many joints and positions."""
    data = LITTLE_ENDIAN_CDR + struct.pack('<III', 1, 0, 1) + bytes(4)
    data += struct.pack('<I', joints) + b''.join(string('j00') for _ in range(joints))
    return data + struct.pack('<I', positions) + bytes(4 + 8 * positions + 8)


def without_messages(path, bag):
    BagWriter(path).close()


BAD = {
    'no such path': (lambda path, bag: None, 'does not exist'),
    'empty folder': (empty_folder, 'has no .mcap or .db3 file'),
    'empty file': (content(b''), 'no MCAP file'),
    'another kind of file': (content(b'SQLite format 3\0' * 100), 'file is not a database'),
    'flipped byte': (flipped, 'damaged'),
    'truncated in its head': (cut_before_a_chunk, 'there are 0 states'),
    'no messages': (without_messages, 'there are 0 states'),
    'one state': (one_state, 'there are 1 states'),
    'no topics of ours': (
        with_topic('/odom', 'std_msgs/msg/Float64', encode_float64(1.0)),
        'no joint_states .* /odom \\(std_msgs/msg/Float64\\)',
    ),
    'our topic of another type': (
        with_topic('/joint_states', 'std_msgs/msg/Float64', encode_float64(1.0)),
        'no joint_states .* /joint_states \\(std_msgs/msg/Float64\\)',
    ),
    'other joints': (other_joints, 'its joints are elbow, wrist: choose one with --joint'),
    'fewer positions than names': (
        of_states(joint_state(2, 1)),
        '/joint_states cannot be read: position has 1 values for 2 joints',
    ),
    'more positions than names': (
        of_states(joint_state(1, 3)),
        '/joint_states cannot be read: position has 3 values for 1 joints',
    ),
    'no names': (of_states(joint_state(0, 0)), 'cannot be read: they name no joint'),
    'no positions': (
        of_states(JointStateLayout('axis', '', ('velocity',)).encode(1, 0, 0.0)),
        'cannot be read: position is empty',
    ),
    'big-endian': (of_states(b'\0\0' + STATE.encode(1, 0, 0, 0, 0)[2:]), 'big-endian CDR'),
    'another encoding': (of_states(b'{"name": []}'), 'begin with 7b226e61, which is no plain CDR'),
    'cut off states': (of_states(STATE.encode(1, 0, 0, 0, 0)[:-4]), 'cut off'),
    'empty states': (of_states(b''), 'begin with nothing'),
}


@pytest.mark.parametrize('what', BAD)
def test_a_bad_bag_is_refused_in_one_line_and_nothing_is_written(tmp_path, capsys, bag, what):
    make, why = BAD[what]
    path = tmp_path / 'bad'
    make(path, bag)
    before = {item: item.stat().st_mtime_ns for item in tmp_path.rglob('*')}
    code, out, err = analyzed(
        capsys, bag, path, '--report', tmp_path / 'r.html', '--figure', tmp_path / 'f.png'
    )
    assert (code, out) == (2, '')
    line = err[-1]
    assert line.startswith('analyze: ')
    assert str(path) in line
    assert re.search(why, line)
    assert [item for item in err[:-1] if not item.startswith('analyze: warning: ')] == []
    assert before == {item: item.stat().st_mtime_ns for item in tmp_path.rglob('*')}


@settings(max_examples=150, deadline=None)
@given(
    place=st.one_of(st.floats(0.0, 1.0, exclude_max=True), st.floats(0.97, 1.0, exclude_max=True)),
    bit=st.integers(0, 7),
)
def test_a_flipped_bit_anywhere_is_refused_or_changes_no_sample(tmp_path_factory, bag, place, bit):
    data = whole(bag)
    data[int(place * len(data))] ^= 1 << bit
    path = tmp_path_factory.mktemp('flip') / 'bad.mcap'
    path.write_bytes(data)
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = status_of('analyze', path)
    if code:
        assert (code, out.getvalue()) == (2, '')
        assert err.getvalue().splitlines()[-1].startswith(f'analyze: {path}')
    else:
        got, expected = read_bag(path), read_bag(bag)
        for series in ('states', 'commands', 'impulses', 'damping'):
            assert getattr(got, series).tobytes() == getattr(expected, series).tobytes()
        assert (got.parameters, got.changes) == (expected.parameters, expected.changes)


@pytest.mark.parametrize(
    ('arguments', 'why'),
    [
        ([], 'BAG'),
        (['{bag}', '--format', 'xml'], 'xml'),
        (['{bag}', '--set-point', 'nan'], '--set-point nan: must be finite'),
        (['{bag}', '--check', '--set-point', '1'], '--check: must stand without .*--set-point'),
        (['{bag}', '--all', '--set-point-change', '1'], 'must stand without --all'),
        (['{bag}', '--time', 'wall'], 'wall'),
        (['{bag}', '{bag}'], 'given twice'),
        (['{bag}', '--report', 'r.pdf'], r'r.pdf: .* \.html'),
        (['{bag}', '--figure', 'f.gif'], r'f.gif: .* \.pdf or \.png'),
        (['{bag}', '--report', '/nowhere/r.html'], 'folder does not exist'),
    ],
)
def test_a_bad_command_line_is_refused_in_one_line(capsys, bag, arguments, why):
    code, out, err = analyzed(capsys, *(item.format(bag=bag) for item in arguments))
    assert (code, out, len(err)) == (2, '', 1)
    assert err[0].startswith('analyze: ')
    assert re.search(why, err[0])


# -- cut off ----------------------------------------------------------------------------------


def test_a_cut_off_bag_is_analysed_up_to_its_last_whole_chunk(tmp_path, capsys):
    path, run = recorded(tmp_path / 'run', 'time_varying', 2.0)
    data = whole(path)
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(data[: len(data) * 2 // 3])
    code, out, err = analyzed(capsys, cut, '--format', 'json')
    (got,) = json.loads(out)
    count = got['samples']
    assert code == 0
    assert 4000 < count < 20_001
    (line,) = err
    assert line.startswith(
        f'analyze: warning: {cut} was cut off: {count} samples ({(count - 1) * 1e-4:g} s)'
    )
    unread = int(line.split('; ')[1].split()[0])
    # what is read of the file without these bytes is the same, and nothing is left over
    cut.write_bytes(cut.read_bytes()[:-unread])
    _, again, (line,) = analyzed(capsys, cut, '--format', 'json')
    assert again == out
    assert '; 0 bytes' in line
    assert got['peak_velocity'] == np.abs(run.velocity[:count]).max()


def test_the_bag_of_a_killed_recorder_is_analysed_with_a_warning(graph, capsys):
    bag = graph.folder / 'killed'
    process = graph.start(
        'closed_loop',
        '--ros-args',
        '-p',
        f'recorder:bag:={bag}',
        '-p',
        'plant_simulator:duration:=100.0',
        config=CONFIG / 'underdamped.yaml',
    )
    file = bag / 'killed_0.mcap'
    wait_for(lambda: file.exists() and file.stat().st_size > 100_000, 'some chunks in the bag')
    process.send(signal.SIGKILL)
    process.wait()
    code, out, err = analyzed(capsys, bag, '--format', 'json')
    assert code == 0
    assert 'was cut off' in err[0]
    (got,) = json.loads(out)
    assert got['samples'] > 2000
    assert got['missing'] == 0
