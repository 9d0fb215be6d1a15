"""The benchmarks run, and print what they promise."""

import json
import subprocess
import sys

from test.conftest import ROOT

CASES = {'composed_floor', 'composed', 'composed_recorded', 'two_process_floor', 'two_process',
         'three_process'}


PLANTS = ('plain', 'friction', 'noise', 'friction_noise')


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


def test_the_batch_benchmark_measures_every_case():
    said = subprocess.run(
        [sys.executable, ROOT / 'benchmarks' / 'batch.py', '--json', '--rounds', '1', '--runs',
         '32', '--large', '100'], check=True, capture_output=True, text=True).stdout
    result = json.loads(said)
    assert set(result['ns']) == {'python_loop'} | {
        f'{way}_{plant}' for way in ('scalar', 'batch_1', 'batch_all') for plant in PLANTS}
    assert all(ns > 0 for ns in result['ns'].values())
    assert [(line['runs'], line['steps']) for line in result['growth']] == [
        (1, 10_000), (10, 10_000), (100, 1_000), (100, 10_000)]
