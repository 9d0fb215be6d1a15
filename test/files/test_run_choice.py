"""Bags with more than one run, author or plant in them, and what one lacks."""

from dataclasses import replace

import numpy as np
import pytest

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import BagError
from impulse_control_ros.files.cdr import encode_float64, JointStateLayout
from impulse_control_ros.files.recording import read_bag
from test.files.test_bag import RUN, START, STEP
from test.tools.bags import (
    all_told,
    begun,
    COMMANDS,
    CONTROLLER,
    entries,
    event_count,
    EVENTS,
    experiment,
    finished,
    PARAMETERS,
    PLANT,
    recorded_elsewhere,
    sent,
    STATES,
    told,
    TOPICS,
    TYPES,
    WALL,
)

OTHER_RUN, OTHER = '89abcdef', '/other#0000'
LATER = WALL + 10**12


@pytest.fixture(scope='module')
def made():
    return experiment('underdamped')


@pytest.fixture(scope='module')
def short(made):
    return simulate(made.plant, made.gains, 0.02)


@pytest.fixture(scope='module')
def long(made):
    start = replace(made.plant, x_0=0.4)
    return simulate(start, made.gains, 0.03)


def is_of(recording, run):
    for ours, theirs in (
        (recording.states['position'], run.position),
        (recording.states['velocity'], run.velocity),
        (recording.commands['effort'], run.effort),
        (recording.impulses['area'], run.events['area']),
    ):
        assert ours.tobytes() == theirs.tobytes()
    return True


# -- runs -------------------------------------------------------------------------------------


@pytest.fixture
def restarted(tmp_path, made, short, long):
    """Return a bag of two runs: stamps begin at 1 s again."""
    runs = ((short, RUN, WALL), (long, OTHER_RUN, LATER))
    return recorded_elsewhere(
        tmp_path / 'bag',
        (
            message
            for run, name, start in runs
            for message in sent([*all_told(made, name), *entries(run, run=name)], start)
        ),
    )


def test_the_last_of_several_runs_is_read_and_the_others_are_counted(restarted, short, long):
    recording = read_bag(restarted)
    assert (recording.run, is_of(recording, long)) == (OTHER_RUN, True)
    assert recording.lacks == [f'run {RUN} is left out ({2 * 201 + event_count(short)} messages)']
    assert recording.states['is_reset'].tolist() == [True] + [False] * 300


def test_a_run_is_read_by_its_name_or_number(restarted, short):
    for name in (RUN, '1', 1):
        recording = read_bag(restarted, name)
        assert (recording.run, is_of(recording, short)) == (RUN, True)
    with pytest.raises(BagError, match=f'run none is not in it; its runs: {RUN}, {OTHER_RUN}'):
        read_bag(restarted, 'none')


def test_damping_is_that_of_the_run(tmp_path):
    made = experiment('time_varying')
    runs = [simulate(made.plant, made.gains, seconds) for seconds in (0.02, 0.03)]
    bag = recorded_elsewhere(
        tmp_path / 'bag',
        (
            message
            for run, name, start in zip(runs, (RUN, OTHER_RUN), (WALL, LATER), strict=True)
            for message in sent(entries(run, run=name), start)
        ),
    )
    for run, name in zip(runs, (RUN, OTHER_RUN), strict=True):
        damping = read_bag(bag, name).damping
        ticks = (damping['stamp'] - START) // STEP
        assert ticks.tolist() == list(range(10, len(run.time), 10))
        assert (damping['damping'] == run.damping[ticks - 1]).all()


@pytest.mark.parametrize('other', [OTHER_RUN, ''], ids=['another plant', 'a foreign plant'])
def test_a_second_plant_on_the_topic_is_left_out(tmp_path, made, short, long, other):
    writer = begun(tmp_path / 'bag', made)
    writer.write(sorted([*entries(short), *entries(long, run=other)], key=lambda one: one[0]))
    recording = read_bag(finished(writer))
    assert (recording.run, is_of(recording, short)) == (RUN, True)
    count = 2 * 301 + event_count(long) if other else 301
    name = f'run {other}' if other else 'a foreign plant'
    assert recording.lacks == [f'{name} is left out ({count} messages)']


def state(k, position=0.5, run='', episode=0, controller=''):
    layout = JointStateLayout('axis', f'run:{run}.{episode} {controller}'.strip() if run else '')
    return START + k * STEP, STATES, layout.encode(1, k * STEP, position, 0.0, 0.0)


def moved(tmp_path, *runs, clock=None, every=1000):
    """
    Return a bag of a foreign plant, of (first tick, count, position) for each run.

    The time of each message is that of the wall, or of a ``clock`` that tells it from the tick.
    """
    layout = JointStateLayout('axis')
    ticks = [(first + k, x) for first, count, x in runs for k in range(count)]
    return recorded_elsewhere(
        tmp_path / 'bag',
        (
            (
                clock(k) if clock else WALL + at * every,
                '/joint_states',
                TYPES[STATES],
                layout.encode(1, k * STEP, x, 0.0, 0.0),
            )
            for at, (k, x) in enumerate(ticks)
        ),
    )


@pytest.mark.parametrize('clock', [None, lambda k: START + k * STEP, lambda k: START])
@pytest.mark.parametrize('counts', [(60, 80), (80, 60), (80, 3)])
@pytest.mark.parametrize('first', [0, 1000, 1003])
def test_a_foreign_plant_whose_time_goes_back_has_two_runs_the_last_is_read(
    tmp_path, clock, counts, first
):
    bag = moved(tmp_path, (1000, counts[0], 0.0), (first, counts[1], 1.0), clock=clock)
    for name, number in (('', 2), ('1', 1), ('2', 2)):
        recording = read_bag(bag, name)
        assert recording.states['position'].tolist() == [number - 1.0] * counts[number - 1]
        assert (np.diff(recording.states['stamp']) == STEP).all()
        assert recording.lacks == [
            f'time goes back: run {3 - number} of 2, which --run {3 - number} reads, is left out '
            f'({counts[2 - number]} messages)',
            'there are no commands',
        ]
    with pytest.raises(BagError, match='run 3 is not in it; its runs: 1, 2'):
        read_bag(bag, '3')


def test_states_that_come_late_are_no_other_run(tmp_path):
    bag = moved(tmp_path, (0, 50, 0.0), (59, 21, 0.0), (50, 9, 0.0), (80, 20, 0.0), (99, 1, 7.0))
    recording = read_bag(bag)
    assert (np.diff(recording.states['stamp']) == STEP).all()
    assert recording.lacks == [
        'what repeats a stamp with other values is left out (1 messages)',
        'there are no commands',
    ]


def test_stamps_of_zero_are_said_and_the_time_of_recording_serves_as_well(tmp_path):
    layout = JointStateLayout('axis')
    bag = recorded_elsewhere(
        tmp_path / 'bag',
        (
            (
                WALL + k * STEP,
                f'/{name}',
                TYPES[STATES],
                layout.encode(0, 0, k, 0, 5),
            )
            for k in range(50)
            for name in ('joint_states', 'joint_commands')
        ),
    )
    with pytest.raises(BagError, match='the stamps of its states are 0: --time log takes'):
        read_bag(bag)
    recording = read_bag(bag, log_time=True)
    assert recording.states['stamp'].tolist() == [WALL + k * STEP for k in range(50)]
    assert recording.effort.tolist() == [5.0] * 50
    assert recording.lacks == ['the parameters of the controller are missing']


# -- systems ----------------------------------------------------------------------------------


def two_systems(tmp_path, *messages):
    left, right = ([state(k, position) for k in range(50)] for position in (0.0, 1.0))
    return recorded_elsewhere(
        tmp_path / 'bag',
        sorted(
            [
                *sent(left, namespace='/left'),
                *sent(right, WALL + 3, namespace='/right'),
                *messages,
            ]
        ),
    )


def test_two_systems_are_told_apart_by_their_namespace_or_topic_alone(tmp_path):
    bag = two_systems(tmp_path)
    with pytest.raises(
        BagError,
        match="states of joint 'axis' are on /left/joint_states, /right/joint_states: "
        'choose one with --namespace /left or --topic /left/joint_states',
    ):
        read_bag(bag)
    for name, position in (('left', 0.0), ('right', 1.0)):
        for choice in (
            {'namespace': name},
            {'namespace': f'/{name}/'},
            {'topics': [f'{name}/joint_states']},
        ):
            assert read_bag(bag, **choice).states['position'].tolist() == [position] * 50
    for choice, why in (
        ({'namespace': 'up'}, 'no topic in the namespace /up; its topics: /left/joint_states, '),
        ({'topics': ['up']}, 'topic /up is not in the bag; its topics: /left/joint_states, '),
        ({'namespace': 'left', 'joint': 'elbow'}, "no joint_states of joint 'elbow'"),
    ):
        with pytest.raises(BagError, match=why):
            read_bag(bag, **choice)


@pytest.mark.parametrize('name', ['joint_commands', 'impulse_events', 'damping'])
def test_what_answers_is_that_of_the_namespace_or_the_only_one_or_refused(tmp_path, name):
    number = next(number for number, one in TOPICS.items() if one == f'/{name}')
    raw = encode_float64(2.0) if name == 'damping' else event(9, 2.0)[2]
    messages = [
        (WALL + 9001, f'{namespace}{name}', TYPES[number], raw) for namespace in ('/a/', '/b/')
    ]
    bag = two_systems(tmp_path, *messages)
    with pytest.raises(BagError, match=f'{name} are on /a/{name}, /b/{name}: choose one with'):
        read_bag(bag, namespace='left')
    assert read_bag(bag, namespace='left', topics=[f'/b/{name}']).states['position'][0] == 0.0


def test_a_topic_of_another_name_is_read_where_it_is_given(tmp_path):
    messages = ((WALL + at, '/measured', TYPES[STATES], state(at)[2]) for at in range(20))
    bag = recorded_elsewhere(tmp_path / 'bag', messages)
    with pytest.raises(BagError, match='no joint_states'):
        read_bag(bag)
    assert len(read_bag(bag, topics=['/measured']).states) == 20


def test_the_only_joint_is_taken_and_one_of_several_is_to_be_chosen(tmp_path):
    def of(*joints):
        layout = JointStateLayout(joints[0], 'base', joints=joints)
        return recorded_elsewhere(
            tmp_path / '_'.join(joints),
            sent((0, STATES, layout.encode(1, k, 0.5, 0, 0)) for k in range(1, 9)),
        )

    assert len(read_bag(of('lift')).states) == 8
    assert read_bag(of('grip', 'axis')).states['position'].tolist() == [0.0] * 8
    bag = of('lift', 'grip')
    with pytest.raises(BagError, match='its joints are grip, lift: choose one with --joint'):
        read_bag(bag)
    assert read_bag(bag, joint='lift').states['position'].tolist() == [0.5] * 8


# -- controllers ------------------------------------------------------------------------------


def command(k, effort, author=CONTROLLER, guard='', run=RUN):
    frame_id = f'run:{run}.0 {author} {guard}'.strip() if run else guard
    layout = JointStateLayout('axis', frame_id, ('effort',))
    return START + k * STEP, COMMANDS, layout.encode(1, k * STEP, effort)


def event(k, area, author=CONTROLLER, guard='sticking'):
    layout = JointStateLayout('axis', f'run:{RUN}.0 {author} {guard}')
    return START + k * STEP, EVENTS, layout.encode(1, k * STEP, 0.5, 0.0, area)


@pytest.mark.parametrize('turned', [False, True])
def test_of_two_commands_the_one_counts_whose_author_the_next_state_names(tmp_path, turned):
    rivals = [
        [event(0, 2.0, OTHER), command(0, 2.0, OTHER, 'sticking')],
        [event(0, 1.0), command(0, 1.0, guard='sticking')],
    ]
    messages = [
        state(0, run=RUN),
        *sum(rivals[::-1] if turned else rivals, []),
        state(1, run=RUN, controller=CONTROLLER),
        command(1, 3.0, OTHER),
        command(1, 4.0),
        event(1, 3.0, OTHER),
    ]
    recording = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages)))
    # behind the last state nothing tells but that itself
    assert recording.commands['effort'].tolist() == [1.0, 4.0]
    assert recording.impulses['area'].tolist() == [1.0]


@pytest.mark.parametrize('turned', [False, True])
def test_of_two_commands_the_first_counts_where_no_state_tells(tmp_path, turned):
    rivals = [command(0, 1.0), command(0, 2.0, OTHER)]
    recording = read_bag(
        recorded_elsewhere(
            tmp_path / 'bag', sent([state(0, run=RUN), *(rivals[::-1] if turned else rivals)])
        )
    )
    assert recording.commands['effort'].tolist() == [2.0 if turned else 1.0]


def test_the_commands_of_a_foreign_controller_count_while_the_states_say_so(tmp_path):
    messages = [
        state(0, run=RUN),
        command(0, 1.0, run=''),
        state(1, run=RUN, controller='-'),
        command(1, 2.0, run=''),
        command(1, 9.0),
        state(2, run=RUN, controller='-'),
        state(3, run=RUN, controller=CONTROLLER),
        command(2, 3.0),
        command(2, 9.0, run=''),
        command(3, 9.0, run=''),
        command(3, 4.0),
    ]
    recording = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages)))
    assert recording.commands['effort'].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert 'the parameters of a foreign controller are missing' in recording.lacks


def test_a_controller_that_tells_its_parameters_and_stands_by_has_none_in_the_run(
    tmp_path, made, short
):
    other = replace(made.gains, K=99.0)
    messages = [
        *all_told(made),
        told(OTHER, other.flat()),
        *entries(short),
        told(OTHER, other.flat(), ['K'], 100),
    ]
    recording = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages)))
    assert [change.node for change in recording.history] == [PLANT, '/controller']
    assert recording.lacks == []


def test_parameters_of_other_nodes_stay_readable(tmp_path):
    messages = [told(PLANT, {'mass': 1.0}), told(CONTROLLER, {'gain': 3}), state(0, run=RUN)]
    recording = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages)))
    assert recording.parameters == {PLANT: {'mass': 1.0}, '/controller': {'gain': 3}}


# -- resets and changes -----------------------------------------------------------------------


def test_a_reset_is_another_episode(tmp_path):
    messages = [told(PLANT, {'m': 1.0}), *(state(k, run=RUN, episode=k // 4) for k in range(12))]
    states = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages))).states
    assert np.flatnonzero(states['is_reset']).tolist() == [0, 4, 8]


@pytest.mark.parametrize(
    ('k', 'episode', 'controller', 'is_reset'),
    [(0, 0, '', True), (0, 0, CONTROLLER, False), (0, 1, '', False)],
)
def test_without_parameters_the_first_state_tells_whether_the_run_begins_with_it(
    tmp_path, k, episode, controller, is_reset
):
    bag = recorded_elsewhere(
        tmp_path / 'bag', sent([state(k, run=RUN, episode=episode, controller=controller)])
    )
    assert read_bag(bag).states['is_reset'].tolist() == [is_reset]


def test_a_change_before_the_first_state_belongs_to_the_start(tmp_path):
    values = {'K': 1.0, 'D': 2.0}
    messages = [
        told(CONTROLLER, values),
        told(CONTROLLER, {**values, 'K': 2.0}, ['K'], 5),
        told(CONTROLLER, {**values, 'K': 3.0}, ['K'], 8),
        *(state(k, run=RUN, controller=CONTROLLER) for k in range(7, 12)),
    ]
    recording = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages)))
    assert recording.parameters == {'/controller': {'K': 2.0, 'D': 2.0}}
    (change,) = recording.changes
    assert (change.stamp, change.changed) == (START + 8 * STEP, {'K': 3.0})


def test_who_begins_to_act_in_mid_run_is_a_change(tmp_path):
    values = {'K': 1.0}
    messages = [
        told(CONTROLLER, values),
        told(OTHER, values, tick=2),
        *(state(k, run=RUN, controller=CONTROLLER) for k in range(4)),
        *(command(k, 0.0, CONTROLLER if k < 2 else OTHER) for k in range(4)),
    ]
    recording = read_bag(recorded_elsewhere(tmp_path / 'bag', sent(messages)))
    assert recording.parameters == {'/controller': values, '/other': values}
    assert [(change.stamp, change.node, change.anew) for change in recording.changes] == [
        (START + 2 * STEP, '/other', True)
    ]


# -- what a bag lacks -------------------------------------------------------------------------


def without(messages, *unwanted):
    """Return messages without some, by topic and their number on it."""
    counts = dict.fromkeys(range(6), 0)
    for message in messages:
        place = message[1], counts[message[1]]
        counts[message[1]] += 1
        if place not in unwanted:
            yield message


@pytest.mark.parametrize(
    ('unwanted', 'lacks'),
    [
        ([], []),
        ([(STATES, 50), (STATES, 51), (STATES, 70)], ['3 states are missing']),
        ([(COMMANDS, 3), (COMMANDS, 199)], ['2 states have no command']),
        ([(COMMANDS, 200)], []),  # the run ended before
        ([(STATES, 200), (COMMANDS, 200)], []),
        ([(EVENTS, 0)], ['1 commands name a guard or a verdict whose event is missing']),
        ([(PARAMETERS, 0)], ['the parameters of the plant are missing']),
        ([(PARAMETERS, 1)], [f'the parameters of {CONTROLLER} are missing']),
        (
            [(PARAMETERS, 0), (PARAMETERS, 1)],
            [
                'the parameters of the plant are missing',
                f'the parameters of {CONTROLLER} are missing',
            ],
        ),
        (
            [(STATES, 0), (STATES, 1)],
            [
                'the bag begins in mid-run, at 1.000200000 s; the controller may already have '
                'been '
                'active'
            ],
        ),
        ([(COMMANDS, k) for k in range(201)], ['there are no commands']),
    ],
)
@pytest.mark.parametrize('ours', [False, True])
def test_what_a_bag_lacks_is_said_whoever_recorded_it(
    tmp_path, made, short, ours, unwanted, lacks
):
    assert len(short.events)
    if ours:
        writer = begun(tmp_path / 'bag', made, told_by=without(all_told(made), *unwanted))
        writer.write(without(entries(short), *unwanted))
        bag = finished(writer)
    else:
        bag = recorded_elsewhere(
            tmp_path / 'bag', sent(without([*all_told(made), *entries(short)], *unwanted))
        )
    assert read_bag(bag).lacks == lacks


def test_a_free_run_need_not_answer_every_state(tmp_path, made, short):
    free = replace(made, plant=replace(made.plant, lockstep=False, real_time_factor=1.0))
    bag = recorded_elsewhere(
        tmp_path / 'bag', sent([*all_told(free), *without(entries(short), (COMMANDS, 3))])
    )
    assert read_bag(bag).lacks == []


def test_the_first_commands_of_a_free_run_are_missed(tmp_path, made, short):
    free = replace(made, plant=replace(made.plant, lockstep=False, real_time_factor=1.0))
    bag = recorded_elsewhere(
        tmp_path / 'bag',
        sent([*all_told(free), *without(entries(short), (COMMANDS, 0), (COMMANDS, 1))]),
    )
    assert read_bag(bag).lacks == [
        'the first commands of /controller are missing; it started at 1.000000000 s'
    ]
