"""Which controller acts: two of them, one that is switched off, and one that is not ours."""

from collections import Counter, defaultdict
import math

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import pytest
from sensor_msgs.msg import JointState

from impulse_control_ros.core.protocol import FOREIGN, parse_command, parse_state
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import (
    assert_replays,
    assert_whole,
    PACED,
    Run,
    stamp_of,
    START,
    start_as,
    STEP,
    UNDERDAMPED,
)


@pytest.mark.parametrize(
    'number', [0, *(pytest.param(number, marks=pytest.mark.soak) for number in range(1, 50))]
)
def test_of_two_controllers_that_start_at_once_one_acts_and_the_other_is_silent(
    graph, client, number
):
    commands = client.listen('/joint_commands', JointState)
    controllers = [start_as(graph, name, 'controller') for name in ('one', 'two')]
    plant = graph.start(
        'plant_simulator',
        config=UNDERDAMPED,
        wait_for_recorder=True,
        duration=0.05,
        command_timeout=60.0,
    )
    client.spin_until(lambda: client.node.count_publishers('/joint_commands') == 2, 'both')
    bag = graph.folder / 'bag'
    recorder = graph.start('recorder', config=UNDERDAMPED, bag=bag)
    client.spin_until(lambda: not plant.running, 'the end')
    assert plant.wait() == 0, plant.output
    assert plant.totals['steps'] == 500
    assert plant.totals['accepted'] == 501
    for process in (recorder, *controllers):
        assert process.interrupt() == 0, process.output
    run = read_bag(bag)
    assert len(run.commands) == 501
    assert_whole(run)
    assert_replays(bag)
    # a second one may have answered the first state, which names nobody, and none after that
    (author,) = {change.node_id for change in run.controllers}
    heard = defaultdict(set)
    for command in commands:
        heard[stamp_of(command) == START].add(parse_command(command.header.frame_id).author)
    assert heard[False] == {author}


def test_a_controller_that_stands_by_sends_nothing_however_the_run_is_disturbed(graph, client):
    run = Run(graph, client, plant_simulator={'command_timeout': 60.0})
    commands = client.listen('/joint_commands', JointState)
    other = run.start('controller', 'other')
    client.spin_until(lambda: client.count_of('other', 'standby'), 'who stands by')
    assert client.set('plant_simulator', real_time_factor=0.5).successful
    assert client.set('controller', x_r=0.1).successful
    run.reach(500)
    assert {parse_command(one.header.frame_id).author for one in commands} == {run.active}
    assert 'standing by' in client.reports('other')['message']
    assert other.interrupt() == 0
    run.reach(50)
    assert_whole(run.finish())
    assert_replays(run.bag)


def test_a_controller_for_another_plant_ends_and_the_run_waits_for_the_right_one(graph):
    plant = graph.start('plant_simulator', duration=0.01)
    wrong = {'time_step': 0.001, 'joint_name': 'elbow'}
    for name, process in {
        name: graph.start('controller', **{name: value}) for name, value in wrong.items()
    }.items():
        assert process.wait() == 2
        assert name in process.output.splitlines()[-1]
    assert plant.running
    controller = graph.start('controller')
    assert plant.wait() == 0, plant.output
    assert plant.totals['accepted'] == 101
    assert controller.interrupt() == 0


class ForeignController:
    """Somebody's own controller: it answers each state that the client hears with an effort."""

    def __init__(self, client, frame_id):
        self.answers = True
        self._client, self._frame_id = client, frame_id
        self._publisher = client.node.create_publisher(JointState, '/joint_commands', 1000)
        client.node.create_subscription(JointState, '/joint_states', self._on_state, 1000)

    def _on_state(self, state):
        if self.answers:
            self.send(state.header.stamp, [-state.position[0]])

    def send(self, stamp, effort):
        command = JointState(name=['axis'], effort=effort)
        command.header.stamp, command.header.frame_id = stamp, self._frame_id
        self._publisher.publish(command)


def test_a_foreign_controller_in_lockstep_drives_the_plant_and_ours_stands_by(graph, client):
    states = client.listen('/joint_states', JointState)
    plant = graph.start('plant_simulator', config=UNDERDAMPED, wait_for_recorder=False, **PACED)
    client.spin_until(lambda: states, 'a state')
    foreign = ForeignController(client, 'base_link')
    foreign.answers = False

    def passed():  # as ros2_control sends it while no controller is active
        foreign.send(states[-1].header.stamp, [math.nan])
        return stamp_of(states[-1]) > START + 5 * STEP

    client.spin_until(passed, 'states answered without an effort')
    assert {state.effort[0] for state in states} == {0.0}
    begun = stamp_of(states[-1])
    foreign.answers = True
    client.spin_until(lambda: stamp_of(states[-1]) > START + 100 * STEP, 'steps')
    ours = graph.start('controller', config=UNDERDAMPED)
    client.spin_until(lambda: client.count_of('controller', 'standby'), 'who stands by')
    by_stamp = {stamp_of(state): state for state in states}
    driven = [by_stamp[stamp] for stamp in sorted(by_stamp)]
    assert parse_state(driven[0].header.frame_id).controller == ''
    assert {parse_state(one.header.frame_id).controller for one in driven[1:]} == {FOREIGN}
    moved = [one for one in driven if stamp_of(one) >= begun]
    assert [after.effort[0] for after in moved[2:]] == [-one.position[0] for one in moved[1:-1]]
    foreign.answers = False
    client.spin_until(
        lambda: parse_state(states[-1].header.frame_id).controller.startswith('/controller#'),
        'ours',
    )
    assert plant.interrupt() == ours.interrupt() == 0
    assert plant.totals['accepted'] - plant.totals['steps'] in (0, 1)


def test_a_managed_controller_commands_only_while_it_is_active(graph, client):
    states = client.listen('/joint_states', JointState)
    bag = graph.folder / 'bag'
    plant = graph.start(
        'plant_simulator',
        config=UNDERDAMPED,
        wait_for_recorder=True,
        duration=0.5,
        real_time_factor=0.1,
    )
    controller = graph.start('controller', config=UNDERDAMPED, lifecycle=True)
    recorder = graph.start('recorder', config=UNDERDAMPED, bag=bag)
    client.spin_until(lambda: len(states) > 3, 'a state that comes again')
    assert len({stamp_of(one) for one in states}) == 1
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'unconfigured'
    assert client.change_state(Transition.TRANSITION_CONFIGURE) == 'inactive'
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'active'
    client.spin_until(lambda: stamp_of(states[-1]) > START, 'steps')
    assert client.change_state(Transition.TRANSITION_DEACTIVATE) == 'inactive'
    client.spin_until(
        lambda: Counter(map(stamp_of, states))[stamp_of(states[-1])] > 5,
        'a state that nobody answers',
    )
    assert client.change_state(Transition.TRANSITION_ACTIVATE) == 'active'
    assert client.set('plant_simulator', real_time_factor=0.0).successful
    assert plant.wait() == 0, plant.output
    assert client.call(
        '/controller/change_state',
        ChangeState,
        once=True,
        transition=Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN),
    ).success
    assert controller.wait() == 0, controller.output
    for state in ('unconfigured', 'inactive', 'active', 'finalized'):
        assert f'lifecycle state: {state}' in controller.output
    assert recorder.interrupt() == 0
    run = read_bag(bag)
    assert len(run.states) == len(run.commands) == 5001
    assert_whole(run)
    assert [change.anew for change in run.controllers] == [True, True]
    assert_replays(bag)
