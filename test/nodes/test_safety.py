"""What the controller sends when it cannot know better: nothing but a finite effort, or zero."""

import math

import pytest
from sensor_msgs.msg import JointState

from test.nodes.runs import stamp_of


def state(tick, position, velocity=0.0):
    message = JointState(name=['axis'], position=[position], velocity=[velocity], effort=[0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = 1, tick * 1_000_000
    return message


@pytest.fixture
def hand_fed(graph, client):
    """A controller whose plant is this test: returns what feeds it, and what it says."""

    def start(**parameters):
        process = graph.start('controller', time_step=0.001, **parameters)
        commands = client.listen('/joint_commands', JointState)
        publisher = client.publisher('/joint_states', JointState, 'controller')
        client.spin_until(lambda: client.node.count_publishers('/joint_commands'), 'commands')

        def feed(message):
            before = len(commands)

            def answered():
                # the very same state again is answered by the very same command
                if not [one for one in commands[before:] if stamp_of(one) == stamp_of(message)]:
                    publisher.publish(message)
                return [one for one in commands[before:] if stamp_of(one) == stamp_of(message)]

            return client.spin_until(answered, 'the command')[0].effort[0]

        feed.publisher = publisher
        return process, feed, commands

    return start


@pytest.mark.parametrize(
    ('limit', 'velocities'),
    [(0.0, (0.0, -1e308)), (20.0, (-1e308,))],
    ids=['any effort', 'bounded effort'],
)
def test_an_effort_that_is_not_finite_is_sent_as_zero_with_the_reason(
    hand_fed, client, limit, velocities
):
    process, feed, commands = hand_fed(
        state_timeout=0.0, D=10.0, effort_limit=limit, impulses=False
    )
    for tick, velocity in enumerate(velocities):
        assert feed(state(3 * tick, 0.5)) == -5.0
        assert feed(state(3 * tick + 1, 1e308, velocity)) == 0.0
        assert feed(state(3 * tick + 2, 0.25)) == -2.5
    process.says('sending 0 N')
    client.reported('controller', withheld=len(velocities))
    assert {one.effort[0] for one in commands} == {-5.0, 0.0, -2.5}
    assert process.interrupt() == 0


FRESH, ON = -5.0 - 375.0, -5.0 - 187.5  # N at rest at 0.5 m: an arrival, and a sticking impulse


def test_what_is_withheld_and_a_clock_that_goes_back_clear_the_memory_of_the_guards(hand_fed):
    _, feed, _ = hand_fed(state_timeout=0.0, supervision=False)
    assert [feed(state(k, 0.5)) for k in (5, 6)] == pytest.approx([FRESH, ON])
    assert feed(state(7, 1e308)) == 0.0
    assert [feed(state(k, 0.5)) for k in (8, 9)] == pytest.approx([FRESH, ON])
    assert [feed(state(k, 0.5)) for k in (2, 3)] == pytest.approx([FRESH, ON])


@pytest.mark.parametrize('period', [1, 2])
def test_states_at_another_rate_than_time_step_are_an_error(hand_fed, client, period):
    process, feed, _ = hand_fed(state_timeout=0.0)
    for k in range(120):
        feed(state(period * k, 0.5))
    message = client.reported('controller', answered=120)['message']
    assert ('time_step is wrong' in message) == (period == 2)
    assert process.interrupt() == 0


def test_states_that_stay_away_make_a_zero_command_and_their_return_ends_it(hand_fed, client):
    process, feed, commands = hand_fed(state_timeout=0.1, effort_limit=20.0)
    assert feed(state(0, 0.5)) == -20.0  # an impulse, most of which is yet to leave
    client.spin_until(lambda: any(one.effort[0] == 0.0 for one in commands), 'zero')
    zeros = {(one.effort[0], stamp_of(one)) for one in commands if one.effort[0] == 0.0}
    assert zeros == {(0.0, 0)}
    assert feed(state(100, 0.5, -1.0)) == -4.5  # what was yet to leave is forgotten
    process.says('states received again')

    def same():  # who says the same for ever has stopped
        feed.publisher.publish(state(100, 0.5, -1.0))
        return len([one for one in commands if stamp_of(one) == 0]) > 3

    client.spin_until(same, '0 N')
    assert process.interrupt() == 0


def broken():
    """Yield states that cannot be answered."""
    yield 'position nan', {'position': [math.nan], 'velocity': [0.0]}
    yield 'velocity inf', {'position': [0.0], 'velocity': [math.inf]}
    yield 'empty', {}
    yield 'short', {'name': ['elbow', 'axis'], 'position': [1.0], 'velocity': [1.0, 2.0]}


def test_a_state_that_says_nothing_is_rejected_and_the_next_one_is_answered(hand_fed, client):
    process, feed, commands = hand_fed(state_timeout=0.0, impulses=False)
    assert feed(state(0, 0.5)) == -5.0
    sent = 0
    for _, fields in broken():
        message = state(1, 0.0)
        message.position, message.velocity, message.effort = [], [], []
        for name, value in fields.items():
            setattr(message, name, value)
        feed.publisher.publish(message)
        sent += 1
    without_stamp, same_stamp = state(0, 0.3), state(0, 0.3)
    without_stamp.header.stamp.sec = 0
    for message in (without_stamp, same_stamp, b'\x00\x01\x00\x00' + b'\xff' * 60):
        feed.publisher.publish(message)
        sent += 1
    client.reported('controller', rejected=sent, answered=1)
    assert process.output.count('state rejected') == 1  # in 5 s
    assert feed(state(2, 0.25)) == -2.5
    assert {stamp_of(one) for one in commands} == {stamp_of(state(k, 0.0)) for k in (0, 2)}
    assert process.interrupt() == 0


def test_messages_of_other_joints_are_ignored_and_said_once_as_info(hand_fed, client):
    process, feed, commands = hand_fed(state_timeout=0.0, impulses=False)
    for names in (['elbow', 'knee'], [], ['wrist']):
        message = state(0, 0.0)
        message.name, message.position, message.velocity = names, [1.0] * len(names), []
        feed.publisher.publish(message)
    client.reported('controller', ignored=3, rejected=0, message='waiting for states')
    assert feed(state(1, 0.5)) == -5.0
    assert len(commands) == 1
    assert process.output.count('ignoring states') == 1
    assert '[INFO]' in process.output
    assert "no joint 'axis', but elbow, knee" in process.output
    assert '[ERROR]' not in process.output
    assert process.interrupt() == 0


def test_a_joint_among_many_is_found_and_a_velocity_that_is_not_measured_is_estimated(
    hand_fed, client
):
    process, feed, commands = hand_fed(state_timeout=0.0, impulses=False)
    big = state(0, 0.0)
    big.name = [f'joint_{number}' for number in range(10_000)] + ['axis']
    big.position, big.velocity = [9.0] * 10_000 + [0.5], [9.0] * 10_000 + [1.0]
    big.effort = []
    assert feed(big) == -5.5
    names = ['knee', 'axis', 'elbow']

    def three(tick, axis, position, velocity):
        message = state(tick, 0.0)
        message.name, message.effort = names if axis == 1 else names[::-1], []
        message.position, message.velocity = position, velocity
        return feed(message)

    assert three(1, 1, [9.0, 0.4, -9.0], [9.0, -2.0, -9.0]) == -4.0 + 1.0
    assert three(2, 1, [9.0, 0.4, -9.0], []) < -3.0
    assert three(3, 1, [9.0, 0.3, -9.0], [0.0, -1.0, 0.0]) == -3.0 + 0.5
    # hardware without a velocity interface sends nan
    estimated = []
    for tick in range(4, 60):
        position_only = state(tick, 0.3 - 0.001 * tick, math.nan)
        position_only.effort = [math.nan]
        estimated.append(feed(position_only))
    assert estimated[-1] == pytest.approx(-10.0 * (0.3 - 0.001 * 59) + 0.5, abs=0.02)
    assert client.set('controller', velocity_source='estimated').successful
    assert math.isfinite(feed(state(60, 0.3, 1e9)))
    assert {one.name[0] for one in commands} == {'axis'}
    assert process.interrupt() == 0
