"""``analyze --check``: whether recorded runs are solutions of (3) with the control law."""

import csv
from dataclasses import replace
from io import StringIO
import json

import pytest

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.replay import Piece
from test.command_lines import status_of
from test.conftest import CONFIG
from test.files.test_bag import STEP
from test.tools.bags import (
    begun,
    computed,
    CONTROLLER,
    entries,
    EVENTS,
    experiment,
    finished,
    PLANT,
    STATES,
    told,
)
from test.tools.test_resimulate import (
    elsewhere,
    messages_of,
    ours,
    reactivated,
    reset,
    taken_over,
    tuned,
)

EXACT = '--position-error', 0, '--velocity-error', 0


def checks(capsys, bag, *arguments):
    """Return the exit status, and the checks by name."""
    code = status_of('analyze', bag, '--check', '--format', 'json', *arguments)
    return code, {check['name']: check for check in json.loads(capsys.readouterr().out)}


def made(name='coulomb', count=1501, edit=lambda run: None, told_by=None, keep=None, **gains):
    """Return a function that makes the bag of an experiment, ``edit`` ed on the way."""
    experiment_ = experiment(name)
    experiment_ = replace(experiment_, gains=replace(experiment_.gains, **gains))
    axis = experiment_.plant
    ((_, run, _),) = computed([Piece(0, axis, experiment_.gains, True, axis)], count)
    edit(run)

    def write(folder, run_id=None, **how):
        named = {} if run_id is None else {'run': run_id}
        writer = begun(folder, experiment_, told_by=told_by, **named)
        messages = [*entries(run, **named, **how)]
        writer.write(one for at, one in enumerate(messages) if keep is None or keep(at, one))
        return finished(writer)

    return write


@pytest.mark.parametrize('config', sorted(CONFIG.glob('*.yaml')), ids=lambda path: path.stem)
def test_the_bag_of_every_config_passes(tmp_path, capsys, config):
    bag = tmp_path / 'bag'
    assert status_of('simulate', config, bag, '-p', 'duration:=0.5') == 0
    capsys.readouterr()
    assert status_of('analyze', bag, '--check') == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == 'bag'
    assert all(' 0 violated' in line for line in lines[1:])
    assert any(line.split()[:2] == ['momentum', '5000'] for line in lines)


def rewired(made):
    """The sensor and the mass change on the way."""
    axis, gains = made.plant, replace(made.gains, velocity_source='estimated')
    pieces = [Piece(0, axis, made.gains, True, axis)]
    changes = []
    for at, part, values in (
        (500, 'sensor', {'velocity': 'difference'}),
        (1000, 'sensor', {'velocity': 'none', 'resolution': 1e-4}),
        (1500, 'sensor', {'velocity': 'ideal', 'velocity_noise': 1e-3}),
        (2000, 'payload', {'mass': 0.02}),
    ):
        axis = replace(axis, **{part: replace(getattr(axis, part), **values)})
        pieces.append(Piece(at, axis, made.gains, False, None))
        changes.append(told(PLANT, axis.flat(), [f'{part}.{name}' for name in values], at))
    pieces.append(Piece(2500, axis, gains, False, None))
    changes.append(told(CONTROLLER, gains.flat(), ['velocity_source'], 2500))
    yield pieces
    yield changes
    yield {}


@pytest.mark.parametrize('case', [taken_over, reset, tuned, reactivated, rewired])
@pytest.mark.parametrize('how', [ours, elsewhere])
def test_a_run_that_changes_on_the_way_passes_whoever_recorded_it(tmp_path, capsys, how, case):
    varying = experiment('time_varying')
    code, found = checks(capsys, how(tmp_path / 'bag', varying, messages_of(varying, case)))
    assert code == 0, found
    assert found['momentum']['checked'] >= (1999 if case is rewired else 2999)
    assert found['effort']['checked'] == 3001


def test_an_edited_sample_is_named_with_its_stamp_value_and_tolerance(tmp_path, capsys):
    def push(run):
        run.position[700] += 1e-6

    code, found = checks(capsys, made(edit=push)(tmp_path / 'bag'))
    assert code == 1
    violated = {name for name, check in found.items() if check['violations']}
    assert {'position step', 'effort'} <= violated
    assert violated <= {'position step', 'effort', 'momentum', 'impulse area'}
    first = found['position step']
    assert (first['stamp'], first['violations'], first['unit']) == ('1.069900000', 2, 'm')
    assert first['value'] - first['expected'] == pytest.approx(1e-6, rel=1e-3)
    assert 0.0 < first['tolerance'] < 1e-11
    status_of('analyze', tmp_path / 'bag', '--check')
    (line,) = (one for one in capsys.readouterr().out.splitlines() if 'position step' in one)
    assert 'first at 1.069900000 s: ' in line
    assert status_of('analyze', tmp_path / 'bag', '--check', '--format', 'csv') == 1
    (row,) = (
        row
        for row in csv.DictReader(StringIO(capsys.readouterr().out))
        if row['name'] == 'position step'
    )
    assert {name: str(value) if value is not None else '' for name, value in first.items()} == row


def test_an_impulse_that_is_cut_out_of_a_bag_is_a_missed_guard(tmp_path, capsys):
    def cut(run):
        event = run.events.pop(2)
        run.effort[event['tick']] -= event['area'] / 1e-4

    code, found = checks(capsys, made(count=3001, edit=cut)(tmp_path / 'bag'))
    assert code == 1
    assert found['missed velocity_zero']['violations'] == 1
    assert found['missed velocity_zero']['value'] == 'no impulse'
    assert found['missed velocity_zero']['expected'] == GUARDS[2]
    assert found['applied effort']['violations'] == 0  # the plant was told what the bag tells


def test_missing_messages_are_no_violation_and_are_told(tmp_path, capsys):
    without_event = made(keep=lambda at, one: one[1] != EVENTS)(tmp_path / 'events')
    code, found = checks(capsys, without_event)
    assert code == 2  # the law cannot be judged
    assert 'whose event is missing' in found['effort']['note']
    without_state = made(keep=lambda at, one: one[1] != STATES or at % 50)(tmp_path / 'states')
    code, found = checks(capsys, without_state)
    assert code == 0, found
    assert 'samples follow unknown ones' in found['missed sticking']['note']
    assert found['momentum']['checked'] < 1500


def test_a_bag_that_begins_in_mid_run_passes(tmp_path, capsys):
    def is_late(at, one):
        return one[0] > 10**9 + 300 * STEP

    for supervision, guards in ((False, 1199), (True, 0)):
        write = made(keep=is_late, supervision=supervision)
        code, found = checks(capsys, write(tmp_path / f'{supervision}'))
        assert code == 0, found
        assert found['missed velocity_zero']['checked'] == guards
        assert found['effort']['checked'] == 1200


def test_a_foreign_axis_is_judged_by_what_the_paper_supposes(tmp_path, capsys):
    values = experiment('coulomb').gains.flat()
    for name, gains, code in (('right', values, 0), ('heavy', {**values, 'm': 0.4}, 1)):
        bag = made(told_by=[told(CONTROLLER, gains, run='')])(tmp_path / name, run_id='')
        assert 'give --position-error' in checks(capsys, bag)[1]['momentum']['note']
        got, found = checks(capsys, bag, *EXACT)
        assert got == code
        assert bool(found['momentum']['violations']) == bool(code)
        assert found['momentum']['checked'] > 1000
        assert found['position step']['checked'] == 1500


def test_a_bag_without_parameters_says_that_it_cannot_be_checked(tmp_path, capsys):
    bag = made(told_by=[])(tmp_path / 'bag')
    code, found = checks(capsys, bag)
    assert code == 2
    assert 'has the parameters of a' in found['parameters']['note']


def test_of_an_axis_without_velocities_positions_and_commands_are_checked(tmp_path, capsys):
    bag = tmp_path / 'bag'
    how = 'sensor.velocity:=difference', 'velocity_source:=estimated', 'duration:=0.2'
    options = [one for rule in how for one in ('-p', rule)]
    assert status_of('simulate', CONFIG / 'encoder.yaml', bag, *options) == 0
    capsys.readouterr()
    code, found = checks(capsys, bag)
    assert code == 0
    assert found['momentum']['note'] == '2001 velocities were not measured'
    assert found['momentum']['checked'] == 0
    assert found['position step']['checked'] == 2000
    assert found['effort']['checked'] == 2001


@pytest.mark.parametrize(
    ('arguments', 'why'),
    [
        (['--check', '--all'], 'must stand without --all'),
        (['--check', '--report', 'x.html'], 'must stand without --all'),
        (['--position-error', '0', '--velocity-error', '0'], 'with --check'),
        (['--check', '--position-error', '0'], 'must be given both'),
        (['--check', '--position-error', '-1', '--velocity-error', '0'], 'must be finite, >= 0'),
        (['--check', '--position-error', 'nan', '--velocity-error', '0'], 'must be finite, >= 0'),
    ],
)
def test_options_that_do_not_go_together_are_refused(capsys, arguments, why):
    assert status_of('analyze', 'bag', *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert why in line
