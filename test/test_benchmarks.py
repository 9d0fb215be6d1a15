"""The benchmarks run, and print what they promise."""

import json
import subprocess
import sys

from test.conftest import ROOT

CASES = {'composed_floor', 'composed', 'composed_recorded', 'two_process_floor', 'two_process',
         'three_process'}


def test_the_lockstep_benchmark_measures_every_case(graph):
    said = subprocess.run(
        [sys.executable, ROOT / 'benchmarks' / 'lockstep.py', '--json', '--rounds', '1'],
        env=graph.env, check=True, capture_output=True, text=True).stdout
    result = json.loads(said)
    assert set(result) == CASES | {'peak_rss_mb', 'growth_rss_mb'}
    assert all(result[case] > 0 for case in CASES)
    assert set(result['peak_rss_mb']) == CASES
    short, long = result['growth_rss_mb'].values()
    assert long < 1.2 * short
