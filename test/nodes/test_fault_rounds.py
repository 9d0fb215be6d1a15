"""Some rounds of random faults; docs/concepts/fault-tolerance.md has the figures of many."""

import random

import numpy as np
import pytest

from impulse_control_ros.files.recording import read_bag
from test.nodes.fault_rounds import kill_round, stop_round
from test.nodes.long_run import long_run
from test.nodes.runs import assert_replays, NODES

pytestmark = pytest.mark.soak


@pytest.mark.parametrize('victim', NODES)
@pytest.mark.parametrize('kind', [kill_round, stop_round])
@pytest.mark.parametrize('number', range(3))
def test_a_node_that_is_killed_or_stopped_at_a_random_sample_costs_nothing(
    graph, client, kind, victim, number
):
    kind(graph, client, victim, random.Random(f'{victim} {number}'))


def test_a_composed_run_with_faults_from_outside_loses_no_sample(graph, client):
    bag, done = long_run(graph, client, 14, random.Random(1), seconds=1.0)
    assert len(done) == 7
    assert sum(done.values()) == 14
    started = read_bag(bag).states
    started = started[started['is_reset']]
    assert len(started) == 1 + done['reset']
    assert np.array_equal(started['position'], np.full(len(started), 0.5))
    assert_replays(bag)
