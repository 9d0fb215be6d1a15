"""``identify``: the table, its exit statuses, and the experiment that it writes."""

from dataclasses import replace
import json
import re

import numpy as np
import pyarrow as pa
from pyarrow import parquet
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.design import check_gains, Level
from impulse_control_ros.core.excitation import Limits
from impulse_control_ros.core.metrics import settling_time
from impulse_control_ros.core.nonidealities import Disturbance, Sensor
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from test.command_lines import status_of
from test.excited import excited

AXIS = Plant(
    m=0.5,
    F_c=0.8,
    x_0=0.0,
    damping=Damping(kind='sinusoidal', lower=1.0, upper=2.0, bandwidth=1.0),
    sensor=Sensor(resolution=2e-5, velocity='none'),
    disturbance=Disturbance(force=-0.3),
)
GAINS = ControlGains(K=100.0, D=6.0)
LIMITS = Limits(low=-0.2, high=0.2, speed=0.6)
STEP = '--travel', 0.1


@pytest.fixture(scope='module')
def moved(tmp_path_factory):
    """Return the record of the axis as a table."""
    columns = excited(AXIS, GAINS, LIMITS).columns
    del columns['velocity']
    path = tmp_path_factory.mktemp('moved') / 'moved.parquet'
    parquet.write_table(pa.table(columns), path)
    return path


@pytest.fixture(scope='module')
def slow(tmp_path_factory):
    """Return a record at constant speed, which does not show the mass."""
    time = np.arange(3000) * 1e-3
    path = tmp_path_factory.mktemp('slow') / 'slow.parquet'
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(time))
    effort = 1.0 + 0.2 * noise
    parquet.write_table(
        pa.table({'time': time, 'position': 0.1 * time + 1e-6 * noise, 'effort': effort}), path
    )
    return path


def test_the_table_has_the_true_values_within_its_intervals(moved, capsys):
    assert status_of('identify', moved) == 0
    said, warned = capsys.readouterr()
    lines = said.splitlines()
    assert lines[0].split() == [
        'parameter',
        'value',
        'unit',
        '95',
        '%',
        'interval',
        'share',
        'verdict',
    ]
    for line, true in zip(lines[1:4:2], (0.5, 0.8), strict=True):
        low, high = map(float, re.search(r'(\S+) to (\S+)', line).groups())
        assert low - 0.02 * true <= true <= high + 0.02 * true
        assert line.endswith('identified')
    assert 'd_bar = ' in said
    assert 'take 1.1 to 1.2 times it' in warned


def test_json_has_every_estimate_and_null_for_what_is_unknown(moved, slow, capsys):
    assert status_of('identify', moved, '--format', 'json') == 0
    found = json.loads(capsys.readouterr().out)
    assert {*found['parameters']} == {'m', 'd', 'F_c', 'offset'}
    assert found['parameters']['m'].items() >= {'unit': 'kg', 'verdict': 'identified'}.items()
    assert len(found['parameters']['m']['interval']) == 2
    assert found['parameters']['offset']['value'] == pytest.approx(0.3, abs=0.05)
    assert 2.0 < found['d_bar'] < 6.0
    assert len(found['d_blocks']['d']) == len(found['d_blocks']['time'])
    assert status_of('identify', slow, '--format', 'json') == 1
    assert json.loads(capsys.readouterr().out)['parameters']['m']['value'] is None


def test_a_record_that_does_not_show_the_mass_ends_with_1_and_what_would_show_it(
    slow, tmp_path, capsys
):
    file = tmp_path / 'axis.yaml'
    assert status_of('identify', slow, '--write', file, *STEP, '--stiffness', 100) == 1
    said, warned = capsys.readouterr()
    (line,) = [line for line in said.splitlines() if line.startswith('m ')]
    assert 'not excited' in line
    assert re.search(r'^identify: .*(accelerat|step)', warned, re.M)
    assert not file.exists()


def test_several_records_and_parts_of_them_are_identified_together(moved, tmp_path, capsys):
    columns = {'t': 'time', 'x': 'position', 'u': 'effort'}
    table = parquet.read_table(moved).rename_columns(
        dict(zip(columns.values(), columns, strict=True))
    )
    half = tmp_path / 'half.parquet'
    parquet.write_table(table, half)
    named = '--columns', 'time=t,position=x,effort=u'
    assert status_of('identify', half, *named, '--effort-scale', 2, '--to', 9) == 0
    line = capsys.readouterr().out.splitlines()[1]
    assert float(line.split()[1]) == pytest.approx(1.0, rel=0.05)
    assert status_of('identify', moved, half) == 2
    assert "half.parquet: no column 'time'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['--write', 'a.yaml'], '--write: needs --travel, and --settling-time or --stiffness'),
        (['--write', 'a.txt', *STEP, '--stiffness', 1], '--write a.txt: must end in .yaml'),
        (['--write', 'no/a.yaml', *STEP, '--stiffness', 1], 'its folder does not exist'),
        (['--report', 'a.pdf'], '--report a.pdf: must end in .html'),
        (['--stiffness', 1], '--stiffness: must stand with --write'),
        (['--effort-scale', 0], '--effort-scale 0: must be finite and not 0'),
        (['--from', 2, '--to', 1], '--from 2, --to 1: must be 0 <= from < to'),
        (['--columns', 'time=t'], 'no column for position, effort'),
        (['--columns', 'when=t'], "'when=t': must be time=COLUMN"),
        (['--settling-time', 1, '--stiffness', 1], 'not allowed with'),
    ],
)
def test_options_that_make_no_sense_are_refused(moved, capsys, options, said):
    assert status_of('identify', moved, *options) == 2
    errors = capsys.readouterr().err
    assert said in errors
    assert errors.count('\n') == 1


def test_a_missing_record_is_one_line(tmp_path, capsys):
    for name in ('bag', 'a.csv'):
        assert status_of('identify', tmp_path / name) in (1, 2)
        errors = capsys.readouterr().err
        assert str(tmp_path / name) in errors
        assert errors.count('\n') == 1


@pytest.mark.parametrize(
    'need',
    [
        ('--settling-time', '0.5'),
        ('--settling-time', '0.4', '--effort-limit', '20'),
        ('--stiffness', '60', '--effort-limit', '40'),
    ],
    ids=' '.join,
)
def test_the_experiment_runs_as_it_is_and_the_true_axis_does_as_predicted(
    moved, tmp_path, capsys, need
):
    file, bag = tmp_path / 'axis.yaml', tmp_path / 'bag'
    assert status_of('identify', moved, '--format', 'json', '--write', file, *STEP, *need) == 0
    design = json.loads(capsys.readouterr().out)['design']
    made = load_experiment(file)
    assert not [one for one in check_gains(made.gains, made.plant) if one.level is Level.ERROR]
    assert (made.plant.m, made.plant.sensor.velocity) == (made.gains.m, 'none')
    assert made.plant.sensor.resolution == pytest.approx(2e-5, rel=1e-3)
    limits = dict(zip(need[::2], map(float, need[1::2]), strict=True))
    assert made.gains.effort_limit == limits.get('--effort-limit', 0.0)
    if '--stiffness' in limits:
        assert limits['--stiffness'] == made.gains.K
    else:
        assert design['settling_time'] <= limits['--settling-time']
    assert status_of('simulate', file, bag) == 0
    run = read_bag(bag)
    assert run.position[0] == pytest.approx(0.1, abs=1e-4)
    axis = replace(AXIS, x_0=0.1, time_step=1e-3)
    true = simulate(axis, made.gains, round(3.0 * design['settling_time'], 3))
    for time, error in ((run.time, run.position), (true.time, true.position)):
        assert settling_time(time, error, design['band']) <= 1.2 * design['settling_time']
    assert np.abs(true.effort).max() <= 1.2 * design['peak_effort']
    rest = 1.5 * design['settling_time'] / 1e-3
    assert np.count_nonzero(true.events['tick'] > rest) == 0


def test_a_requirement_that_cannot_be_met_is_refused_with_the_nearest_that_can(
    moved, tmp_path, capsys
):
    file = tmp_path / 'axis.yaml'
    for option, value, more, found in (
        ('--settling-time', 0.02, (), r'nearest that can is --settling-time (\S+)'),
        ('--stiffness', 1e-3, (), r'nearest that can be met is --stiffness (\S+)'),
        ('--effort-limit', 0.9, ('--stiffness', 60), r'must be above (\S+) N'),
    ):
        refused = status_of('identify', moved, '--write', file, *STEP, option, value, *more)
        errors = capsys.readouterr().err
        assert refused == 2, errors
        assert not file.exists()
        nearest = float(re.search(found, errors)[1].rstrip(','))
        met = 1.02 * nearest
        assert status_of('identify', moved, '--write', file, *STEP, option, met, *more) == 0
        file.unlink()
    assert [*tmp_path.iterdir()] == []
