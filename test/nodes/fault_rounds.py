"""
Rounds of random faults on real processes; make soak runs some of them, by hand any number:

    python -m test.nodes.fault_rounds [--kills N] [--stops N] [--minutes N] [--seed N]

--kills and --stops are rounds for each of the three nodes; --minutes is simulated time of one
composed, recorded run with a fault each minute: docs/concepts/fault-tolerance.md
"""

import argparse
from pathlib import Path
import random
import signal
import sys
import tempfile
import time

import numpy as np

from impulse_control_ros.files.recording import read_bag
from test.client import Client
from test.nodes.long_run import long_run
from test.nodes.runs import assert_replays, assert_simulated, assert_whole, NODES, Run, STEP
from test.processes import Graph

DURATION = 0.5
# slow enough that the last samples are still to come when the client has seen some
PLANT = {'duration': DURATION, 'real_time_factor': 0.2}


def reach_any(run, rng, left=50):
    """
    Serve up to any sample; returns whether it is not the time before the first one.

    At least so many are ``left``, as far as the client has heard.
    """
    at = rng.randrange(-500, round(DURATION / 1e-4) - left)
    run.reach(max(at, 0))
    assert run.plant.running
    return at >= 0


def finish(run):
    """Wait for the end; every node leaves with status 0 and without a traceback."""
    assert run.plant.wait() == 0, run.plant.output
    return run.finish()


def kill_round(graph, client, victim, rng):
    """
    Kill ``victim`` at a random sample, or before the first one, and start it again.

    Returns the number of commands that are not in a bag.
    """
    run = Run(graph, client, begun=0, plant_simulator=PLANT)
    # a recorder is to join before the run is over
    begun = reach_any(run, rng, left=1500 if victim == 'recorder' else 50)
    {'plant_simulator': run.plant, 'controller': run.controller, 'recorder': run.recorder}[
        victim
    ].kill()
    first = run.bag
    if victim == 'recorder':
        run.bag = graph.folder / 'second'
        run.recorder = run.start('recorder', bag=run.bag)
    elif victim == 'controller':
        run.controller = run.start('controller')
    else:
        run.plant = run.start('plant_simulator')
    recording = finish(run)
    if victim == 'recorder':
        return assert_joined(recording, first if begun else None)
    if victim == 'controller':
        assert (np.diff(recording.states['stamp']) == STEP).all()
        assert len(recording.states) == round(DURATION / 1e-4) + 1
        assert_replays(run.bag)
        return int(recording.recording_summary['missing'])
    assert_simulated(recording)
    assert_whole(recording)
    again = first.with_name(f'{first.name}-2')
    if again.exists():
        assert_simulated(read_bag(again))
        assert_whole(read_bag(again))
    assert len(read_bag(again if again.exists() else first).states) == round(DURATION / 1e-4) + 1
    return 0


def assert_joined(recording, killed):
    """Assert that a recorder that was started again has all since it joined."""
    stamps = recording.states['stamp']
    last = 1_000_000_000 + round(DURATION / 1e-4) * STEP
    assert np.array_equal(stamps, np.arange(stamps[0], last + 1, STEP))
    commands = recording.commands['stamp']
    assert np.array_equal(commands, np.arange(commands[0], last + 1, STEP))
    if killed and (killed / f'{killed.name}_0.mcap').stat().st_size > 100_000:
        assert (np.diff(read_bag(killed).states['stamp']) == STEP).all()
    return int(recording.recording_summary['missing'])


def stop_round(graph, client, victim, rng):
    """Stop ``victim`` at a random sample for some seconds: not a bit differs."""
    run = Run(graph, client, begun=0, plant_simulator=PLANT)
    reach_any(run, rng)
    process = {
        'plant_simulator': run.plant,
        'controller': run.controller,
        'recorder': run.recorder,
    }[victim]
    process.send(signal.SIGSTOP)
    until = time.monotonic() + rng.uniform(0.5, 4.0)
    client.spin_until(lambda: time.monotonic() > until, 'some seconds')
    process.send(signal.SIGCONT)
    recording = finish(run)
    assert_whole(recording)
    assert_simulated(recording)
    return int(recording.recording_summary['missing'])


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
            missing = [
                one(kind, victim, random.Random(f'{options.seed} {number}'))
                for number in range(rounds)
            ]
            print(
                f'SUMMARY {kind.__name__} {victim}: {rounds} rounds, missing in '
                f'{sum(map(bool, missing))} of them, {sum(missing)} in all',
                flush=True,
            )
    if options.minutes:
        began = time.monotonic()
        _, done = one(long_run, options.minutes, random.Random(options.seed))
        print(
            f'SUMMARY {options.minutes} simulated minutes in '
            f'{time.monotonic() - began:.0f} s: {sum(done.values())} faults, 0 lost'
        )
    return 0


if __name__ == '__main__':
    sys.exit(main())
