"""
Rounds of random faults on real processes; test_fault_rounds.py runs a few of them, by hand many:

    python -m test.nodes.fault_rounds [--kills N] [--stops N] [--minutes N] [--seed N]

--kills and --stops are rounds for each of the three nodes; --minutes is simulated time of one
composed, recorded run with a fault each minute. The figures are in docs/reliability.md.
"""

import argparse
from collections import Counter
import math
from pathlib import Path
import random
import re
import signal
import sys
import tempfile
import time

from mcap.records import Metadata
import numpy as np
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.columns import Column, columns
from impulse_control_ros.files.parameter_file import read_experiment
from impulse_control_ros.files.recording import read
from test.conftest import Client, CONFIG, Graph

UNDERDAMPED = CONFIG / 'underdamped.yaml'
NODES = ('plant_simulator', 'controller', 'recorder')
STEP, START = 100_000, 1_000_000_000


class Run:
    """Three processes of one experiment, and how far they are."""

    def __init__(self, graph, client, duration):
        self.graph, self.client, self.duration = graph, client, duration
        graph.share_no_memory()
        self.states = client.listen('/joint_states', JointState)
        self.bags, self.processes = [], {}
        for name in ('plant_simulator', 'controller'):
            self.start(name)
        # the run may be over before a client is discovered: let it wait for the recorder so long
        client.spin_until(lambda: client.node.count_publishers('/joint_states'), 'the plant')
        self.start('recorder')

    def start(self, name):
        """Start a node, a recorder with a new bag."""
        # slow enough that the last samples are still to come when the client has seen some
        more = ('-p', f'duration:={self.duration}', '-p', 'real_time_factor:=0.2'
                ) if name == 'plant_simulator' else ()
        if name == 'recorder':
            self.bags.append(self.graph.folder / f'bag_{len(self.bags)}')
            more = ('-p', f'bag:={self.bags[-1]}')
        self.processes[name] = self.graph.start(name, '--ros-args', '--params-file', UNDERDAMPED,
                                                *more)

    def reach(self, tick):
        """Serve until the state at ``tick``, or a later one, has been seen."""
        def reached():
            if not self.states:
                return False
            stamp = self.states[-1].header.stamp
            return stamp.sec * 10**9 + stamp.nanosec >= START + tick * STEP
        self.client.spin_until(reached, f'sample {tick}')

    def reach_any(self, rng):
        """Serve up to any sample; returns whether it is not the time before the first one."""
        at = rng.randrange(-500, round(self.duration / 1e-4) - 50)
        if at >= 0:
            self.reach(at)
        return at >= 0

    def finish(self):
        """Wait for the end; every node leaves with status 0 and without a traceback."""
        for name in ('plant_simulator', 'recorder', 'controller'):
            process = self.processes[name]
            status = process.wait() if name == 'plant_simulator' else process.interrupt()
            assert status == 0, process.output
            assert 'Traceback' not in process.output

    def expected(self):
        """Return the run that nothing disturbs."""
        experiment = read_experiment(UNDERDAMPED)
        return simulate(experiment.plant_simulator, experiment.controller, self.duration)


def ticks(rows):
    """Return the sample of each row; its stamps are on the grid."""
    assert not ((rows['stamp'] - START) % STEP).any()
    return (rows['stamp'] - START) // STEP


def kill_round(graph, client, victim, rng, duration=0.5):
    """
    Kill ``victim`` at a random sample, or before the first one, and start it again.

    Returns the number of commands that are not in a bag.
    """
    run = Run(graph, client, duration)
    last = round(duration / 1e-4)
    begun = run.reach_any(rng)
    assert run.processes['plant_simulator'].running
    run.processes[victim].send(signal.SIGKILL)
    run.processes[victim].wait()
    run.start(victim)
    if victim == 'plant_simulator' and begun:
        run.processes['controller'].says('started afresh')
    run.finish()
    whole = np.arange(last + 1)
    if victim == 'recorder':
        second = read(run.bags[1])
        if begun:
            killed = read(run.bags[0])
            assert np.array_equal(ticks(killed.states), whole[:len(killed.states)])
        assert np.array_equal(ticks(second.states), whole[-len(second.states):])
        assert np.array_equal(ticks(second.commands), whole[-len(second.commands):])
        return int(second.receipt['missing'])
    another = victim == 'plant_simulator' and begun
    bag = read(f'{run.bags[0]}-2' if another else run.bags[0])
    assert np.array_equal(ticks(bag.states), whole)
    if victim == 'controller':
        # what it had just sent may reach the plant and not the recorder, which counts it
        assert int(bag.receipt['missing']) == len(whole) - len(np.unique(bag.commands['stamp']))
    else:
        expected = run.expected()
        assert bag.states['position'].tobytes() == expected.position.tobytes()
        assert bag.commands['effort'].tobytes() == expected.effort.tobytes()
        assert read(run.bags[0]).receipt['missing'] == '0'
    return int(bag.receipt['missing'])


def stop_round(graph, client, victim, rng, duration=0.5):
    """Stop ``victim`` at a random sample for some seconds: not a bit differs."""
    run = Run(graph, client, duration)
    run.reach_any(rng)
    assert run.processes['plant_simulator'].running
    run.processes[victim].send(signal.SIGSTOP)
    client.spin_for(rng.uniform(0.5, 4.0))
    run.processes[victim].send(signal.SIGCONT)
    run.finish()
    bag, expected = read(run.bags[0]), run.expected()
    assert np.array_equal(bag.states['stamp'], np.unique(bag.commands['stamp']))
    assert bag.states['position'].tobytes() == expected.position.tobytes()
    assert bag.receipt['missing'] == '0'
    return 0


# -- one long composed run ------------------------------------------------------------------


def command(stamp, effort, name='axis'):
    message = JointState(name=[name] if name else [], effort=effort)
    message.header.stamp.sec, message.header.stamp.nanosec = stamp
    return message


class Faults:
    """
    What is done to a composed run from outside; each is called with the run's process.

    What acts at a later sample returns its time.
    """

    def __init__(self, graph, client, rng):
        self._graph, self._client, self._rng = graph, client, rng
        self._commands = client.node.create_publisher(JointState, '/joint_commands', 1000)
        self._strays = client.node.create_publisher(JointState, '/joint_states', 1000)
        for publisher in (self._commands, self._strays):
            client.spin_until(lambda heard=publisher: heard.get_subscription_count() >= 2,
                              'who hears us')
        self.kinds = [self.stopped, self.stale_commands, self.broken_commands, self.noise,
                      self.broken_states, self.second_controller, self.second_plant,
                      self.killed_recorder, self.reset]

    def stopped(self, process):
        process.send(signal.SIGSTOP)
        time.sleep(self._rng.uniform(0.5, 3.0))
        process.send(signal.SIGCONT)

    def stale_commands(self, _):
        for k in range(200):
            self._commands.publish(command((1, k), [1e3]))
            self._commands.publish(command((2**31 - 1, k), [1e3]))

    def broken_commands(self, _):
        for effort in ([math.nan], [math.inf], [], [1.0] * 1000):
            for name in ('axis', 'elbow', ''):
                self._commands.publish(command((0, 0), effort, name))

    def noise(self, _):
        for _ in range(100):
            raw = self._rng.randbytes(self._rng.randrange(4, 200))
            self._commands.publish(b'\x00\x01\x00\x00' + raw)

    def broken_states(self, _):
        for position in ([math.nan], [math.inf], [], [0.0] * 1000):
            self._strays.publish(JointState(name=['elbow'], position=position, velocity=position))

    def second_controller(self, _):
        other = self._graph.start('controller', '--ros-args', '-r', '__node:=other')
        self._client.spin_until(lambda: 'other' in self._client.node.get_node_names(), 'it')
        other.kill()

    def second_plant(self, _):
        other = self._graph.start('plant_simulator', '--ros-args', '-r', '__node:=other')
        other.says('waiting for')
        other.kill()

    def killed_recorder(self, _):
        bag = Path(tempfile.mkdtemp(dir=self._graph.folder)) / 'bag'
        other = self._graph.start('recorder', '--ros-args', '-p', f'bag:={bag}')
        other.says('recording into')
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
    graph.share_no_memory()
    bag = graph.folder / 'long'
    clock = client.listen('/clock', Clock)
    process = graph.start(
        'closed_loop', '--ros-args', '--params-file', UNDERDAMPED, '-p', f'recorder:bag:={bag}',
        '-p', 'plant_simulator:duration:=0.0', '-p', 'plant_simulator:clock_rate:=10.0')

    def now():
        return clock[-1].clock.sec + 1e-9 * clock[-1].clock.nanosec

    def reach(at):
        while process.running and now() < at:
            before = now()
            client.spin_until(lambda before=before: not process.running or now() > before,
                              f'what follows {before} s')
        assert process.running, process.output
        del clock[:-1]
    client.spin_until(lambda: clock, 'the run')  # which waits for what we publish to leave
    faults, done = Faults(graph, client, rng), Counter()
    for minute in range(minutes):
        reach(1.0 + seconds * (minute + rng.uniform(0.0, 0.8)))
        fault = faults.kinds[minute % len(faults.kinds)]
        reach(fault(process) or 0.0)
        done[fault.__name__] += 1
    reach(1.0 + seconds * minutes)
    assert process.interrupt() == 0, process.output
    assert_no_sample_is_lost(bag, seconds * minutes)
    for count, what in re.findall(r'(\d+) (stale|foreign|rejected)', process.output):
        assert int(count) > 0, what
    print(process.output, f'faults: {dict(done)}', sep='\n')
    return bag, done


def assert_no_sample_is_lost(bag, seconds):
    """
    Go through the bag chunk by chunk: each sample's state once, and its command.

    It has ``seconds`` or more; the last state may have been left without its command.
    """
    states, commands, receipt = [], [], {}
    for item in columns(bag / f'{bag.name}_0.mcap'):
        if isinstance(item, Column):
            if item.topic == '/joint_states':
                states.append(np.unique(item.stamp))
            elif item.topic == '/joint_commands':
                commands.append(np.unique(item.stamp))
        elif isinstance(item, Metadata) and item.name == 'recording':
            receipt = item.metadata
    states, commands = np.concatenate(states), np.concatenate(commands)
    steps = (int(states.max()) - START) // STEP
    assert steps >= round(seconds / 1e-4)
    grid = START + np.arange(steps + 1) * STEP
    assert not np.setdiff1d(grid, states, assume_unique=True).size
    assert not np.setdiff1d(grid[:-1], commands, assume_unique=True).size
    assert receipt['missing'] == '0', receipt
    print(f'{steps + 1} states, each with its command: {receipt}')


# -- by hand --------------------------------------------------------------------------------


def one(kind, *arguments):
    """Run one round in a graph of its own."""
    with tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder))
        client = Client(graph)
        try:
            return kind(graph, client, *arguments)
        finally:
            client.close()
            graph.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--kills', type=int, default=0)
    parser.add_argument('--stops', type=int, default=0)
    parser.add_argument('--minutes', type=int, default=0)
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    for kind, rounds in ((kill_round, options.kills), (stop_round, options.stops)):
        for victim in NODES if rounds else ():
            missing = [one(kind, victim, random.Random(f'{options.seed} {number}'))
                       for number in range(rounds)]
            print(f'SUMMARY {kind.__name__} {victim}: {rounds} rounds, missing in '
                  f'{sum(map(bool, missing))} of them, {sum(missing)} in all', flush=True)
    if options.minutes:
        began = time.monotonic()
        _, done = one(long_run, options.minutes, random.Random(options.seed))
        print(f'SUMMARY {options.minutes} simulated minutes in '
              f'{time.monotonic() - began:.0f} s: {sum(done.values())} faults, 0 lost')
    return 0


if __name__ == '__main__':
    sys.exit(main())
