"""What the controller sends when it cannot know better: nothing but a finite effort, or zero."""

import math

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from impulse_control_ros.files.recording import read
from test.conftest import CONFIG

UNDERDAMPED = CONFIG / 'underdamped.yaml'
COARSE = ('--ros-args', '-p', 'time_step:=0.001')
FREE = ('-p', 'lockstep:=false', '-p', 'real_time_factor:=0.1')


def state(tick, position, velocity=0.0):
    message = JointState(name=['axis'], position=[position], velocity=[velocity], effort=[0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = 1, tick * 1_000_000
    return message


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.fixture
def hand_fed(graph, client):
    """A controller whose plant is this test: returns what feeds it, and what it says."""
    def start(*arguments):
        process = graph.start('controller', *COARSE, *arguments)
        publisher = client.node.create_publisher(JointState, '/joint_states', 10)
        commands = client.listen('/joint_commands', JointState)
        client.spin_until(lambda: publisher.get_subscription_count()
                          and client.node.count_publishers('/joint_commands'), 'the controller')

        def feed(message):
            publisher.publish(message)
            return client.spin_until(
                lambda: [one for one in commands if stamp(one) == stamp(message)],
                'the command')[0].effort[0]
        feed.publisher = publisher
        return process, feed, commands
    return start


@pytest.mark.parametrize(('limit', 'position', 'velocity', 'said'), [
    (0.0, 1e308, 0.0, '-inf'), (0.0, 1e308, -1e308, 'nan'), (20.0, 1e308, -1e308, 'nan')])
def test_an_effort_that_is_not_finite_is_sent_as_zero_with_the_reason(
        hand_fed, limit, position, velocity, said):
    process, feed, commands = hand_fed('-p', 'state_timeout:=0.0', '-p', 'D:=10.0', '-p',
                                       f'effort_limit:={limit}', '-p', 'impulses:=false')
    assert feed(state(0, 0.5)) == -5.0
    assert feed(state(1, position, velocity)) == 0.0
    process.says(f'0 N is sent: the effort for position 1e+308 m, velocity {velocity:g} m/s is '
                 f'{said}; allowed is [-')
    assert feed(state(2, 0.25)) == -2.5
    assert [one.effort[0] for one in commands] == [-5.0, 0.0, -2.5]
    assert process.interrupt() == 0


FRESH, ON = -5.0 - 375.0, -5.0 - 187.5  # N at rest at 0.5 m: an arrival, and a sticking impulse


def test_what_is_withheld_and_a_clock_that_goes_back_clear_the_memory_of_the_guards(hand_fed):
    _, feed, _ = hand_fed('-p', 'state_timeout:=0.0')
    assert [feed(state(k, 0.5)) for k in (5, 6)] == pytest.approx([FRESH, ON])
    assert feed(state(7, 1e308)) == 0.0
    assert [feed(state(k, 0.5)) for k in (8, 9)] == pytest.approx([FRESH, ON])
    assert [feed(state(k, 0.5)) for k in (2, 3)] == pytest.approx([FRESH, ON])


@pytest.mark.parametrize('period', [1, 2])
def test_states_at_another_rate_than_time_step_are_an_error(hand_fed, client, period):
    process, feed, _ = hand_fed('-p', 'state_timeout:=0.0')
    diagnostics = client.listen('/diagnostics', DiagnosticArray)
    for k in range(120):
        feed(state(period * k, 0.5))
    text = 'states come every 0.002 s in the mean, where time_step = 0.001 s'
    client.spin_until(lambda: [one for array in diagnostics for one in array.status
                               if ('answered', '120') in [
                                   (value.key, value.value) for value in one.values]],
                      'a report')
    assert (text in process.output) == (period == 2)
    assert process.interrupt() == 0


def test_states_that_stay_away_make_a_zero_command_and_their_return_ends_it(hand_fed, client):
    process, feed, commands = hand_fed('-p', 'state_timeout:=0.05', '-p', 'effort_limit:=20.0')
    assert feed(state(0, 0.5)) == -20.0  # an impulse, most of which is yet to leave
    client.spin_until(lambda: any(one.effort[0] == 0.0 for one in commands), 'zero')
    process.says('no state for 0.05 s: 0 N is commanded')
    zeros = {(one.effort[0], stamp(one)) for one in commands if one.effort[0] == 0.0}
    assert zeros == {(0.0, 0)}
    assert feed(state(100, 0.5, -1.0)) == -4.5  # what was yet to leave is forgotten
    process.says('states are back')
    assert process.interrupt() == 0


def test_a_source_that_sends_the_same_for_ever_has_stopped(hand_fed, client):
    process, feed, commands = hand_fed('-p', 'state_timeout:=0.2')
    feed(state(0, 0.5))
    assert feed(state(1, 0.4)) != 0.0

    def same():
        feed.publisher.publish(state(1, 0.4))
        return len([one for one in commands if stamp(one) == 0]) > 2
    client.spin_until(same, '0 N')
    process.says('no state for 0.2 s: 0 N is commanded')
    assert len([one for one in commands if stamp(one) == stamp(state(1, 0.4))]) == 1


@pytest.mark.parametrize(('sec', 'nanosec', 'said'), [
    (0, 0, 'rejected a state with the stamp 0.000000000 s: that is none'),
    (1, 1_000_000, 'rejected a state with the stamp 1.001000000 s: so has the one before')])
def test_a_state_without_a_stamp_of_its_own_is_rejected(hand_fed, client, sec, nanosec, said):
    process, feed, commands = hand_fed('-p', 'state_timeout:=0.0')
    feed(state(0, 0.5))
    feed(state(1, 0.4))
    wrong = state(1, 0.3)
    wrong.header.stamp.sec, wrong.header.stamp.nanosec = sec, nanosec
    feed.publisher.publish(wrong)
    process.says(said)
    feed(state(2, 0.2))
    assert [stamp(one) for one in commands] == [stamp(state(k, 0.0)) for k in range(3)]


def test_a_free_plant_whose_states_no_longer_reach_the_controller_gets_zero(graph, client):
    plant = graph.start('plant_simulator', *COARSE, *FREE, '-r', 'joint_states:=measured')
    controller = graph.start('controller', *COARSE, '-p', 'state_timeout:=0.2')
    states = client.listen('/measured', JointState)
    relay = client.node.create_publisher(JointState, '/joint_states', 1000)

    def relayed():
        for one in states:
            relay.publish(one)
        moving = any(one.effort[0] for one in states)
        states.clear()
        return moving
    client.spin_until(relayed, 'efforts')
    client.spin_until(lambda: len(states) > 5 and all(
        one.effort[0] == 0.0 for one in states[-5:]), 'zero efforts')
    assert 'no state for 0.2 s' in controller.output
    for process in (plant, controller):
        assert process.interrupt() == 0


def test_a_controller_that_leaves_a_free_plant_leaves_no_effort_behind(graph, client):
    plant = graph.start('plant_simulator', *COARSE, *FREE)
    controller = graph.start('controller', *COARSE)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: any(one.effort[0] for one in states), 'efforts')
    assert controller.interrupt() == 0
    states.clear()
    client.spin_until(lambda: len(states) > 5 and states[-1].effort[0] == 0.0, 'zero efforts')
    plant.says('0 N is held')
    assert plant.interrupt() == 0


def test_a_plant_in_lockstep_that_is_paused_gets_no_zero_command(graph, client):
    plant = graph.start('plant_simulator', '--ros-args', '-p', 'real_time_factor:=0.05')
    controller = graph.start('controller', '--ros-args', '-p', 'state_timeout:=0.05')
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 10, 'states')
    assert client.call('/plant_simulator/pause', SetBool, data=True).success
    reports = client.listen('/diagnostics', DiagnosticArray)
    client.spin_until(lambda: sum(one.status[0].name == '/controller' for one in reports) > 2,
                      'two seconds of the controller')
    assert 'no state for' not in controller.output
    assert plant.interrupt() == 0
    assert controller.interrupt() == 0
    assert 'no state for' not in controller.output


def test_a_managed_controller_commands_only_while_it_is_active(graph, client):
    bag = graph.folder / 'bag'
    plant = graph.start('plant_simulator', config=UNDERDAMPED)
    controller = graph.start('controller', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                             'managed:=true')
    recorder = graph.start('recorder', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                           f'bag:={bag}')
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 1, 'a state that comes again')
    assert len({stamp(one) for one in states}) == 1
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'unconfigured'
    controller.says('no such change of state now')
    assert client.change_state(Transition.TRANSITION_CONFIGURE) == 'inactive'
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'active'
    client.spin_until(lambda: len(states) > 100, 'states')
    assert client.change_state(Transition.TRANSITION_DEACTIVATE) == 'inactive'
    last = client.call('/plant_simulator/pause', SetBool, data=False).message
    client.spin_until(lambda: plant.output.count('published again') > 1, 'an unanswered state')
    assert client.call('/plant_simulator/pause', SetBool, data=False).message == last
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'active'
    assert plant.wait() == 0, plant.output
    shut_down = client.node.create_client(ChangeState, '/controller/change_state')
    client.spin_until(shut_down.service_is_ready, 'the service')
    # not awaited: the node may have ended before the response is here
    shut_down.call_async(ChangeState.Request(
        transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)))
    client.spin_until(lambda: not controller.running, 'the end of the controller')
    assert controller.wait() == 0, controller.output
    assert recorder.interrupt() == 0
    run = read(bag)
    assert np.array_equal(run.states['stamp'], run.commands['stamp'])
    assert run.receipt['missing'] == '0'


def test_a_managed_controller_leaves_a_free_plant_without_effort(graph, client):
    plant = graph.start('plant_simulator', *COARSE, *FREE)
    controller = graph.start('controller', *COARSE, '-p', 'managed:=true')
    states = client.listen('/joint_states', JointState)
    client.activate()
    client.spin_until(lambda: any(one.effort[0] for one in states), 'efforts')
    assert client.change_state(Transition.TRANSITION_DEACTIVATE) == 'inactive'
    states.clear()
    client.spin_until(lambda: len(states) > 5 and states[-1].effort[0] == 0.0, 'zero efforts')
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'active'
    reports = client.listen('/diagnostics', DiagnosticArray)
    last = client.spin_until(lambda: [
        values for report in reports for status in report.status if status.name == '/controller'
        for values in [{one.key: one.value for one in status.values}]
        if status.message == 'answering'], 'a report')[-1]
    assert int(last['lost']) < 5  # what passed while it was not active is not counted
    for process in (plant, controller):
        assert process.interrupt() == 0
        assert 'Traceback' not in process.output


BROKEN = {
    'position nan': ({'position': [math.nan], 'velocity': [0.0]}, 'position nan'),
    'velocity inf': ({'position': [0.0], 'velocity': [math.inf]}, 'velocity inf'),
    'empty': ({}, "without position of joint 'axis'"),
    'short': ({'name': ['elbow', 'axis'], 'position': [1.0], 'velocity': [1.0, 2.0]},
              "without position of joint 'axis'"),
    'wrong joint': ({'name': ['elbow'], 'position': [1.0], 'velocity': [0.0]},
                    "without joint 'axis'"),
    'no joint': ({'name': [], 'position': [1.0], 'velocity': [0.0]}, "without joint 'axis'"),
    'garbage': (b'\x00\x01\x00\x00' + b'\xff' * 60, 'that cannot be decoded'),
}


@pytest.mark.parametrize('kind', BROKEN)
def test_a_broken_state_is_rejected_with_the_reason_and_the_next_is_answered(hand_fed, kind):
    fields, said = BROKEN[kind]
    process, feed, commands = hand_fed('-p', 'state_timeout:=0.0', '-p', 'impulses:=false')
    assert feed(state(0, 0.5)) == -5.0
    broken = state(1, 0.0)
    if isinstance(fields, bytes):
        broken = fields
    else:
        broken.position, broken.velocity, broken.effort = [], [], []
        for name, value in fields.items():
            setattr(broken, name, value)
    feed.publisher.publish(broken)
    process.says('rejected a state ')
    process.says(said)
    assert feed(state(2, 0.25)) == -2.5
    assert len(commands) == 2
    assert process.interrupt() == 0


def test_an_oversized_state_of_many_joints_is_answered_for_ours(hand_fed):
    process, feed, _ = hand_fed('-p', 'state_timeout:=0.0', '-p', 'impulses:=false')
    big = state(0, 0.0)
    big.name = [f'joint_{number}' for number in range(10_000)] + ['axis']
    big.position, big.velocity = [9.0] * 10_000 + [0.5], [9.0] * 10_000 + [1.0]
    big.effort = []
    assert feed(big) == -5.5
    assert process.interrupt() == 0


def test_a_clock_that_goes_back_starts_the_law_afresh(hand_fed):
    process, feed, commands = hand_fed('-p', 'state_timeout:=0.0', '-p', 'impulses:=false')
    assert feed(state(5, 0.5)) == -5.0
    assert feed(state(2, 0.25)) == -2.5
    process.says('joint_states went from 1.005000000 s to 1.002000000 s: started afresh')
    assert feed(state(3, 0.125)) == -1.25
    assert len(commands) == 3
    assert process.interrupt() == 0
