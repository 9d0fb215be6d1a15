"""Processes that die in the middle of a run, and what is left of it."""

from contextlib import suppress
import signal

from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.experiment import read_experiment
from impulse_control_ros.files.recording import read
from test.conftest import CONFIG

UNDERDAMPED = CONFIG / 'underdamped.yaml'
STEPS = 20_000


class Running:
    """Three processes on underdamped.yaml, and how far they are."""

    def __init__(self, graph, client):
        self.graph, self.client = graph, client
        graph.share_no_memory()
        self.bag = graph.folder / 'bag'
        self.states = client.listen('/joint_states', JointState)
        self.plant = self.start('plant_simulator')
        self.controller = self.start('controller')
        # The run may be over before a client is discovered: let it wait for the recorder so long.
        client.spin_until(lambda: client.node.count_publishers('/joint_states'), 'the plant')
        self.recorder = self.start('recorder', '--ros-args', '-p', f'bag:={self.bag}')

    def start(self, name, *arguments):
        return self.graph.start(name, *arguments, config=UNDERDAMPED)

    def reach(self, seconds):
        """Serve until a state of so many simulated seconds has been seen."""
        def reached():
            if not self.states:
                return False
            stamp = self.states[-1].header.stamp
            return stamp.sec + stamp.nanosec * 1e-9 >= 1.0 + seconds
        self.client.spin_until(reached, f'{seconds} s of simulated time')

    def finish(self, bag=None):
        """Wait for the end of the run; returns the recording."""
        assert self.plant.wait() == 0, self.plant.output
        assert self.recorder.interrupt() == 0, self.recorder.output
        assert self.controller.interrupt() == 0, self.controller.output
        for process in (self.plant, self.recorder, self.controller):
            assert 'Traceback' not in process.output
        return read(bag or self.bag)


@pytest.fixture
def running(graph, client):
    return Running(graph, client)


STAMPS = 1_000_000_000 + np.arange(STEPS + 1) * 100_000


def assert_whole(run):
    assert np.array_equal(run.states['stamp'], STAMPS)
    assert np.array_equal(np.unique(run.commands['stamp']), STAMPS)
    assert run.receipt['missing'] == '0'


def test_a_killed_and_restarted_controller_costs_no_step(running):
    running.reach(0.3)
    running.controller.send(signal.SIGKILL)
    running.controller.wait()
    running.plant.says('published again')
    running.controller = running.graph.start('controller', '--ros-args', '--params-file',
                                             UNDERDAMPED, '-p', 'd_bar:=1.25')
    run = running.finish()
    assert np.array_equal(run.states['stamp'], STAMPS)
    # What a killed process has sent may reach the plant and not the recorder: it is counted, and
    # the effort that it asked for is in the next state.
    stamps, index = np.unique(run.commands['stamp'], return_index=True)
    assert int(run.receipt['missing']) == len(STAMPS) - len(stamps)
    ticks = np.searchsorted(STAMPS, stamps)[:-1]
    efforts = run.commands['effort'][index[:-1]]
    assert np.array_equal(run.states['effort'][ticks + 1], efforts)
    assert abs(run.states['position'][-1]) < 1e-6
    # its parameter events may be in the bag too
    change, = (change for change in run.changes if change.anew)
    assert change.anew
    assert run.parameters[change.node]['d_bar'] == 1.5
    assert change.values['d_bar'] == 1.25
    assert 1_300_000_000 <= change.stamp < 3_000_000_000


def test_a_free_running_plant_holds_the_effort_of_a_killed_controller_and_says_so(graph, client):
    graph.share_no_memory()
    coarse = ('--ros-args', '-p', 'time_step:=0.001')
    plant = graph.start('plant_simulator', *coarse, '-p', 'lockstep:=false', '-p',
                        'real_time_factor:=0.1')
    controller = graph.start('controller', *coarse)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 100, 'a hundred states')
    controller.send(signal.SIGKILL)
    controller.wait()
    plant.says('N is held')
    del states[:-1]
    client.spin_until(lambda: len(states) > 10, 'more states')
    assert len({state.effort[0] for state in states[-5:]}) == 1
    controller = graph.start('controller', *coarse, '-p', 'x_r:=-0.5')
    client.spin_until(lambda: len({state.effort[0] for state in states[-5:]}) > 1, 'new efforts')
    assert plant.interrupt() == 0
    assert controller.interrupt() == 0


def test_a_controller_that_is_stopped_and_goes_on_costs_no_step_and_no_bit(running):
    running.reach(0.05)
    running.controller.send(signal.SIGSTOP)
    running.plant.says('published again')
    running.controller.send(signal.SIGCONT)
    run = running.finish()
    assert 'rejected' not in running.controller.output  # what comes again is answered again
    assert_whole(run)
    experiment = read_experiment(UNDERDAMPED)
    alone = simulate(experiment.plant_simulator, experiment.controller, 2.0)
    assert run.states['position'].tobytes() == alone.position.tobytes()


def test_a_restarted_plant_makes_a_whole_new_run_in_a_bag_of_its_own(running):
    running.reach(0.3)
    running.plant.send(signal.SIGKILL)
    running.plant.wait()
    running.plant = running.start('plant_simulator')
    running.controller.says('started afresh')
    run = running.finish(running.bag.with_name('bag-2'))
    assert_whole(run)
    experiment = read_experiment(UNDERDAMPED)
    alone = simulate(experiment.plant_simulator, experiment.controller, 2.0)
    assert run.states['position'].tobytes() == alone.position.tobytes()
    assert run.commands['effort'].tobytes() == alone.effort.tobytes()
    first = read(running.bag)
    assert first.receipt['missing'] == '0'
    assert first.states['position'].tobytes() == alone.position[:len(first.states)].tobytes()


def test_a_stopped_recorder_holds_the_run_and_loses_nothing(running):
    running.reach(0.3)
    running.recorder.send(signal.SIGSTOP)
    running.reach(0.35)
    running.recorder.send(signal.SIGCONT)
    assert_whole(running.finish())


def test_what_a_killed_recorder_has_written_reads_back_and_the_run_goes_on(running):
    running.reach(1.0)
    running.recorder.send(signal.SIGKILL)
    running.recorder.wait()
    running.plant.says('has left')
    assert running.plant.wait() == 0
    running.controller.interrupt()
    run = read(running.bag)
    assert run.receipt == {}
    assert len(run.states) > 5_000
    assert np.array_equal(run.states['stamp'],
                          1_000_000_000 + np.arange(len(run.states)) * 100_000)
    messages = 0
    with (running.bag / 'bag_0.mcap').open('rb') as stream, suppress(EndOfFile):
        for record in StreamReader(stream).records:
            messages += isinstance(record, Message)
    assert messages >= 2 * len(run.states)


def test_a_recorder_started_anew_under_the_same_name_is_waited_for(running):
    running.reach(0.5)
    running.recorder.send(signal.SIGKILL)
    running.recorder.wait()
    bag = running.graph.folder / 'second'
    running.recorder = running.start('recorder', '--ros-args', '-p', f'bag:={bag}')
    run = running.finish(bag)
    assert run.receipt['missing'] == '0'
    assert (np.diff(run.states['stamp']) == 100_000).all()
    assert run.states['stamp'][-1] == run.commands['stamp'][-1] == 3_000_000_000


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_ended_recorder_leaves_a_finished_bag_and_the_run_goes_on(running, number):
    running.reach(0.5)
    running.recorder.send(number)
    assert running.recorder.wait() == 0
    run = read(running.bag)
    assert run.receipt['missing'] == '0'
    assert len(run.states) > 2_000
    assert running.plant.wait() == 0
    assert running.controller.interrupt() == 0


def test_a_late_recorder_joins_and_misses_nothing_from_then_on(graph, client):
    config = CONFIG / 'underdamped.yaml'
    plant = graph.start('plant_simulator', '--ros-args', '--params-file', config, '-p',
                        'wait_for_recorder:=false', '-p', 'real_time_factor:=0.15')
    controller = graph.start('controller', config=config)
    states = client.listen('/joint_states', JointState)
    client.spin_until(lambda: len(states) > 1000, 'a thousand states')
    bag = graph.folder / 'late'
    recorder = graph.start('recorder', '--ros-args', '--params-file', config, '-p', f'bag:={bag}')
    plant.says('joined the lockstep')
    assert plant.wait() == 0
    assert recorder.interrupt() == 0
    controller.interrupt()
    run = read(bag)
    assert run.receipt['missing'] == '0'
    assert run.states['stamp'][-1] == 3_000_000_000
    assert run.commands['stamp'][-1] == 3_000_000_000


def test_a_full_disk_ends_the_recorder_with_a_finished_bag_and_the_run_goes_on(running):
    running.reach(0.05)
    running.recorder.limit_files(400_000)
    assert running.recorder.wait() == 1
    said = f'{running.bag}: File too large: recording ends; the bag is finished with its first '
    assert said in running.recorder.output
    assert 'Traceback' not in running.recorder.output
    assert running.plant.wait() == 0, running.plant.output
    assert running.controller.interrupt() == 0
    run = read(running.bag)
    assert run.receipt['full'] == 'File too large'
    assert np.array_equal(run.states['stamp'], STAMPS[:len(run.states)])
    assert len(run.states) > 1_000
    with Reader(running.bag) as reader:
        assert reader.message_count == int(run.receipt['messages'])
        assert reader.message_count == sum(1 for _ in reader.messages())


def test_with_udp_xml_a_node_does_not_receive_by_shared_memory(graph):
    shared = []
    for _ in range(2):
        plant = graph.start('plant_simulator')
        plant.says('waiting for a controller')
        shared.append('/dev/shm/fastrtps_port' in plant.memory_map)
        assert plant.interrupt() == 0
        graph.share_no_memory()
    assert shared == [True, False]


@pytest.mark.parametrize(('arguments', 'published', 'subscribed'), [
    (('plant_simulator',), 'joint_states', 'joint_commands'),
    (('closed_loop', '--no-recorder'), 'joint_states', 'joint_commands'),
    (('controller',), 'joint_commands', 'joint_states'),
    (('recorder',), 'recorder_progress', 'joint_states')], ids=str)
def test_an_endpoint_that_gets_nothing_for_its_quality_of_service_is_reported(
        graph, client, arguments, published, subscribed):
    options = ('--ros-args', '-p', f'bag:={graph.folder / "bag"}') * (arguments[0] == 'recorder')
    process = graph.start(*arguments, *options)
    client.node.create_subscription(
        Header if published == 'recorder_progress' else JointState, f'/{published}', print,
        QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    process.says(f"topic '{published}', requesting incompatible QoS")
    assert 'DURABILITY' in process.output
    publisher = client.node.create_publisher(
        JointState, f'/{subscribed}',
        QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
    process.says(f"topic '{subscribed}', offering incompatible QoS")
    publisher.publish(JointState(name=['axis'], effort=[1.0]))
    assert process.interrupt() == 0
