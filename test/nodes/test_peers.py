"""Nodes that do not fit each other, and others on the same topics."""

import itertools
import os
import signal

from mcap.reader import make_reader
import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from stereo_msgs.msg import DisparityImage

from impulse_control_ros.files.recording import read
from impulse_control_ros.nodes.graph import own_publisher, publishers
from impulse_control_ros.nodes.standby import SETTLE, SILENCE
from test.conftest import CONFIG, wait_for

UNDERDAMPED = CONFIG / 'underdamped.yaml'
STEPS = 20_000
RATE = 500  # commands a second of wall time


def assert_whole(run, start=1_000_000_000):
    stamps = start + np.arange(STEPS + 1) * 100_000
    assert np.array_equal(run.states['stamp'], stamps)
    assert np.array_equal(run.commands['stamp'], stamps)
    assert run.receipt['missing'] == '0'


@pytest.mark.parametrize(('wrong', 'said'), [
    ('time_step:=0.001', 'time_step = 0.001 is refused: allowed is that of /plant_simulator'),
    ('joint_name:=elbow', "joint_name = 'elbow' is refused: allowed is that of /plant_simulator"),
])
def test_a_controller_for_another_plant_ends_and_the_run_waits_for_the_right_one(
        graph, wrong, said):
    plant = graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.1')
    controller = graph.start('controller', '--ros-args', '-p', wrong)
    assert controller.wait() == 2
    assert said in controller.output
    controller = graph.start('controller')
    assert plant.wait() == 0, plant.output
    assert controller.interrupt() == 0


def test_composed_nodes_that_do_not_fit_are_refused_and_leave_no_bag(graph):
    bag = graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                          f'recorder:bag:={bag}', '-p', 'controller:time_step:=0.001')
    assert process.wait() == 2
    assert 'time_step = 0.001' in process.output
    assert not bag.exists()


def test_a_loop_that_diverges_ends_with_the_reason_and_a_finished_bag(graph):
    bag = graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                          f'recorder:bag:={bag}', '-p', 'controller:K:=1.0e9')
    assert process.wait() == 1
    assert 'the loop has diverged: at 1.' in process.output
    assert 'Traceback' not in process.output
    run = read(bag)
    assert run.receipt['missing'] == '0'
    assert np.isfinite(run.states['position']).all()


def test_an_experiment_runs_in_a_namespace_and_on_other_topics(graph):
    extra = graph.folder / 'bag.yaml'
    extra.write_text('/**/recorder:\n  ros__parameters:\n    topics: []\n'
                     f'    bag: {graph.folder / "bag"}\n')
    process = graph.start('closed_loop', '--ros-args', '-r', '__ns:=/left', '-r',
                          'joint_states:=measured', '--params-file', UNDERDAMPED,
                          '--params-file', extra)
    assert process.wait() == 0, process.output
    run = read(graph.folder / 'bag')
    assert_whole(run)
    assert run.parameters['/left/plant_simulator']['F_c'] == 0.0


def test_parameters_that_miss_the_nodes_are_named(graph):
    plain = graph.folder / 'plain.yaml'
    plain.write_text(UNDERDAMPED.read_text().replace('/**/', ''))
    process = graph.start('closed_loop', '--ros-args', '-r', '__ns:=/left', config=plain)
    assert process.wait() == 2
    assert 'is the name of none of /left/plant_simulator' in process.output
    alone = graph.start('controller', '--ros-args', '-r', '__ns:=/left', config=plain)
    alone.says('is the name of none of /left/controller')
    assert alone.interrupt() == 0


def test_foreign_joint_states_leave_a_recording_whole(graph, client):
    bag = graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                          f'recorder:bag:={bag}', '-p', 'plant_simulator:real_time_factor:=0.15')
    states = client.listen('/joint_states', JointState)
    publisher = client.node.create_publisher(JointState, '/joint_states', 10)
    client.spin_until(lambda: len(states) > 100, 'states')
    client.spin_until(lambda: publisher.get_subscription_count() >= 3, 'all that hear states')
    for _ in range(3):
        publisher.publish(JointState(name=['elbow'], position=[1.0], velocity=[2.0]))
    assert process.wait() == 0, process.output
    run = read(bag)
    assert_whole(run)
    assert int(run.receipt['foreign']) + int(run.receipt['repeated']) == 3
    assert not bag.with_name('bag-2').exists()


def test_named_topics_are_recorded_once_and_what_is_latched_from_its_beginning(graph):
    bag = graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                          f'recorder:bag:={bag}', '-p', 'recorder:topics:=[joint_states,/rosout]')
    assert process.wait() == 0, process.output
    with (bag / 'bag_0.mcap').open('rb') as stream:
        summary = make_reader(stream).get_summary()
    counts = {channel.topic: summary.statistics.channel_message_counts.get(number, 0)
              for number, channel in summary.channels.items()}
    assert counts.keys() == {'/joint_states', '/joint_commands', '/impulse_events', '/rosout'}
    assert counts['/joint_states'] == 20_001
    assert counts['/rosout'] > 0
    assert len(summary.channels) == 4


def test_two_recorders_of_one_name_both_miss_nothing(graph):
    bags = [graph.folder / name for name in ('first', 'second')]
    recorders = [graph.start('recorder', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                             f'bag:={bag}') for bag in bags]
    controller = graph.start('controller', config=UNDERDAMPED)
    plant = graph.start('plant_simulator', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                        'real_time_factor:=0.2')
    assert plant.wait() == 0, plant.output
    for recorder, bag in zip(recorders, bags, strict=True):
        assert recorder.interrupt() == 0
        run = read(bag)
        assert run.receipt['missing'] == '0'
        assert run.states['stamp'][-1] == run.commands['stamp'][-1] == 3_000_000_000
    assert controller.interrupt() == 0


def test_a_plant_that_starts_later_begins_a_bag_of_the_next_free_number(graph):
    bag = graph.folder / 'bag'
    bag.with_name('bag-2').mkdir()
    recorder = graph.start('recorder', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                           f'bag:={bag}')
    controller = graph.start('controller', config=UNDERDAMPED)
    for start in ('1.0', '4.5'):
        plant = graph.start('plant_simulator', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                            f'start_time:={start}')
        assert plant.wait() == 0, plant.output
    assert recorder.interrupt() == 0
    assert controller.interrupt() == 0
    assert_whole(read(bag))
    assert_whole(read(bag.with_name('bag-3')), 4_500_000_000)
    assert not list(bag.with_name('bag-2').iterdir())


@pytest.mark.parametrize('bag', ['/proc/nowhere/bag', 'b' * 300])
def test_a_bag_that_cannot_be_made_is_refused_at_once(graph, bag):
    process = graph.start('recorder', '--ros-args', '-p', f'bag:={bag}')
    assert process.wait() == 2
    assert 'cannot be made' in process.output
    assert len(process.output.splitlines()) == 1


def test_the_states_of_a_second_plant_are_neither_answered_nor_a_run_of_their_own(graph, client):
    bag = graph.folder / 'bag'
    process = graph.start('closed_loop', '--ros-args', '--params-file', UNDERDAMPED, '-p',
                          f'recorder:bag:={bag}', '-p', 'plant_simulator:real_time_factor:=0.15')
    publisher = client.node.create_publisher(JointState, '/joint_states', 10)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 100, 'states')
    # what makes a plant: it publishes states and hears of recorders
    progress = client.listen('/recorder_progress', Header)
    client.spin_until(lambda: progress and publisher.get_subscription_count() >= 3, 'peers')
    message = JointState(name=['axis'], position=[1.0], velocity=[0.0], effort=[0.0])
    message.header.stamp.sec, message.header.frame_id = 1, 'reset'
    publisher.publish(message)
    process.says('two plants publish /joint_states: the state at 1.000000000 s is not answered')
    assert process.wait() == 0, process.output
    assert 'started afresh' not in process.output
    run = read(bag)
    assert_whole(run)
    assert run.receipt['foreign'] == '1'
    assert not bag.with_name('bag-2').exists()


def test_a_publisher_that_is_discovered_meanwhile_is_not_taken_for_our_own(client, monkeypatch):
    create = client.node.create_publisher

    def create_beside_another(*arguments):
        monkeypatch.undo()
        create(*arguments)
        return create(*arguments)

    monkeypatch.setattr(client.node, 'create_publisher', create_beside_another)
    publisher, own = own_publisher(client.node, JointState, 'states', 1)
    assert len(own) == 1
    client.node.destroy_publisher(publisher)
    assert len(publishers(client.node, '/states').keys() - own) == 1


def test_of_two_plants_that_wait_for_a_controller_one_goes_first(graph):
    plants = [graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.1') for _ in '12']
    for plant in plants:
        plant.says('another plant')
    controller = graph.start('controller')
    for plant in plants:
        assert plant.wait() == 0, plant.output
    assert controller.interrupt() == 0


def test_a_second_controller_is_named_before_the_run(graph):
    first, second = graph.start('controller'), graph.start('controller', '--ros-args', '-r',
                                                           '__node:=other')
    plant = graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.01', '-p',
                        'wait_for_recorder:=true')
    plant.says('waiting for all but one of 2 controllers to leave /joint_commands (/')
    assert '/other' in plant.output
    assert '/controller' in plant.output
    assert second.interrupt() == 0
    recorder = graph.start('recorder', '--ros-args', '-p', f'bag:={graph.folder / "bag"}')
    assert plant.wait() == 0
    assert first.interrupt() == recorder.interrupt() == 0


def beside_a_first(graph, client, *plant_arguments):
    """Start a slow plant, its controller and, when that has settled, one that stands by."""
    plant = graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.0', '-p',
                        f'real_time_factor:={RATE * 1e-4}', *plant_arguments)
    commands = client.listen('/joint_commands', JointState)
    first = graph.start('controller', '--ros-args', '-p', 'impulses:=false')
    client.spin_until(lambda: len(commands) > (SETTLE + 1.0) * RATE, 'commands')
    second = graph.start('controller', '--ros-args', '-r', '__node:=other', '-p',
                         'impulses:=false')
    second.says('/controller is another controller of /joint_states: standing by')
    return plant, first, second, commands


def stamp_of(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def answered_once(client, commands, count=300):
    """Wait for more commands; tell whether each of the last ones answers a state of its own."""
    enough = len(commands) + 1000 + count  # 1000 may have waited here
    client.spin_until(lambda: len(commands) > enough, 'commands')
    stamps = [stamp_of(one) for one in commands[-count:]]
    return len(stamps) == len(set(stamps))


def assert_replaced_while_stopped(client, first, second, commands):
    """Stop the first controller until the second has taken over; then it stands by."""
    first.send(signal.SIGSTOP)
    second.says('no other controller answers: taking over')
    assert answered_once(client, commands)
    first.send(signal.SIGCONT)
    first.says('/other is another controller of /joint_states: standing by')
    assert answered_once(client, commands)


def test_a_second_controller_stands_by_and_takes_over_from_one_that_is_killed(graph, client):
    plant, first, second, commands = beside_a_first(graph, client)
    plant.says('2 controllers publish /joint_commands: of the commands of /')
    states = client.listen('/joint_states', JointState)
    assert client.set('other', K=20.0).successful
    assert answered_once(client, commands)
    first.kill()
    second.says('no other controller answers: taking over')
    assert answered_once(client, commands)
    by_stamp = {stamp_of(one): one for one in states}
    last = commands[-10]
    state = by_stamp[stamp_of(last)]
    assert last.effort[0] == -20.0 * state.position[0] - 0.5 * state.velocity[0]
    assert plant.interrupt() == second.interrupt() == 0


def test_a_controller_that_was_stopped_stands_by_for_the_one_that_took_over(graph, client):
    plant, first, second, commands = beside_a_first(graph, client)
    assert_replaced_while_stopped(client, first, second, commands)
    assert second.interrupt() == 0
    first.says('no other controller answers: taking over')
    assert answered_once(client, commands)
    assert plant.interrupt() == first.interrupt() == 0


def test_the_parameters_of_a_controller_that_never_answers_are_not_in_the_bag(graph, client):
    bag = graph.folder / 'bag'
    plant, first, second, commands = beside_a_first(graph, client)
    assert second.interrupt() == 0
    recorder = graph.start('recorder', '--ros-args', '-p', f'bag:={bag}')
    recorder.says('recording into')
    namesake = graph.start('controller', '--ros-args', '-p', 'K:=99.0')
    namesake.says('another controller of /joint_states: standing by')
    assert answered_once(client, commands)
    assert answered_once(client, commands)
    for process in (namesake, plant, first, recorder):
        assert process.interrupt() == 0
    run = read(bag)
    assert not [change for change in run.changes if change.anew]
    assert run.parameters['/controller']['K'] == 10.0
    assert run.receipt['missing'] == '0'


def test_of_two_that_stand_by_one_takes_over(graph, client):
    plant, first, second, commands = beside_a_first(graph, client)
    third = graph.start('controller', '--ros-args', '-r', '__node:=third', '-p',
                        'impulses:=false')
    third.says('another controller of /joint_states: standing by')
    first.kill()
    wait_for(lambda: 'taking over' in second.output + third.output, 'taking over')
    # both take over where they have not discovered each other; then they hear each other
    wait_for(lambda: answered_once(client, commands), 'one that answers')
    last = [one.output.rstrip().endswith('taking over') for one in (second, third)]
    assert last.count(True) == 1
    for process in (plant, second, third):
        assert process.interrupt() == 0


def test_beside_a_free_plant_a_second_controller_stands_by_and_sends_nothing(graph, client):
    plant, first, second, commands = beside_a_first(
        graph, client, '-p', 'lockstep:=false', '-p', 'time_step:=0.0001')
    assert answered_once(client, commands)
    for paused in (True, False):  # without states there is nothing to answer
        assert client.call('/plant_simulator/pause', SetBool, data=paused).success
        client.spin_for(1.5 * SILENCE)
    assert 'taking over' not in second.output
    commands.clear()
    assert_replaced_while_stopped(client, first, second, commands)
    assert first.interrupt() == 0
    assert not [one for one in commands if one.header.stamp.sec == 0]  # no zero in between
    assert second.interrupt() == plant.interrupt() == 0


def test_of_two_controllers_that_start_beside_a_free_plant_one_answers(graph, client):
    names = ('controller', 'other')
    controllers = [graph.start('controller', '--ros-args', '-r', f'__node:={name}', '-p',
                               'time_step:=0.001') for name in names]
    publisher = client.node.create_publisher(JointState, '/joint_states', 10)
    commands = client.listen('/joint_commands', JointState)
    client.spin_until(lambda: publisher.get_subscription_count() == 2
                      and client.node.count_publishers('/joint_commands') == 2, 'both')
    states = itertools.count(1)

    def feed():
        message = JointState(name=['axis'], position=[0.5], velocity=[0.0], effort=[0.0])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            next(states) * 1_000_000, 10**9)
        publisher.publish(message)
        stamps = [stamp_of(one) for one in commands[-300:]]
        return len(set(stamps)) == 300
    client.spin_until(feed, 'one answer to each state')
    stands_by = 'is another controller of /joint_states: standing by'
    assert any(stands_by in one.output for one in controllers)
    for controller in controllers:
        assert controller.interrupt() == 0


def test_the_damping_of_a_bag_stands_at_the_state_it_was_published_after(graph):
    bag, config = graph.folder / 'bag', CONFIG / 'time_varying.yaml'
    plant = graph.start('plant_simulator', '--ros-args', '--params-file', config, '-p',
                        'duration:=0.5')
    controller = graph.start('controller', config=config)
    recorder = graph.start('recorder', '--ros-args', '--params-file', config, '-p', f'bag:={bag}')
    assert plant.wait() == 0
    for process in (recorder, controller):
        assert process.interrupt() == 0
    with (bag / 'bag_0.mcap').open('rb') as stream:
        stamps = [message.publish_time for _, _, message in make_reader(stream).iter_messages(
            topics='/damping')]
    assert stamps == [1_000_000_000 + k * 1_000_000 for k in range(1, 501)]


def test_a_topic_whose_type_is_not_installed_is_named_and_the_rest_recorded(graph, client):
    (graph.folder / 'stereo_msgs').mkdir()
    (graph.folder / 'stereo_msgs' / '__init__.py').touch()  # hides the installed one
    client.node.create_publisher(DisparityImage, '/odd', 10)
    plant = graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.5', '-p',
                        'wait_for_recorder:=true')
    graph.environment = {**os.environ, 'PYTHONPATH': str(graph.folder)}
    recorder = graph.start('recorder', '--ros-args', '-p', f'bag:={graph.folder / "bag"}', '-p',
                           'topics:=[/odd]')
    recorder.says("/odd is not recorded: message type 'stereo_msgs/msg/DisparityImage' is not "
                  'installed')
    controller = graph.start('controller')
    assert plant.wait() == 0
    for process in (recorder, controller):
        assert process.interrupt() == 0
    assert len(read(graph.folder / 'bag').states) == 5001


def test_a_second_plant_waits_until_the_first_has_left(graph, client):
    first = graph.start('plant_simulator', '--ros-args', '-p', 'real_time_factor:=0.1')
    controller = graph.start('controller')
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 10, 'states')
    second = graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.1')
    second.says('waiting for another plant to leave /joint_states')
    assert first.interrupt() == 0
    assert second.wait() == 0, second.output
    assert controller.interrupt() == 0


def test_a_plant_that_began_before_it_discovered_another_one_waits_again(graph, client):
    states = client.listen('/joint_states', JointState)
    commands = client.node.create_publisher(JointState, '/joint_commands', 10)
    plant = graph.start('plant_simulator', '--ros-args', '-p', 'duration:=0.001')
    client.spin_until(lambda: states, 'the first state')

    def answer_another():
        message = JointState(name=['axis'], effort=[0.0])
        message.header.stamp.sec = 5
        commands.publish(message)
        return 'answers another plant: waiting for it to leave' in plant.output
    client.spin_until(answer_another, 'another plant')
    while plant.running:
        client.spin_until(lambda: states or not plant.running, 'a state')
        for state in states:
            commands.publish(JointState(header=state.header, name=['axis'], effort=[0.0]))
        states.clear()
    assert plant.wait() == 0, plant.output
    assert plant.output.count('running from 1.000000000 s') == 2
    assert '10 steps, 11 accepted' in plant.output


def test_a_free_plant_starts_anew_beside_a_controller_that_has_no_states(graph):
    free = ('--ros-args', '-p', 'lockstep:=false', '-p', 'real_time_factor:=0.1', '-p',
            'time_step:=0.001')
    controller = graph.start('controller', '--ros-args', '-p', 'time_step:=0.001')
    for _ in range(2):
        plant = graph.start('plant_simulator', *free)
        plant.says('running from')
        controller.says('answering /plant_simulator')
        assert plant.interrupt() == 0
        controller.says('0 N is commanded')
    assert controller.interrupt() == 0
