"""The benchmarks run, and print what they promise."""

from importlib.util import find_spec
import json
import subprocess
import sys

import pytest

from test.chromium import needs_chromium
from test.conftest import ROOT

sys.path.insert(0, str(ROOT / 'benchmarks'))
import peers  # noqa: E402 (a script beside its own modules)

CASES = {
    'composed_floor',
    'composed',
    'composed_recorded',
    'simulate',
    'two_process_floor',
    'best_effort_floor',
    'two_process',
    'three_process',
}


PLANTS = ('plain', 'friction', 'noise', 'friction_noise')


def test_the_lockstep_benchmark_measures_every_case(graph):
    said = subprocess.run(
        [
            sys.executable,
            ROOT / 'benchmarks' / 'lockstep.py',
            '--json',
            '--rounds',
            '1',
            '--seconds',
            '2',
            '--long',
            '12',
        ],
        env=graph.env,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    result = json.loads(said)
    assert set(result) == CASES | {'peak_rss_mb', 'growth_rss_mb'}
    assert all(result[case] > 0 for case in CASES)
    assert set(result['peak_rss_mb']) == CASES
    short, long = result['growth_rss_mb'].values()
    assert long < 1.2 * short


def test_the_batch_benchmark_measures_every_case():
    said = subprocess.run(
        [
            sys.executable,
            ROOT / 'benchmarks' / 'batch.py',
            '--json',
            '--rounds',
            '1',
            '--runs',
            '32',
            '--large',
            '100',
        ],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    result = json.loads(said)
    assert set(result['ns']) == {'python_loop'} | {
        f'{way}_{plant}{law}'
        for way in ('scalar', 'batch_1', 'batch_all')
        for plant in PLANTS
        for law in ('', '_supervised')
    }
    assert all(ns > 0 for ns in result['ns'].values())
    assert [(line['runs'], line['steps']) for line in result['growth']] == [
        (1, 10_000),
        (10, 10_000),
        (100, 1_000),
        (100, 10_000),
    ]


def test_the_reading_benchmark_measures_every_case():
    said = subprocess.run(
        [
            sys.executable,
            ROOT / 'benchmarks' / 'reading.py',
            '--json',
            '--rounds',
            '1',
            '--samples',
            '5000',
            '--large',
            '20000',
        ],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    result = json.loads(said)
    assert set(result['messages_per_s']) == {'mcap_iterator', 'read'}
    assert all(rate > 0 for rate in result['messages_per_s'].values())
    assert [line['messages'] for line in result['growth']] == [400, 4000, 40_000]


@needs_chromium
@pytest.mark.soak
def test_the_dashboard_benchmark_measures_both_cases(graph):
    said = subprocess.run(
        [
            sys.executable,
            ROOT / 'benchmarks' / 'dashboard.py',
            '--json',
            '--rounds',
            '1',
            '--seconds',
            '2',
        ],
        env=graph.env,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    result = json.loads(said)
    assert result['steps_per_second_ratio'] > 0.0
    assert result['steps_per_core_second_ratio'] > 0.0


ERRORS = {
    'ours_simulate': 3e-4,
    'python_loop': 3e-4,
    'numpy_batch': 3e-4,
    'ours_batch': 3e-4,
    'scipy_events': 1e-8,
}  # [m]


def test_the_peers_that_are_there_are_as_accurate_as_claimed():
    said = subprocess.run(
        [
            sys.executable,
            ROOT / 'benchmarks' / 'peers.py',
            '--json',
            '--rounds',
            '1',
            '--seconds',
            '0.3',
            '--only',
            *peers.EXACT,
            *ERRORS,
        ],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    result = json.loads(said)
    assert set(result['cases']) == {'fig2', 'fig5'}
    for rows in result['cases'].values():
        assert set(rows) == {*peers.EXACT, *ERRORS}
        if not find_spec('scipy'):
            assert rows.pop('scipy_events')['failure'].startswith('not installed: scipy')
        for name, row in rows.items():
            assert 'failure' not in row, row
            assert row['wall'] > 0
            assert row['lines'] > 0
            assert row['ratios']
            assert row['error'] is None if name in peers.EXACT else row['error'] < ERRORS[name]


def test_a_missing_peer_is_a_row_that_says_so(monkeypatch):
    monkeypatch.setattr(peers, 'versions', lambda source: {'drake': None})
    row = peers.Contestant('drake', 'fig2', 1.0).finish()
    assert row['failure'] == "not installed: drake (pip install '.[bench]')"


def test_a_failing_peer_is_a_row_that_says_why():
    row = peers.Contestant('python_loop', 'fig2', -1.0).finish()
    assert row['failure'].startswith('failed: ')


def test_only_lines_of_code_count():
    source = ['"""Two', '"""', '', '# why', 'x = (1,', '     2)  # three', 'y = """a', 'b"""']
    assert peers.code_lines('\n'.join(source)) == 4
