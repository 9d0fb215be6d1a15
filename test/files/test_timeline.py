"""The order of a recording, and what is missing from it."""

from hypothesis import given, strategies as st

from impulse_control_ros.files.cdr import COMMANDED, JointStateLayout, RESET_MARK
from impulse_control_ros.files.timeline import (
    COMMANDS,
    EVENTS,
    stamp_of,
    STATES,
    Timeline,
    UNANSWERED,
    UNNUMBERED,
)

STEP, START = 100_000, 1_000_000_000
EXTRA = 3
STATE = JointStateLayout('axis')
MARKED = JointStateLayout('axis', RESET_MARK)
ELBOW = JointStateLayout('elbow')
COMMAND = JointStateLayout('axis', '', COMMANDED)
FIRED = JointStateLayout('axis', 'velocity_zero', COMMANDED)
EVENT = JointStateLayout('axis', 'velocity_zero')


def state(tick, position=0.5):
    return STATE.encode(*divmod(START + tick * STEP, 10**9), position, 0.0, 0.0)


def marked(tick):
    return MARKED.encode(*divmod(START + tick * STEP, 10**9), 0.5, 0.0, 0.0)


def command(tick, effort=1.0):
    return COMMAND.encode(*divmod(START + tick * STEP, 10**9), effort)


def fired(tick):
    return FIRED.encode(*divmod(START + tick * STEP, 10**9), 9000.0)


def event(tick):
    return EVENT.encode(*divmod(START + tick * STEP, 10**9), 0.0, 0.0, 9.0)


def sent(messages):
    """Return messages as rclpy takes them, published at their stamp."""
    return [(raw, {'source_timestamp': stamp_of(raw), 'publication_sequence_number': UNNUMBERED})
            for raw in messages]


def recorded(arrivals):
    """Return the entries of (topic, message) in the order of arrival, and the timeline."""
    timeline = Timeline(STEP, 'axis')
    entries = []
    for index, messages in arrivals:
        assert timeline.add(index, sent(messages)) == len(messages)
        entries += timeline.take()
    return entries + timeline.take(everything=True), timeline


@given(st.data())
def test_any_order_of_arrival_gives_the_same_recording(data):
    count = data.draw(st.integers(1, 30))
    queues = {STATES: [state(k) for k in range(count)],
              COMMANDS: [command(k) if k % 3 else fired(k) for k in range(count)],
              EVENTS: [event(k) for k in range(0, count, 3)]}
    arrivals = []
    waiting = {index: list(messages) for index, messages in queues.items()}
    while any(waiting.values()):
        index = data.draw(st.sampled_from([i for i, messages in waiting.items() if messages]))
        size = data.draw(st.integers(1, len(waiting[index])))
        arrivals.append((index, [waiting[index].pop(0) for _ in range(size)]))
    taken, timeline = recorded(arrivals)
    assert sorted(taken) == sorted(
        (START + k * STEP, index, raw) for index, messages in queues.items()
        for k, raw in zip(range(0, count, 3) if index == EVENTS else range(count), messages,
                          strict=True))
    assert timeline.missing == timeline.repeated == 0


def test_the_recording_is_in_the_order_of_stamps_with_states_first():
    batches = [(STATES, [state(0), state(1)]), (COMMANDS, [command(0)]),
               (EVENTS, [event(0)]), (COMMANDS, [command(1)]),
               (STATES, [state(2)]), (EXTRA, [command(2, 5.0)]),
               (COMMANDS, [command(2)])]
    timeline = Timeline(STEP, 'axis')
    for index, messages in batches:
        timeline.add(index, sent(messages))
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


@given(st.sets(st.integers(0, 29)), st.sets(st.integers(0, 29)))
def test_every_event_that_a_command_tells_of_is_missing_where_it_is_not_there(guards, lost):
    _, timeline = recorded([
        (STATES, [state(k) for k in range(30)]),
        (EVENTS, [event(k) for k in sorted(guards - lost)]),
        (COMMANDS, [fired(k) if k in guards else command(k) for k in range(30)])])
    assert timeline.missing == len(guards & lost)


def test_an_event_is_awaited_until_it_or_a_later_one_comes_or_nobody_waits_longer():
    timeline = Timeline(STEP, 'axis')
    timeline.add(STATES, sent(state(k) for k in range(9)))
    timeline.add(COMMANDS, sent(fired(k) if k in (2, 4, 6) else command(k) for k in range(9)))

    def reached():
        taken = len(timeline.take())
        return taken, (timeline.reached - START) // STEP, (timeline.awaited - START) // STEP
    assert reached() == (4, 1, 2)
    timeline.add(EVENTS, sent([event(2)]))
    assert reached() == (5, 3, 4)
    timeline.add(EVENTS, sent([event(6)]))
    assert reached()[:2] == (11, 8)
    assert (timeline.awaited, timeline.missing) == (0, 1)
    timeline.add(STATES, sent([state(9)]))
    timeline.add(COMMANDS, sent([fired(9)]))
    assert reached() == (0, 8, 9)
    timeline.give_up()
    assert reached()[:2] == (2, 9)
    assert (timeline.awaited, timeline.missing) == (0, 2)


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


@given(st.permutations([STATES, COMMANDS, EXTRA]), st.integers(1, 7))
def test_what_has_no_stamp_gets_that_of_the_state_before_it_whatever_arrives_first(order, size):
    count = 14
    queues = {STATES: sent(state(k) for k in range(count)),
              COMMANDS: sent(command(k) for k in range(count)),
              EXTRA: [(b'%d' % k, {'source_timestamp': START + k * STEP + STEP // 2})
                      for k in range(count)]}
    timeline, taken = Timeline(STEP, 'axis'), []
    while any(queues.values()):
        for index in order:
            timeline.add(index, queues[index][:size])
            del queues[index][:size]
        taken += timeline.take()
    taken += timeline.take(everything=True)
    assert [(stamp, raw) for stamp, index, raw in taken if index == EXTRA] == [
        (START + k * STEP, b'%d' % k) for k in range(count)]


def test_a_word_of_the_controllers_stands_at_the_first_state_it_answers_after_it():
    def told(node):
        name = node.encode() + b'\0'
        return b'\0\1\0\0' + bytes(8) + len(name).to_bytes(4, 'little') + name

    # state k goes out at 10 k, its command at 10 k + 6
    states = [(state(k), {'source_timestamp': 10 * k}) for k in range(6)]
    commands = [
        (command(k), {'source_timestamp': 10 * k + 6, 'publication_sequence_number': UNNUMBERED})
        for k in range(6)]
    timeline = Timeline(STEP, 'axis', controller='/controller')
    timeline.add(EXTRA, [(told(node), {'source_timestamp': time}) for time in (33, 37)
                         for node in ('/controller', '/plant_simulator', '/controller2')])
    placed = []
    for k in range(0, 6, 2):
        timeline.add(STATES, states[k:k + 2])
        placed += timeline.take()
        timeline.add(COMMANDS, commands[k:k + 2])
        placed += timeline.take()
    assert [stamp for stamp, index, _ in placed if index == EXTRA] == [
        START + k * STEP for k in (3, 3, 3, 3, 3, 4)]
    assert sorted((raw[16:], stamp) for stamp, index, raw in placed if index == EXTRA) == sorted(
        (told(node)[16:], START + k * STEP) for node, k in (
            ('/controller', 3), ('/controller', 4), ('/plant_simulator', 3),
            ('/plant_simulator', 3), ('/controller2', 3), ('/controller2', 3)))


def begun(*numbers):
    """Return the places of the commands of those numbers that are noticed as the first ones."""
    timeline = Timeline(STEP, 'axis')
    timeline.add(STATES, sent(state(k) for k in range(len(numbers))))
    timeline.add(COMMANDS, [(command(k), {'source_timestamp': k, 'publication_sequence_number': n})
                            for k, n in enumerate(numbers)])
    return [(stamp - START) // STEP for stamp in timeline.begun]


def test_the_first_command_of_another_controller_in_mid_run_is_noticed():
    assert begun(1, 2, 3, 1, 2, 1) == [3, 5]
    assert begun(UNNUMBERED, UNNUMBERED, UNNUMBERED) == []


def test_a_newcomer_is_noticed_by_the_first_command_that_arrives():
    assert begun(7, 8, 9, 3, 4, 5) == [3]
    assert begun(7, 8, 10, 11) == []


def test_of_two_controllers_at_a_time_each_is_noticed_once():
    assert begun(70, 71, 1, 72, 2, 3, 73, 1, 74, 2, 4) == [2, 7]


def test_a_newcomer_whose_first_command_repeats_its_predecessors_last_is_noticed():
    timeline = Timeline(STEP, 'axis')
    timeline.add(STATES, sent(state(k) for k in range(3)))
    timeline.add(COMMANDS, [(command(k), {'source_timestamp': k, 'publication_sequence_number': n})
                            for k, n in ((0, 1), (1, 2), (1, 1), (2, 2))])
    assert timeline.begun == [START + STEP]
    assert timeline.repeated == 1


def runs(*messages, joint='axis', alone=True):
    """Return the number of states of each run that these states make, and of the foreign ones."""
    waiting, counts, foreign = list(messages), [], 0
    while waiting:
        timeline = Timeline(STEP, joint, lambda: alone)
        taken = 0
        while waiting and not timeline.over:
            for size in range(1, len(waiting) + 1):  # as they arrive, one by one
                done = timeline.add(STATES, sent(waiting[:size]), everything=size == len(waiting))
                if done or timeline.over:
                    break
            taken, waiting = taken + done, waiting[done:]
        counts.append(taken - timeline.foreign - timeline.repeated)
        foreign += timeline.foreign
    return counts, foreign


def test_a_marked_state_out_of_the_series_begins_another_run():
    for start in (0, 1, 5, 30_000):
        series = [state(k) for k in (0, 1, 2)]
        assert runs(*series, marked(start), state(start + 1)) == ([3, 2], 0)
        assert runs(*series, marked(start)) == ([3, 1], 0)


def test_the_states_of_a_second_plant_are_foreign_to_the_run_of_the_first():
    second = [marked(0), state(1, 0.25), state(2, 0.25)]
    counts, foreign = runs(state(5), second[0], state(6), second[1], state(7), second[2],
                           state(8), alone=False)
    assert (counts, foreign) == ([4], 3)


def test_a_marked_state_in_the_series_is_a_reset_within_the_run():
    assert runs(state(0), state(1), marked(2), state(3)) == ([4], 0)


def test_states_that_go_back_begin_another_run_once_they_are_borne_out():
    series = [state(k) for k in (0, 1, 2)]
    assert runs(*series, state(0), state(1)) == ([3, 2], 0)
    assert runs(*series, state(0, 0.25), state(0, 0.25)) == ([3, 1], 0)


@given(st.integers(1, 8), st.sampled_from([
    ELBOW.encode(0, 0, 1.0, 2.0, 3.0), ELBOW.encode(1, 300_000, 1.0, 2.0, 3.0),
    STATE.encode(0, 0, 0.0, 0.0, 0.0), STATE.encode(1, 0, 7.0, 0.0, 0.0),
    STATE.encode(4000, 0, 7.0, 0.0, 0.0), b'', b'\x00\x01']), st.integers(1, 3))
def test_a_foreign_state_is_kept_and_disturbs_nothing(after, foreign, times):
    series = [state(k) for k in range(9)]
    if b'axis' in foreign and foreign[4:12] != bytes(8):
        times = 1  # the second would bear it out
    messages = series[:after] + [foreign] * times + series[after:]
    counts, others = runs(*messages)
    assert counts == [9]
    assert others == len(messages) - 9


def test_foreign_states_stand_beside_the_series_in_the_recording():
    other = ELBOW.encode(77, 0, 1.0, 2.0, 3.0)
    taken, timeline = recorded([(STATES, [state(0), other, state(1)]),
                                (COMMANDS, [command(0), command(1)])])
    assert (START, STATES, other) in taken
    assert (len(taken), timeline.missing, timeline.foreign) == (5, 0, 1)


def test_a_jump_ahead_that_is_borne_out_is_a_gap():
    timeline = Timeline(STEP, 'axis')
    states = [state(0), state(1), state(50_000), state(50_001)]
    assert timeline.add(STATES, sent(states)) == 4
    timeline.take(everything=True)
    assert timeline.missing == 49_998


def test_states_closer_than_the_step_are_not_counted_below_zero():
    _, timeline = recorded([(STATES, [STATE.encode(1, 10 * k, 0, 0, 0) for k in range(9)])])
    assert timeline.missing == 0


def test_states_before_the_first_command_are_not_missing_theirs():
    _, timeline = recorded([(STATES, [state(k) for k in range(10)]),
                            (COMMANDS, [command(k) for k in range(4, 10)])])
    assert timeline.missing == 0


def test_from_the_start_of_a_run_on_states_miss_their_commands():
    _, timeline = recorded([(STATES, [marked(0), *(state(k) for k in range(1, 10))]),
                            (COMMANDS, [command(k) for k in range(4, 10)])])
    assert timeline.missing == 4


def test_a_message_too_short_for_a_stamp_is_kept():
    taken, _ = recorded([(STATES, [state(0)]), (COMMANDS, [b'\x00']), (COMMANDS, [command(0)])])
    assert len(taken) == 3


def test_states_that_nobody_answers_do_not_wait_for_ever():
    timeline = Timeline(STEP, 'axis')
    timeline.add(STATES, sent(state(k) for k in range(3 * UNANSWERED)))
    assert len(timeline.take()) == 2 * UNANSWERED - 1
    last = 3 * UNANSWERED - 1
    timeline.add(COMMANDS, sent([command(last)]))
    entries = timeline.take()
    assert entries[-1] == (START + last * STEP, COMMANDS, command(last))
    assert len(entries) == UNANSWERED + 2
    assert timeline.missing == 0


def test_a_command_without_a_stamp_stands_behind_the_last_one_with():
    zero = COMMAND.encode(0, 0, 0.0)
    entries, timeline = recorded([
        (STATES, [state(0), state(1), state(2)]), (COMMANDS, [command(0), command(1), zero]),
        (COMMANDS, [command(2)])])
    commands = [((at - START) // STEP, raw) for at, index, raw in entries if index == COMMANDS]
    assert commands == [(0, command(0)), (1, command(1)), (1, zero), (2, command(2))]
    assert timeline.missing == 0
