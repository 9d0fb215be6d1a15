"""States and commands that are too old, in a relay that queues or by their stamps."""

from collections import deque
import time

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import assert_replays, stamp_of

HELD = -0.5  # N at x_0, where friction holds the axis whatever the delay
GAINS = {'time_step': 0.05, 'impulses': False}
PLANT = {
    'time_step': 0.05,
    'x_0': 0.05,
    'lockstep': False,
    'real_time_factor': 10.0,  # 200 samples a second
}
LIMIT = 10.0  # s of simulated time, one of wall time


class Relay:
    """Passes the states of a plant on; it falls behind while it ``queues``."""

    def __init__(self, graph, client, is_foreign, *heard_by):
        self._client, self._is_foreign = client, is_foreign
        self.plant = graph.start(
            'plant_simulator', '--ros-args', '-r', 'joint_states:=measured', **PLANT
        )
        self.measured = client.listen('/measured', JointState)
        self._output = client.publisher('/joint_states', JointState, *heard_by)
        self._queue, self._count, self.queues = deque(), 0, False

    def turn(self):
        """Pass on a state for each that has come, or for one in four."""
        if not self.queues:
            self._queue.clear()
        while self._count < len(self.measured):
            self._queue.append(self.measured[self._count])
            self._count += 1
            if not self.queues or self._count % 4 == 0:
                state = self._queue.popleft()
                if self._is_foreign:
                    state.header.frame_id = ''
                self._output.publish(state)

    def until_applied(self, effort, condition=lambda: True):
        """Serve until the plant has just applied an ``effort``, and a condition holds."""
        begun = len(self.measured)

        def is_applied():
            self.turn()
            last = [state.effort[0] for state in self.measured[begun:]][-5:]
            return last == [effort] * 5 and condition()

        self._client.spin_until(is_applied, f'{effort} N')


def test_a_plant_drops_commands_that_a_deep_queue_has_made_too_old(graph, client):
    relay = Relay(graph, client, False)
    controller = graph.start('controller', **GAINS, max_age=LIMIT)
    relay.until_applied(HELD)
    controller.says('max_age has no effect on the states of /plant_simulator')
    relay.queues = True
    assert client.set('plant_simulator', max_age=LIMIT).successful
    relay.until_applied(0.0, lambda: client.count_of('plant_simulator', 'old'))
    relay.plant.says('s old, max_age = 10 s')
    relay.queues = False
    relay.until_applied(HELD)
    for process in (controller, relay.plant):
        assert process.interrupt() == 0, process.output


def test_a_controller_counts_states_as_lost_that_a_deep_queue_has_made_too_old(graph, client):
    bag = graph.folder / 'bag'
    recorder = graph.start('recorder', bag=bag)
    relay = Relay(graph, client, True, 'recorder')
    controller = graph.start(
        'controller', **GAINS, max_age=LIMIT, state_timeout=0.2, use_sim_time=True
    )
    relay.until_applied(HELD, lambda: client.count_of('recorder', 'written'))
    relay.queues = True
    relay.until_applied(0.0, lambda: client.count_of('controller', 'old'))
    controller.says('s old, max_age = 10 s')
    relay.queues = False
    relay.until_applied(HELD)
    assert client.count_of('controller', 'rejected') == 0
    for process in (recorder, controller, relay.plant):
        assert process.interrupt() == 0, process.output
    run = read_bag(bag)
    assert 0 < np.isin(run.states['stamp'], run.commands['stamp']).sum() < len(run.states)
    assert int(run.recording_summary['missing']) > 0
    assert_replays(bag, '--controller')


@pytest.fixture
def feed(graph, client):
    """A controller with a limit of ten minutes, and what sends it a state of a robot."""
    process = graph.start('controller', **GAINS, max_age=600.0, state_timeout=0.2)
    commands = client.listen('/joint_commands', JointState)
    publisher = client.publisher('/joint_states', JointState, 'controller')

    def send(stamp_ns):
        message = JointState(name=['axis'], position=[0.05], velocity=[0.0])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)
        publisher.publish(message)
        return {stamp_of(one) for one in commands}

    yield process, send
    assert process.interrupt() == 0, process.output


def test_a_state_of_an_hour_ago_is_lost_by_the_wall_clock(feed, client):
    controller, send = feed
    now = time.time_ns()
    client.spin_until(lambda: now in send(now), 'the command for a state of now')
    old = now - 3600 * SECOND

    def is_zero():
        stamps = send(old)
        return client.count_of('controller', 'old') and 0 in stamps

    client.spin_until(is_zero, '0 N')
    assert old not in send(old)
    controller.says('max_age = 600 s')
    assert client.set('controller', max_age=0.0).successful
    client.spin_until(lambda: old in send(old), 'the command for any state')


def test_stamps_that_are_not_on_the_clock_are_answered_and_reported(feed, client):
    controller, send = feed
    stamp = 5 * SECOND
    client.spin_until(lambda: stamp in send(stamp), 'a command')
    controller.says('behind the clock, so ages are unknown: max_age = 600 s has no effect')
    assert client.reported('controller')['old'] == '0'
