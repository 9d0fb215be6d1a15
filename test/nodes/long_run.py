"""One long composed run, and what is done to it from outside."""

from collections import Counter
import math
import re
import signal
import time

from builtin_interfaces.msg import Time
from mcap.records import Metadata
import numpy as np
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from impulse_control_ros.files.mcap_reader import Column, columns
from test.nodes.runs import composed, START, start_as, STEP

SUBSCRIBER = """
import rclpy, rclpy.executors
from sensor_msgs.msg import JointState
from impulse_control_ros.nodes.transport import prefer_udp
prefer_udp(rclpy.get_rmw_implementation_identifier())
rclpy.init()
node = rclpy.create_node('subscriber')
node.create_subscription(JointState, 'joint_states', lambda _: None, 1000)
rclpy.spin(node)
"""


class Faults:
    """
    What is done to a composed run from outside; each is called with the run's process.

    What acts at a later sample returns its time.
    """

    def __init__(self, graph, client, rng):
        self._graph, self._client, self._rng = graph, client, rng
        self._count = 0
        self._publishers = [
            client.node.create_publisher(JointState, topic, 1000)
            for topic in ('/joint_commands', '/joint_states', '/impulse_events')
        ]
        self.kinds = [
            self.stopped,
            self.strange_messages,
            self.second_controller,
            self.second_plant,
            self.killed_recorder,
            self.killed_subscriber,
            self.reset,
        ]

    def _is_up(self, name):
        self._client.spin_until(lambda: name in self._client.nodes(), name)

    def stopped(self, process):
        process.send(signal.SIGSTOP)
        time.sleep(self._rng.uniform(0.5, 3.0))
        process.send(signal.SIGCONT)

    def strange_messages(self, _):
        for publisher in self._publishers:
            for k in range(100):
                for sec in (0, 1, 2**31 - 1):
                    message = JointState(
                        name=['axis'],
                        position=[1.0],
                        velocity=[0.0],
                        effort=[(math.nan, math.inf, 1e3)[k % 3]],
                    )
                    message.header.stamp = Time(sec=sec, nanosec=k)
                    publisher.publish(message)
                raw = self._rng.randbytes(self._rng.randrange(4, 200))
                publisher.publish(b'\x00\x01\x00\x00' + raw)

    def second_controller(self, _):
        other = start_as(self._graph, 'other', 'controller')
        self._is_up('other')
        other.kill()

    def second_plant(self, _):
        other = start_as(self._graph, 'second', 'plant_simulator', wait_for_recorder=False)
        self._client.reported('second', steps=0)
        other.kill()

    def killed_recorder(self, _):
        self._count += 1
        other = self._graph.start('recorder', bag=self._graph.folder / f'other_{self._count}')
        self._client.reported('plant_simulator', recorders=2)
        other.kill()
        self._client.reported('plant_simulator', recorders=1)

    def killed_subscriber(self, _):
        other = self._graph.start('python', '-c', SUBSCRIBER)
        self._is_up('subscriber')
        other.kill()

    def reset(self, _):
        response = self._client.call('/plant_simulator/reset', Trigger, once=True)
        assert response.success, response.message
        return float(re.search(r'at (\S+) s', response.message).group(1))


def long_run(graph, client, minutes, rng, seconds=60.0):
    """
    Run so many simulated minutes, of ``seconds``, with a fault in each.

    Returns the bag and how often each fault was.
    """
    clock = client.listen('/clock', Clock)
    process = composed(
        graph,
        **{
            'plant_simulator:real_time_factor': 0.0,
            'plant_simulator:clock_rate': 10.0,
            'plant_simulator:recorder_timeout': 1.0,
        },
    )

    def now():
        return clock[-1].clock.sec + 1e-9 * clock[-1].clock.nanosec

    def reach(at):
        while process.running and now() < at:
            before = now()
            client.spin_until(
                lambda before=before: not process.running or now() > before,
                f'what follows {before} s',
            )
        assert process.running, process.output
        del clock[:-1]

    client.spin_until(lambda: clock, 'the run')
    faults, done = Faults(graph, client, rng), Counter()
    for minute in range(minutes):
        reach(1.0 + seconds * (minute + rng.uniform(0.0, 0.8)))
        fault = faults.kinds[minute % len(faults.kinds)]
        reach(fault(process) or 0.0)
        done[fault.__name__] += 1
    reach(1.0 + seconds * minutes)
    assert process.interrupt() == 0, process.output
    assert_no_sample_is_lost(graph.folder / 'bag', seconds * minutes)
    print(process.output, f'faults: {dict(done)}', sep='\n')
    return graph.folder / 'bag', done


def assert_no_sample_is_lost(bag, seconds):
    """
    Go through the bag chunk by chunk: each sample's state once, and its command.

    It has ``seconds`` or more; the last state may have been left without its command.
    """
    states, commands, recording_summary = [], [], {}
    for item in columns(bag / f'{bag.name}_0.mcap'):
        if isinstance(item, Column):
            if item.topic == '/joint_states':
                states.append(item.stamp)
            elif item.topic == '/joint_commands':
                commands.append(item.stamp)
        elif isinstance(item, Metadata) and item.name == 'recording':
            recording_summary = item.metadata
    states, commands = np.concatenate(states), np.concatenate(commands)
    assert len(states) > round(seconds / 1e-4)
    grid = START + np.arange(len(states)) * STEP
    assert np.array_equal(states, grid)
    assert np.array_equal(commands, grid[: len(commands)])
    assert len(states) - len(commands) in (0, 1)
    assert recording_summary['missing'] == '0', recording_summary
    print(f'{len(states)} states, each with its command: {recording_summary}')
