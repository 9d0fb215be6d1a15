"""Silence, take-over and repeated states, as plant, controller and recorders judge them."""

import pytest

from impulse_control_ros.core.age import Age, AgeLimit
from impulse_control_ros.core.command_arbiter import CommandArbiter
from impulse_control_ros.core.protocol import (
    CommandHeader,
    FOREIGN,
    Reply,
    RUN_TIMEOUT,
    StateHeader,
    Verdict,
)
from impulse_control_ros.core.recorder_flow_control import RecorderFlowControl
from impulse_control_ros.core.silence import LONGEST_LOOK, Silence
from impulse_control_ros.core.state_arbiter import StateArbiter
from impulse_control_ros.core.tick import SampleClock, SECOND

RUN, OTHER_RUN, OURS = '0123abcd', '89abcdef', '/controller#ab12'


def wait(silence, seconds, since=0.0):
    """Let so many seconds pass for a process that runs."""
    for k in range(round(2 * seconds / LONGEST_LOOK) + 1):
        silence.look(since + k * LONGEST_LOOK / 2)


def test_time_in_which_the_process_was_stopped_is_no_silence():
    silence = Silence(0.0)
    assert silence.look(60.0) == LONGEST_LOOK
    silence.hear()
    assert silence.seconds == 0.0


@pytest.mark.parametrize('lockstep', [False, True])
def test_a_foreign_controller_whose_stamps_are_stale_for_ever_is_replaced(lockstep):
    arbiter = CommandArbiter(RUN, lockstep, 0.0)
    arbiter.expect((10, 0), 0.0)
    assert arbiter.take(CommandHeader(), (10, 0), 1.0, 0.0) is Verdict.ACTS
    arbiter.expect((10, 1), 0.0)
    for k in range(100):
        arbiter.silence.look(k / 20)
        assert arbiter.take(CommandHeader(), (9, k), 2.0, k / 20) is Verdict.STALE
    assert arbiter.header.controller == FOREIGN
    assert arbiter.drop_silent(1.0)
    assert arbiter.header.controller == ''


def test_only_for_a_manager_that_waited_for_time_a_later_stamp_answers_a_state_in_lockstep():
    arbiter = CommandArbiter(RUN, True, 0.0)
    arbiter.effort = 2.0
    arbiter.expect((10, 5), 0.0)
    assert arbiter.take(CommandHeader(), (99, 0), 1.0, 0.0) is Verdict.STALE
    wait(arbiter.silence, 2.0)
    arbiter.let_time_pass(False)
    assert arbiter.awaiting
    assert arbiter.take(CommandHeader(), (99, 0), 1.0, 2.0) is Verdict.STALE
    arbiter.let_time_pass(True)
    assert not arbiter.awaiting
    assert (arbiter.effort, arbiter.silence.seconds) == (2.0, 0.0)
    arbiter.expect((10, 6), 2.0)
    for sender, stamp in ((CommandHeader(), (10, 5)), (CommandHeader(RUN, 0, OURS), (99, 0))):
        assert arbiter.take(sender, stamp, 1.0, 2.0) is Verdict.STALE
    assert arbiter.take(CommandHeader(), (99, 0), 1.0, 2.0) is Verdict.ACTS  # of the wall clock
    assert arbiter.take(CommandHeader(), (99, 1), 3.0, 2.0) is Verdict.STALE  # one for a state
    assert arbiter.effort == 1.0


def test_a_controller_of_ours_that_is_behind_is_heard():
    arbiter = CommandArbiter(RUN, True, 0.0)
    command = CommandHeader(RUN, 0, OURS)
    arbiter.expect((10, 0), 0.0)
    assert arbiter.take(command, (10, 0), 1.0, 0.0) is Verdict.ACTS
    arbiter.expect((10, 1), 0.0)
    wait(arbiter.silence, 2.0)
    assert arbiter.take(command, (10, 0), 1.0, 2.0) is Verdict.STALE
    assert not arbiter.drop_silent(1.0)


def adopted(stamp=10):
    arbiter = StateArbiter(OURS, 1, 0.0)
    assert arbiter.judge(StateHeader(RUN), stamp, True) is Reply.ANSWER_AFRESH
    return arbiter


def test_a_controller_that_was_stopped_stays_with_its_run():
    arbiter = adopted()
    arbiter.silence.look(60.0)
    assert arbiter.judge(StateHeader(OTHER_RUN), 5, True) is Reply.OTHER_RUN
    arbiter.silence.hear()
    wait(arbiter.silence, 2 * RUN_TIMEOUT, since=60.0)
    assert arbiter.judge(StateHeader(OTHER_RUN), 5, True) is Reply.ANSWER_AFRESH


def test_a_controller_that_starts_afresh_repeats_the_answer_it_has_given():
    arbiter = adopted()
    assert arbiter.is_answering
    arbiter.start_afresh()
    assert not arbiter.is_answering
    named = StateHeader(RUN, 0, OURS)
    assert arbiter.judge(named, 10, True) is Reply.REPEAT
    assert not arbiter.follows(named, 11)
    assert arbiter.judge(named, 11, True) is Reply.ANSWER_AFRESH
    assert arbiter.follows(named, 12)


def test_recorders_are_kept_when_the_plant_was_stopped_and_dropped_when_they_are_silent():
    recorders = RecorderFlowControl(SampleClock(0, 1), True)
    assert recorders.take('/recorder#0000', 0, 0.0) == 'has joined'
    assert recorders.drop_silent(60.0, 10.0) == []
    dropped = [name for k in range(201) for name in recorders.drop_silent(60.0 + k / 20, 10.0)]
    assert dropped == ['/recorder#0000']


# -- age ------------------------------------------------------------------------------------

LIMIT, HOUR = 2.0, 3600 * SECOND


@pytest.mark.parametrize(
    ('age', 'limit', 'found'),
    [
        (0, LIMIT, Age.FRESH),
        (2 * SECOND, LIMIT, Age.FRESH),
        (2 * SECOND + 1, LIMIT, Age.OLD),
        (24 * HOUR, LIMIT, Age.OLD),
        (24 * HOUR + 1, LIMIT, Age.UNKNOWN),
        (-2 * SECOND, LIMIT, Age.FRESH),
        (-2 * SECOND - 1, LIMIT, Age.UNKNOWN),
        (HOUR, 0.0, Age.FRESH),
    ],
)
def test_a_stamp_far_from_the_clock_tells_no_age(age, limit, found):
    judge = AgeLimit(limit)
    assert judge.judge(100 * HOUR - age, 100 * HOUR) is found
    assert bool(judge.clock_error) == (found is Age.UNKNOWN)


def free_plant(second=100):
    """Return the arbiter of a free-running plant at this second, with a limit of 2 s."""
    arbiter = CommandArbiter(RUN, False, 0.0)
    arbiter.age = AgeLimit(LIMIT)
    arbiter.expect((second, 0), 0.0)
    return arbiter


OWN = CommandHeader(RUN, 0, OURS)


def test_an_old_command_is_no_command():
    arbiter = free_plant()
    assert arbiter.take(OWN, (97, 999_999_999), 1.0, 0.0) is Verdict.OLD
    assert (arbiter.effort, arbiter.header.controller, arbiter.counts['old']) == (0.0, '', 1)
    assert arbiter.take(OWN, (98, 0), 2.0, 0.0) is Verdict.ACTS
    arbiter.expect((101, 0), 0.0)
    wait(arbiter.silence, 2.0)
    assert arbiter.take(OWN, (98, 1), 3.0, 0.0) is Verdict.OLD
    assert arbiter.header.controller == OURS
    assert arbiter.drop_silent(1.0)  # it was not heard


@pytest.mark.parametrize(
    ('sender', 'stamp', 'last'),
    [
        (OWN, (99, 0), 101),
        (OWN, (0, 0), 102),
        (CommandHeader(), (0, 0), 102),
        (CommandHeader(), (101, 0), 102),
        (CommandHeader(), (1_700_000_000, 0), 102),
        (CommandHeader(), (3, 0), 0),
    ],
)
def test_a_command_acts_for_max_age_since_its_stamp_or_its_arrival(sender, stamp, last):
    arbiter = free_plant()
    assert (arbiter.take(sender, stamp, 1.0, 0.0) is Verdict.ACTS) == (last > 0)
    for second in (101, 102, 103, 104):
        arbiter.expect((second, 0), 0.0)
        assert arbiter.effort == float(second <= last)
    assert arbiter.take(OWN, (104, 0), 5.0, 0.0) is not Verdict.OLD


def test_in_lockstep_no_command_is_old():
    arbiter = CommandArbiter(RUN, True, 0.0)
    arbiter.age = AgeLimit(1e-9)
    for second in (1, 2):
        arbiter.expect((second, 0), 0.0)
        assert arbiter.take(OWN, (second, 0), 1.0, 0.0) is Verdict.ACTS
    arbiter.expect((3, 0), 0.0)
    assert arbiter.effort == 1.0
