"""Plant, controller and recorder in one process, and what there is around it."""

import re

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
import yaml

from impulse_control_ros.core.protocol import parse_node, parse_state
from impulse_control_ros.files.recording import read_bag
from test.nodes.runs import (
    assert_replays,
    assert_simulated,
    assert_whole,
    composed,
    messages,
    stamp_of,
    start_as,
    UNDERDAMPED,
)

OURS = ('joint_states', 'joint_commands', 'impulse_events', 'run_parameters')


def test_a_composed_run_takes_nothing_from_the_graph_and_is_recorded_from_outside(graph, client):
    process = composed(graph)
    progress = client.listen('/recorder_progress', Header)
    client.reported('recorder', foreign=0)
    for topic in OURS:
        client.spin_until(lambda topic=topic: client.node.count_publishers(topic), topic)
        assert client.node.count_subscribers(topic) == 0
    states = client.listen('/joint_states', JointState)
    outside = client.node.create_publisher(JointState, '/joint_commands', 10)
    recorder = graph.start('recorder', config=UNDERDAMPED, bag=graph.folder / 'outside')
    client.reported('plant_simulator', recorders=2)
    client.spin_until(lambda: outside.get_subscription_count(), 'the recorder outside')
    for state in states[-20:-10]:  # whose commands are out
        outside.publish(JointState(header=state.header, name=['axis'], effort=[1000.0]))
    begun = len(states)
    client.spin_until(lambda: len(states) > begun + 200, 'more states')
    # the one outside alone hears of commands and states
    assert outside.get_subscription_count() == 1
    assert client.node.count_subscribers('/joint_states') == 2
    assert recorder.interrupt() == 0, recorder.output
    assert process.interrupt() == 0, process.output
    inside = read_bag(graph.folder / 'bag')
    assert_whole(inside)
    assert_simulated(inside)
    assert_replays(graph.folder / 'bag')
    found = read_bag(graph.folder / 'outside')
    assert found.recording_summary['missing'] == '0'
    assert found.run == inside.run
    assert stamp_of(states[begun]) in found.states['stamp']
    ours = [one for one in messages(graph.folder / 'bag') if one[0] != '/run_parameters']
    theirs = [
        one
        for one in messages(graph.folder / 'outside')
        if one[0] != '/run_parameters' and b'/controller' in one[3]
    ]
    at = ours.index(theirs[0])
    assert theirs == ours[at : at + len(theirs)]
    assert len(theirs) > 200
    run = parse_state(states[0].header.frame_id).run
    assert {parse_node(one.frame_id).run for one in progress} == {run}
    reached = [
        one.stamp.sec * 10**9 + one.stamp.nanosec
        for one in progress
        if parse_node(one.frame_id).node != parse_node(progress[-1].frame_id).node
    ]
    assert (np.diff(reached) >= 0).all()


def test_a_composed_run_goes_on_when_peers_outside_are_killed(graph, client):
    """How fast, test_recovery.py measures."""
    process = composed(
        graph, **{'plant_simulator:recorder_timeout': 1.0, 'plant_simulator:real_time_factor': 0.2}
    )
    states = client.listen('/joint_states', JointState)
    peers = [
        graph.start('recorder', config=UNDERDAMPED, bag=graph.folder / 'outside'),
        start_as(graph, 'other', 'controller'),
    ]
    client.reported('plant_simulator', recorders=2)
    for peer in peers:
        peer.kill()
    client.reported('plant_simulator', recorders=1)
    before = stamp_of(states[-1])
    client.spin_until(lambda: stamp_of(states[-1]) > before + 10**9 // 10, 'states')
    assert process.interrupt() == 0, process.output
    assert_whole(read_bag(graph.folder / 'bag'))
    assert_simulated(read_bag(graph.folder / 'bag'))


def test_composed_nodes_that_do_not_fit_are_refused_and_leave_no_bag(graph):
    process = composed(graph, **{'controller:time_step': 0.001})
    assert process.wait() == 2
    assert 'time_step = 0.001' in process.output
    assert not (graph.folder / 'bag').exists()


def test_a_loop_that_diverges_ends_with_the_reason_and_a_finished_bag(graph):
    process = composed(graph, **{'controller:K': 1.0e9, 'plant_simulator:real_time_factor': 0.0})
    assert process.wait() == 1
    assert 'diverged' in process.output
    assert 'Traceback' not in process.output
    run = read_bag(graph.folder / 'bag')
    assert run.recording_summary['missing'] == '0'
    assert np.isfinite(run.states['position']).all()


def test_parameters_that_miss_the_nodes_are_named(graph):
    plain = graph.folder / 'plain.yaml'
    plain.write_text(UNDERDAMPED.read_text().replace('/**/', ''))
    process = graph.start('closed_loop', '--ros-args', '-r', '__ns:=/left', config=plain)
    alone = graph.start('controller', '--ros-args', '-r', '__ns:=/left', config=plain)
    renamed = graph.start(
        'closed_loop', '--ros-args', '-r', 'controller:__node:=other', config=UNDERDAMPED
    )
    assert process.wait() == renamed.wait() == 2
    assert '/left/plant_simulator' in process.output
    assert 'matches none of /other' in renamed.output
    alone.says('/left/controller')
    assert alone.interrupt() == 0


def test_a_section_for_all_nodes_and_the_home_folder_in_a_path_are_understood(graph):
    shared = graph.folder / 'shared.yaml'
    values = {'time_step': 0.001, 'joint_name': 'arm', 'use_sim_time': True, 'duration': 0.1}
    shared.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    graph.environment = {**graph.environment, 'HOME': str(graph.folder)}
    process = graph.start('closed_loop', config=shared, **{'recorder:bag': '~/bag'})
    assert process.wait() == 0, process.output
    assert len(read_bag(graph.folder / 'bag').states) == 101


def test_real_time_factor_holds_simulated_time_to_the_wall_clock(graph):
    process = composed(
        graph, **{'plant_simulator:duration': 0.2, 'plant_simulator:real_time_factor': 0.5}
    )
    assert process.wait() == 0, process.output
    (wall,) = re.findall(r'0\.2 s in (\S+) s of wall time', process.output)
    assert float(wall) > 0.39


def test_without_the_events_executor_the_standard_one_serves_and_says_so(graph):
    process = graph.start(
        'python',
        '-c',
        'import sys; sys.modules["rclpy.experimental"] = None\n'
        'from impulse_control_ros.command_line import closed_loop; sys.exit(closed_loop())',
        config=UNDERDAMPED,
        **{'plant_simulator:duration': 0.1, 'recorder:bag': graph.folder / 'bag'},
    )
    assert process.wait() == 0, process.output
    assert 'EventsExecutor' in process.output
    assert len(read_bag(graph.folder / 'bag').states) == 1001
    assert_whole(read_bag(graph.folder / 'bag'))
