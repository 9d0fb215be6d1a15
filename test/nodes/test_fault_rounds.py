"""A few of the rounds of random faults; docs/reliability.md has the figures of many."""

import random

from impulse_control_ros.files.recording import read
from test.nodes.fault_rounds import kill_round, long_run, stop_round


def test_a_controller_killed_at_a_random_sample_and_started_again_loses_no_state(graph, client):
    kill_round(graph, client, 'controller', random.Random('controller'))


def test_a_plant_stopped_at_a_random_sample_for_seconds_changes_no_bit(graph, client):
    stop_round(graph, client, 'plant_simulator', random.Random('plant_simulator'))


def test_a_composed_run_with_faults_from_outside_loses_no_sample(graph, client):
    bag, done = long_run(graph, client, 9, random.Random(1), seconds=1.0)
    assert len(done) == sum(done.values()) == 9
    marked = read(bag).states[['position', 'velocity', 'marked']]
    marked = marked[marked['marked']]
    assert len(marked) == 1 + done['reset']
    assert all(row.item() == (0.5, 0.0, True) for row in marked)
