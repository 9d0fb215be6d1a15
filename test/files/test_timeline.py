"""The order of a recording, and what is missing from it."""

from hypothesis import given, strategies as st

from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.files.timeline import COMMANDS, EVENTS, STATES, Timeline

STEP, START = 100_000, 1_000_000_000
EXTRA = 3
STATE = JointStateLayout('axis')
COMMAND = JointStateLayout('axis', '', ('effort',))


def state(tick, position=0.5):
    return STATE.encode(*divmod(START + tick * STEP, 10**9), position, 0.0, 0.0)


def command(tick, effort=1.0):
    return COMMAND.encode(*divmod(START + tick * STEP, 10**9), effort)


def recorded(arrivals):
    """Return the entries of (topic, message) in the order of arrival, and the timeline."""
    timeline = Timeline(STEP)
    entries = []
    for index, messages in arrivals:
        assert timeline.add(index, messages) == len(messages)
        entries += timeline.take()
    return entries + timeline.take(everything=True), timeline


@given(st.data())
def test_any_order_of_arrival_gives_the_same_recording(data):
    count = data.draw(st.integers(1, 30))
    queues = {STATES: [state(k) for k in range(count)],
              COMMANDS: [command(k) for k in range(count)],
              EVENTS: [STATE.encode(*divmod(START + k * STEP, 10**9), 0, 0, 9.0)
                       for k in range(0, count, 3)]}
    arrivals = []
    waiting = {index: list(messages) for index, messages in queues.items()}
    while any(waiting.values()):
        index = data.draw(st.sampled_from([i for i, messages in waiting.items() if messages]))
        size = data.draw(st.integers(1, len(waiting[index])))
        # a command or an event exists only once its state has been published
        arrivals.append((index, [waiting[index].pop(0) for _ in range(size)]))
    taken, timeline = recorded(arrivals)
    assert sorted(taken) == sorted(
        (START + k * STEP, index, raw) for index, messages in queues.items()
        for k, raw in zip(range(0, count, 3) if index == EVENTS else range(count), messages,
                          strict=True))
    assert timeline.missing == timeline.repeated == 0


def test_the_recording_is_in_the_order_of_stamps_with_states_first():
    batches = [(STATES, [state(0), state(1)]), (COMMANDS, [command(0)]),
               (EVENTS, [STATE.encode(1, 0, 0, 0, 9.0)]), (COMMANDS, [command(1)]),
               (STATES, [state(2)]), (EXTRA, [b'\x00\x01\x00\x00damping']),
               (COMMANDS, [command(2)])]
    timeline = Timeline(STEP)
    for index, messages in batches:
        timeline.add(index, messages)
    order = [(stamp, index) for stamp, index, _ in timeline.take()]
    assert order == sorted(order)
    assert [index for _, index in order] == [
        STATES, EVENTS, COMMANDS, STATES, COMMANDS, STATES, COMMANDS, EXTRA][:len(order)]
    assert timeline.reached == START + 2 * STEP


@given(st.sets(st.integers(1, 28)), st.sets(st.integers(1, 28)))
def test_every_missing_state_and_command_is_counted(lost_states, lost_commands):
    _, timeline = recorded([
        (STATES, [state(k) for k in range(30) if k not in lost_states]),
        (COMMANDS, [command(k) for k in range(30) if k not in lost_commands])])
    assert timeline.missing == len(lost_states) + len(lost_commands - lost_states)


def test_repeats_are_dropped_and_counted():
    taken, timeline = recorded([(STATES, [state(0), state(0), state(1)]),
                                (COMMANDS, [command(0), command(1), command(1)])])
    assert len(taken) == 4
    assert (timeline.repeated, timeline.missing) == (2, 0)


def test_two_different_answers_to_one_state_are_both_kept():
    taken, timeline = recorded([(STATES, [state(0), state(1)]),
                                (COMMANDS, [command(0), command(0, 2.0), command(1)])])
    assert len(taken) == 5
    assert timeline.missing == 0


@given(st.integers(-5, 20_000), st.integers(0, 9))
def test_a_foreign_command_is_kept_and_disturbs_nothing(tick, after):
    commands = [command(k) for k in range(10)]
    commands.insert(after, command(tick, 77.0))
    taken, timeline = recorded([(STATES, [state(k) for k in range(10)]), (COMMANDS, commands)])
    assert len(taken) == 21
    assert timeline.missing == 0
    assert timeline.reached == START + 9 * STEP


def test_a_state_that_goes_back_begins_another_run():
    timeline = Timeline(STEP)
    assert timeline.add(STATES, [state(k) for k in (0, 1, 2, 0, 1)]) == 3
    assert timeline.add(COMMANDS, [command(k) for k in (0, 1, 2)]) == 3
    assert len(timeline.take()) == 6


def test_another_state_at_the_same_stamp_begins_another_run():
    assert Timeline(STEP).add(STATES, [state(0), state(0, position=0.25)]) == 1


def test_states_before_the_first_command_are_not_missing_theirs():
    _, timeline = recorded([(STATES, [state(k) for k in range(10)]),
                            (COMMANDS, [command(k) for k in range(4, 10)])])
    assert timeline.missing == 0


def test_a_message_too_short_for_a_stamp_is_kept():
    taken, _ = recorded([(STATES, [state(0)]), (COMMANDS, [b'\x00']), (COMMANDS, [command(0)])])
    assert len(taken) == 3
