"""The join of a recording: order, completeness, and what is counted."""

from hypothesis import given, strategies as st
import pytest

from impulse_control_ros.core.protocol import (
    CommandHeader,
    NodeHeader,
    StateHeader,
    WINDOW,
)
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.cdr import COMMANDED, encode_float64, JointStateLayout
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.files.sample_joiner import (
    COMMANDS,
    EVENTS,
    PARAMETERS,
    RecordedPlant,
    SampleJoiner,
    STATES,
)

STEP, START = 100_000, SECOND
RUN, OTHER_RUN = '0123abcd', '89abcdef'
ME, RIVAL = '/controller#0001', '/other#0002'
DAMPING = 5
OURS = RecordedPlant(RUN, 'axis', STEP, lockstep=True)
FREE = RecordedPlant(RUN, 'axis', STEP, lockstep=False)
FOREIGN_PLANT = RecordedPlant('', 'axis', STEP, lockstep=False)


def stamp(tick):
    return divmod(START + tick * STEP, SECOND)


def state(tick, controller=ME, run=RUN, joint='axis', episode=0):
    header = StateHeader(run, episode, controller).frame_id
    return JointStateLayout(joint, header).encode(*stamp(tick), 0.5, 0.0, 0.0)


def command(tick, guard='', author=ME, run=RUN, effort=1.0, at=None, verdict=''):
    header = CommandHeader(run, 0, author, guard, verdict).frame_id
    return JointStateLayout('axis', header, COMMANDED).encode(*(at or stamp(tick)), effort)


def event(tick, author=ME, run=RUN):
    header = CommandHeader(run, 0, author, 'velocity_zero').frame_id
    return JointStateLayout('axis', header).encode(*stamp(tick), 0.0, 0.0, 9.0)


def fired(tick, author=ME):
    return command(tick, 'velocity_zero', author)


def parameters(tick, node=ME, changed=False):
    return encode_parameter_event(
        *stamp(tick), NodeHeader(RUN, node).frame_id, {'K': 1.0}, {'K': 1.0} if changed else {}
    )


def joined(arrivals, plant=OURS):
    """Return the entries of (channel, messages) in the order of arrival, and the joiner."""
    joiner, entries, now = SampleJoiner(plant), [], 0
    for channel, messages in arrivals:
        for raw in messages:
            now += 1
            joiner.add(channel, raw, now)
        entries += joiner.take() if joiner.begun else []
    return entries + joiner.take(everything=True), joiner


def channels(entries):
    return [channel for _, channel, _ in entries]


@given(st.data())
def test_any_order_of_arrival_gives_the_same_recording(data):
    count = data.draw(st.integers(1, 30))
    queues = {
        STATES: [state(k) for k in range(count)],
        COMMANDS: [command(k) if k % 3 else fired(k) for k in range(count)],
        EVENTS: [event(k) for k in range(0, count, 3)],
        PARAMETERS: [parameters(0), parameters(count // 2, changed=True)],
    }
    expected = [
        (START + k * STEP, channel, messages[at])
        for channel, messages in queues.items()
        if channel != PARAMETERS
        for at, k in enumerate(range(0, count, 3 if channel == EVENTS else 1))
    ]
    arrivals = [(PARAMETERS, queues.pop(PARAMETERS))]
    while any(queues.values()):
        channel = data.draw(st.sampled_from([i for i, waiting in queues.items() if waiting]))
        size = data.draw(st.integers(1, len(queues[channel])))
        arrivals.append((channel, [queues[channel].pop(0) for _ in range(size)]))
    entries, joiner = joined(arrivals)
    assert [one for one in entries if one[1] != PARAMETERS] == sorted(expected)
    assert channels(entries).count(PARAMETERS) == 2
    assert joiner.counts == {'states': count, 'missing': 0, 'repeated': 0, 'foreign': 0}


def test_the_event_of_a_verdict_alone_is_waited_for():
    judged = command(0, verdict='confirmed')
    header = CommandHeader(RUN, 0, ME, '', 'confirmed').frame_id
    told = JointStateLayout('axis', header).encode(*stamp(0), 0.0, 0.0, 0.0)
    arrivals = [(STATES, [state(0), state(1)]), (COMMANDS, [judged])]
    entries, joiner = joined([*arrivals, (EVENTS, [told]), (COMMANDS, [command(1)])])
    assert channels(entries) == [STATES, EVENTS, COMMANDS, STATES, COMMANDS]
    assert joiner.counts['missing'] == 0
    _, joiner = joined([*arrivals, (COMMANDS, [command(1)])])
    assert joiner.counts['missing'] == 1


def test_a_sample_is_its_parameters_state_event_command_and_what_has_no_stamp():
    entries, joiner = joined(
        [
            (PARAMETERS, [parameters(0)]),
            (STATES, [state(0, '')]),
            (EVENTS, [event(0)]),
            (DAMPING, [encode_float64(1.0)]),
            (COMMANDS, [fired(0)]),
            (STATES, [state(1)]),
            (PARAMETERS, [parameters(1, changed=True)]),
            (COMMANDS, [command(1)]),
            (STATES, [state(2)]),
            (COMMANDS, [command(2)]),
        ]
    )
    assert channels(entries) == [
        PARAMETERS,
        STATES,
        EVENTS,
        COMMANDS,
        DAMPING,
        PARAMETERS,
        STATES,
        COMMANDS,
        STATES,
        COMMANDS,
    ]
    assert [at for at, *_ in entries] == sorted(at for at, *_ in entries)
    assert joiner.reached == START + 2 * STEP


def test_nothing_is_handed_out_before_the_next_state_says_whose_command_acted():
    joiner = SampleJoiner(OURS)
    joiner.add(STATES, state(0, ''), 1)
    joiner.add(COMMANDS, command(0, author=ME, effort=1.0), 2)
    assert joiner.take() == []
    assert joiner.reached == 0  # another copy of the state may name an author not yet heard
    joiner.add(STATES, state(0, RIVAL), 3)
    assert joiner.take() == []
    assert joiner.reached == 0
    joiner.add(COMMANDS, command(0, author=RIVAL, effort=2.0), 3)
    assert joiner.take() == []
    assert joiner.reached == START
    joiner.add(STATES, state(1, RIVAL), 4)
    assert joiner.take() == [
        (START, STATES, state(0, '')),
        (START, COMMANDS, command(0, author=RIVAL, effort=2.0)),
    ]
    assert joiner.counts['repeated'] == 2


@given(st.sets(st.integers(1, 28)), st.sets(st.integers(1, 28)))
def test_every_missing_state_and_command_is_counted(lost_states, lost_commands):
    _, joiner = joined(
        [
            (STATES, [state(k) for k in range(30) if k not in lost_states]),
            (COMMANDS, [command(k) for k in range(30) if k not in lost_commands]),
        ]
    )
    assert joiner.counts['missing'] == len(lost_states) + len(lost_commands - lost_states)


@given(st.sets(st.integers(0, 29)), st.sets(st.integers(0, 29)))
def test_every_event_that_a_command_announces_is_missing_where_it_is_not_there(guards, lost):
    _, joiner = joined(
        [
            (STATES, [state(k) for k in range(30)]),
            (EVENTS, [event(k) for k in sorted(guards - lost)]),
            (COMMANDS, [fired(k) if k in guards else command(k) for k in range(30)]),
        ]
    )
    assert joiner.counts['missing'] == len(guards & lost)


def reached(joiner):
    joiner.take()
    return (joiner.reached - START) // STEP


def test_an_event_is_waited_for_until_it_or_a_later_one_comes_or_until_it_is_given_up():
    joiner = SampleJoiner(OURS)
    for k in range(9):
        joiner.add(STATES, state(k), k)
        joiner.add(COMMANDS, fired(k) if k in (2, 4, 6) else command(k), k)
    assert reached(joiner) == 1
    joiner.add(EVENTS, event(2), 9)
    assert reached(joiner) == 3
    joiner.add(EVENTS, event(6), 9)
    assert reached(joiner) == 8
    assert joiner.counts['missing'] == 1
    joiner.add(STATES, state(9), 10)
    joiner.add(COMMANDS, fired(9), 10)
    assert reached(joiner) == 8
    joiner.give_up()  # the newest sample is waited for: its command is sent again
    assert reached(joiner) == 8
    joiner.add(STATES, state(10), 11)
    joiner.give_up()
    assert reached(joiner) == 9
    assert joiner.counts['missing'] == 2


def test_the_command_of_a_killed_controller_is_waited_for_until_it_is_given_up():
    joiner = SampleJoiner(OURS)
    for raw in (state(0, ''), state(1), state(2), state(2, ''), state(2, RIVAL)):
        joiner.add(STATES, raw, 1)
    for raw in (command(0), command(2, author=RIVAL)):
        joiner.add(COMMANDS, raw, 1)
    assert reached(joiner) == 0
    joiner.give_up()
    assert reached(joiner) == 2
    assert joiner.counts['missing'] == 1


def test_what_comes_again_is_dropped_and_counted():
    entries, joiner = joined(
        [
            (STATES, [state(0, ''), state(0, ''), state(1), state(1, '')]),
            (COMMANDS, [command(0), command(1), command(1)]),
            (STATES, [state(2)]),
            (COMMANDS, [command(0)]),
        ]
    )
    assert len(entries) == 5
    assert joiner.counts['repeated'] == 4
    assert joiner.heard == 5


def test_a_state_that_nobody_answered_at_the_end_is_not_missing():
    _, joiner = joined([(STATES, [state(0, ''), state(1)]), (COMMANDS, [command(0)])])
    assert joiner.counts == {'states': 2, 'missing': 0, 'repeated': 0, 'foreign': 0}


def test_states_before_the_first_answered_one_are_not_missing_and_few_are_kept():
    joiner = SampleJoiner(FREE)
    for k in range(3 * WINDOW):
        joiner.add(STATES, state(k, ''), k)
        joiner.forget_early_states()
    assert not joiner.begun
    joiner.add(COMMANDS, command(3 * WINDOW - 1), 0)
    assert joiner.begun
    entries = joiner.take(everything=True)
    assert channels(entries) == [STATES] * WINDOW + [COMMANDS]
    assert joiner.counts['missing'] == 0


def test_another_run_is_left_out_and_named_and_foreign_states_are_kept_beside_the_run():
    entries, joiner = joined(
        [
            (STATES, [state(0, ''), state(50, '', run=OTHER_RUN)]),
            (COMMANDS, [command(0), command(50, run=OTHER_RUN)]),
        ]
    )
    assert channels(entries) == [STATES, COMMANDS]
    assert joiner.other == OTHER_RUN
    assert joiner.counts['foreign'] == 2
    entries, joiner = joined(
        [(STATES, [state(0, ''), state(7, run='', joint='elbow')]), (COMMANDS, [command(0)])]
    )
    assert channels(entries) == [STATES, COMMANDS, STATES]
    assert (joiner.counts['foreign'], joiner.other) == (1, None)


def test_a_foreign_plant_is_joined_by_its_stamps_and_another_run_when_time_goes_back():
    bare = [(STATES, [state(k, '', run='')]) for k in range(5)]
    answers = [(COMMANDS, [command(k, run='')]) for k in range(5)]
    entries, joiner = joined([*bare, *answers], FOREIGN_PLANT)
    assert channels(entries) == [STATES, COMMANDS] * 5
    assert joiner.other is None
    joiner.add(STATES, state(1, '', run=''), 9)
    assert joiner.other == ''


def test_a_foreign_controller_with_stamps_of_its_own_holds_nothing():
    foreign = [command(0, run='', at=(1_790_000_000, k)) for k in range(5)]
    entries, joiner = joined(
        [(STATES, [state(k, '-')]) for k in range(5)] + [(COMMANDS, foreign)], FREE
    )
    assert channels(entries).count(STATES) == 5
    assert [raw for _, channel, raw in entries if channel == COMMANDS] == foreign
    assert joiner.reached == START + 4 * STEP
    assert joiner.counts == {'states': 5, 'missing': 0, 'repeated': 0, 'foreign': 0}


def test_states_that_are_late_are_in_flight_while_their_commands_wait():
    states = [state(k, '', run='') for k in range(5)]
    joiner = SampleJoiner(FOREIGN_PLANT)
    for k in range(5):
        joiner.add(COMMANDS, command(k, run=''), k)
    joiner.add(STATES, states[0], 9)
    joiner.take()
    newest = joiner.newest_command
    assert joiner.in_flight(newest)
    for raw in states[1:]:
        joiner.add(STATES, raw, 9)
    joiner.take()
    assert not joiner.in_flight(newest)


def test_a_command_without_a_stamp_has_the_place_of_the_last_one_that_has_one():
    zero = command(0, at=(0, 0), effort=0.0)
    entries, _ = joined(
        [
            (STATES, [state(k) for k in range(4)]),
            (COMMANDS, [command(0), command(1), zero]),
            (COMMANDS, [command(2), command(3)]),
        ],
        FREE,
    )
    assert entries[3:5] == [(START + STEP, COMMANDS, command(1)), (START + STEP, COMMANDS, zero)]


@given(st.lists(st.integers(0, 9), max_size=20))
def test_what_has_no_stamp_stands_behind_the_state_that_was_published_before_it(times):
    joiner = SampleJoiner(OURS)
    for k in range(10):
        joiner.add(STATES, state(k), 10 * k)
        joiner.add(COMMANDS, command(k), 10 * k + 1)
    for k in times:
        joiner.add(DAMPING, encode_float64(float(k)), 10 * k + 2)
    entries = joiner.take() + joiner.take(everything=True)
    assert [one for one in entries if one[1] == DAMPING] == [
        (START + k * STEP, DAMPING, encode_float64(float(k))) for k in sorted(times)
    ]


@pytest.mark.parametrize(
    'raw', [b'', b'\x00\x01\x00\x00', b'\xff' * 40, b'\x00\x01\x00\x00' + b'\xff' * 60]
)
@pytest.mark.parametrize('channel', [STATES, EVENTS, COMMANDS, PARAMETERS, DAMPING])
def test_bytes_that_are_no_message_hold_nothing(channel, raw):
    _, joiner = joined(
        [
            (STATES, [state(0, '')]),
            (channel, [raw]),
            (COMMANDS, [command(0)]),
            (STATES, [state(1)]),
            (COMMANDS, [command(1)]),
        ]
    )
    assert joiner.reached == START + STEP
    assert joiner.counts['missing'] == 0
