"""Several plants, foreign messages beside one, and a foreign plant."""

import math
import time

from builtin_interfaces.msg import Time
import numpy as np
from rcl_interfaces.msg import ParameterEvent
from sensor_msgs.msg import JointState

from impulse_control_ros.core.protocol import parse_state
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.nodes.topics import LATCHED_QOS
from test.nodes.runs import (
    assert_replays,
    assert_simulated,
    assert_whole,
    messages,
    Run,
    START,
)

GARBAGE = b'\x00\x01\x00\x00' + b'\xff' * 60


def message(stamp=(0, 0), frame_id='', name='axis', **fields):
    made = JointState(name=[name], **fields)
    made.header.stamp, made.header.frame_id = Time(sec=stamp[0], nanosec=stamp[1]), frame_id
    return made


def test_a_second_plant_is_ignored_until_the_first_has_left(graph, client):
    run = Run(graph, client)
    run.bag.with_name('bag-2').mkdir()  # the name is taken
    second = run.start('plant_simulator', 'second', real_time_factor=0.0, duration=0.05)
    third = run.start('plant_simulator', 'third', wait_for_recorder=False)
    client.reported('second', steps=-1)
    client.spin_until(lambda: client.count_of('controller', 'other_run'), 'states of another run')
    client.spin_until(lambda: client.count_of('recorder', 'foreign'), 'states of another run')
    third.kill()
    first = parse_state(run.states[0].header.frame_id).run
    before = len(run.states)
    client.spin_until(
        lambda: (
            len(
                [
                    one
                    for one in run.states[before:]
                    if parse_state(one.header.frame_id).run == first
                ]
            )
            > 50
        ),
        'more of the first run',
    )
    assert second.running
    assert run.plant.interrupt() == 0
    assert second.wait() == 0, second.output
    assert second.totals['accepted'] == 501
    recordings = [run.finish(), read_bag(run.bag.with_name('bag-3'))]
    for recording in recordings:
        assert_whole(recording)
        assert_simulated(recording)
    assert int(recordings[0].recording_summary['foreign']) > 0
    assert recordings[0].run == first
    assert len(recordings[1].states) == len(recordings[1].commands) == 501
    assert {topic for topic, *_ in messages(run.bag)} == {
        '/joint_states',
        '/joint_commands',
        '/impulse_events',
        '/run_parameters',
    }
    assert not list(run.bag.with_name('bag-2').iterdir())


def test_what_others_say_beside_a_run_is_counted_and_changes_nothing(graph, client):
    run = Run(graph, client)
    states = client.publisher('/joint_states', JointState, 'controller', 'recorder')
    commands = client.publisher('/joint_commands', JointState, 'plant_simulator', 'recorder')
    parameters = client.node.create_publisher(ParameterEvent, '/run_parameters', LATCHED_QOS)
    strange = {
        parameters: [ParameterEvent(node='/somebody')],
        states: [
            message((1, 0), position=[1.0], velocity=[0.0]),
            message((1, 0), name='elbow', position=[1.0]),
            message((1, 0), 'run:0badcafe.0', position=[1.0], velocity=[0.0]),
            GARBAGE,
        ],
        commands: [
            *(message((1, 0), effort=effort) for effort in ([np.nan], [np.inf], [])),
            message((1, 0), name='elbow', effort=[1.0]),
            GARBAGE,
            *(
                message(stamp, effort=[1000.0])
                for stamp in ((0, 0), (0, 5), (1, 0), (2**31 - 1, 0))
            ),
            message((1, 0), 'run:0badcafe.0 /controller#1234', effort=[1000.0]),
        ],
    }

    reported = []

    def counted():
        # who reads best effort may not have discovered us: say it again, once a second
        report = client.reports('plant_simulator')
        if report not in reported[-1:]:
            reported.append(report)
            for publisher, sent in strange.items():
                for one in sent:
                    publisher.publish(one)
        return all(
            client.count_of(node, name) >= count
            for node, name, count in (
                ('plant_simulator', 'rejected', 5),
                ('plant_simulator', 'ignored', 4),
                ('plant_simulator', 'other_run', 1),
                ('controller', 'rejected', 2),
                ('controller', 'other_run', 1),
                ('recorder', 'foreign', 3),
            )
        )

    client.spin_until(counted, 'the counts')
    run.reach(50)
    recording = run.finish()
    assert_whole(recording)
    assert_simulated(recording)
    assert_replays(run.bag)
    # what is foreign is kept, as it is told; what is of another run is not
    kept = [raw for topic, *_, raw in messages(run.bag) if topic == '/joint_states']
    assert len(kept) > len(recording.states)
    assert not [raw for raw in kept if b'0badcafe' in raw]
    assert not run.bag.with_name('bag-2').exists()


def foreign_states(client, count, start=START):
    """Publish states as a driver does, one for each command; returns the first commands."""
    states = client.publisher('/joint_states', JointState, 'controller', 'recorder')
    commands = client.listen('/joint_commands', JointState)
    client.recorded(commands=2)  # this client and the recorder
    first = []
    for k in range(count):
        stamp = divmod(start + k * 1_000_000, 10**9)
        state = message(stamp, name='axis', position=[0.5 - 0.01 * k], velocity=[-1.0])
        asked_at = [-math.inf]

        def answers(stamp=stamp, state=state, asked_at=asked_at):
            if time.monotonic() > asked_at[0] + 0.1:  # a lost message is asked for again
                asked_at[0] = time.monotonic()
                states.publish(state)
            return [
                one
                for one in commands
                if (one.header.stamp.sec, one.header.stamp.nanosec) == stamp
            ]

        client.spin_until(answers, f'the answer to state {k}')
        first += answers()[:1]

    def repeated():
        states.publish(state)
        return len(answers()) > 1

    client.spin_until(repeated, 'the last answer once more')
    assert all(one == first[-1] for one in answers())
    return first


def test_a_foreign_plant_is_answered_and_recorded(graph, client):
    bag = graph.folder / 'bag'
    controller = graph.start(
        'controller', time_step=0.001, position_deadband=0.005, state_timeout=0.0
    )
    recorder = graph.start('recorder', bag=bag)
    commands = foreign_states(client, 100)
    assert {one.header.frame_id for one in commands} == {'', 'position_zero'}
    assert all(one.name == ['axis'] and len(one.effort) == 1 for one in commands)
    for process in (recorder, controller):
        assert process.interrupt() == 0, process.output
    recording = read_bag(bag)
    assert recording.run == ''
    assert len(recording.commands) == 100
    assert np.array_equal(np.diff(recording.states['stamp']), np.full(99, 1_000_000))
    assert len(recording.impulses) == sum(one.header.frame_id != '' for one in commands) > 0
    (change,) = recording.controllers
    assert change.node == '/controller'
    assert change.stamp == START
    assert_replays(bag, '--controller')


def test_two_controllers_of_a_foreign_plant_are_warned_about(graph, client):
    controllers = [
        graph.start('controller', '--ros-args', '-r', f'__node:={name}', time_step=0.001)
        for name in ('one', 'two')
    ]
    states = client.publisher('/joint_states', JointState, 'one', 'two')

    def warned():
        states.publish(message((1, 0), position=[0.5], velocity=[0.0]))
        return all('several controllers' in controller.output for controller in controllers)

    client.spin_until(warned, 'warnings')
    for controller in controllers:
        assert controller.interrupt() == 0
