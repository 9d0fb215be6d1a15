"""Bags of computed runs with changes in them, computed again: whoever recorded them."""

from dataclasses import replace
import json

import pytest

from impulse_control_ros.core.control_law import POSITION_ZERO
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.replay import Piece
from impulse_control_ros.files.cdr import JointStateLayout
from test.command_lines import status_of
from test.files.test_bag import RUN, START, STEP
from test.tools.bags import (
    all_told,
    begun,
    COMMANDS,
    computed,
    CONTROLLER,
    entries,
    event_count,
    experiment,
    finished,
    PARAMETERS,
    PLANT,
    recorded_elsewhere,
    sent,
    STATES,
    told,
    WALL,
)

OTHER, COUNT = '/other#0000', 3001


@pytest.fixture(scope='module')
def made():
    return experiment('time_varying')


def taken_over(made):
    """Another controller with other gains takes over, and later the first one again."""
    axis, ours = made.plant, made.gains
    other = replace(ours, K=12.0, d_bar=1.25, x_r=0.1)
    yield [
        Piece(0, axis, ours, True, axis),
        Piece(1000, axis, other, True, None),
        Piece(2000, axis, ours, True, None),
    ]
    yield [told(OTHER, other.flat(), tick=1000), told(CONTROLLER, ours.flat(), tick=2000)]
    yield {1000: {'author': OTHER, 'named': CONTROLLER}, 2000: {'named': OTHER}}


def reset(made):
    """The plant is reset, and starts elsewhere for what was set before."""
    axis, ours = made.plant, made.gains
    moved = replace(axis, x_0=0.3)
    yield [
        Piece(0, axis, ours, True, axis),
        Piece(500, moved, ours, False, None),
        Piece(1000, moved, ours, True, moved),
    ]
    yield [told(PLANT, moved.flat(), ['x_0'], 500)]
    yield {1000: {'episode': 1}}


def tuned(made):
    """Both nodes are tuned, once at one stamp."""
    axis, ours = made.plant, made.gains
    rough, heavy = replace(axis, F_c=0.3), replace(axis, F_c=0.3, m=0.12)
    stiff, moved = replace(ours, K=12.0), replace(ours, K=12.0, x_r=0.2)
    yield [
        Piece(0, axis, ours, True, axis),
        Piece(500, rough, ours, False, None),
        Piece(1000, heavy, stiff, False, None),
        Piece(2000, heavy, moved, False, None),
    ]
    yield [
        told(PLANT, rough.flat(), ['F_c'], 500),
        told(PLANT, heavy.flat(), ['m'], 1000),
        told(CONTROLLER, stiff.flat(), ['K'], 1000),
        told(CONTROLLER, moved.flat(), ['x_r'], 2000),
    ]
    yield {}


def reactivated(made):
    """The controller is activated again where its memory would have known of a crossing."""
    axis, ours = made.plant, made.gains
    begun = Piece(0, axis, ours, True, axis)
    ((_, run, _),) = computed([begun], COUNT)
    crossing = int(next(one['tick'] for one in run.events if one['guard'] == POSITION_ZERO))
    yield [begun, Piece(crossing, axis, ours, True, None)]
    yield [told(CONTROLLER, ours.flat(), tick=crossing)]
    yield {}


def messages_of(made, case):
    """Return the messages of a run in the order of our recorder."""
    pieces, changes, hows = case(made)
    messages = [*all_told(made), *changes]
    for first, run, applied in computed(pieces, COUNT):
        messages += entries(run, first, applied=applied, **hows.get(first, {}))
    return sorted(messages, key=lambda one: (one[0], one[1] != PARAMETERS))


def ours(folder, made, messages):
    writer = begun(folder, made, told_by=())
    writer.write(messages)
    return finished(writer)


def elsewhere(folder, made, messages):
    return recorded_elsewhere(folder, sent(messages))


def elsewhere_late(folder, made, messages):
    """Parameters come late, repeated or out of order, as from several writers."""
    times = [
        [time + (10**7 if raw[1] == '/run_parameters' else 0), *raw]
        for time, *raw in sent(messages)
    ]
    again = [[time + 7, *raw] for time, *raw in times[::7]]
    return recorded_elsewhere(folder, sorted([*times, *again]))


@pytest.mark.parametrize('record', [ours, elsewhere, elsewhere_late])
@pytest.mark.parametrize('case', [taken_over, reset, tuned, reactivated])
def test_a_run_with_changes_in_it_is_the_same_to_the_bit(tmp_path, capsys, made, case, record):
    bag = record(tmp_path / 'bag', made, messages_of(made, case))
    for how in ('--closed-loop', '--controller'):
        status = status_of('replay', bag, how)
        said = capsys.readouterr()
        assert said.err == ''
        assert status == 0, said.out
        assert f' {COUNT} compared, 0 differ' in said.out


@pytest.mark.parametrize('case', [taken_over, tuned, reactivated])
def test_without_the_changes_it_differs(tmp_path, capsys, made, case):
    start = START + STEP
    bag = ours(
        tmp_path / 'bag',
        made,
        [one for one in messages_of(made, case) if one[1] != PARAMETERS or one[0] < start],
    )
    assert status_of('replay', bag, '--closed-loop') == 1
    assert 'it differs' in capsys.readouterr().out


def test_what_a_bag_lacks_is_said_in_one_line_and_the_run_chosen_by_name(tmp_path, capsys, made):
    axis = made.plant
    ((_, run, _),) = computed([Piece(0, axis, made.gains, True, axis)], 301)
    ((_, long, _),) = computed([Piece(0, axis, made.gains, True, axis)], 401)
    other = '89abcdef'
    bag = recorded_elsewhere(
        tmp_path / 'bag',
        [
            *sent([*all_told(made), *entries(run)]),
            *sent([*all_told(made, other), *entries(long, run=other)], WALL + 10**12),
        ],
    )
    count = 2 * 301 + event_count(run)
    assert status_of('replay', bag, '--closed-loop') == 0
    said = capsys.readouterr()
    assert ' 401 compared, 0 differ' in said.out
    assert said.err == (
        f'replay: warning: {bag}: incomplete: run {RUN} is left out ({count} messages)\n'
    )
    assert status_of('replay', bag, '--closed-loop', '--run', RUN) == 0
    assert ' 301 compared, 0 differ' in capsys.readouterr().out
    assert status_of('replay', bag, '--closed-loop', '--run', 'x') == 2
    assert 'run x is not in it' in capsys.readouterr().err


def test_a_bag_that_begins_in_mid_run_is_answered_and_not_run_again(tmp_path, capsys, made):
    messages = messages_of(made, taken_over)
    # a reset or a state that names nobody is no start of a run
    bag = elsewhere(
        tmp_path / 'bag',
        made,
        [one for one in messages if one[1] == PARAMETERS or one[0] >= START + 1000 * STEP],
    )
    assert status_of('replay', bag, '--closed-loop') == 2
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith(
        f'replay: warning: {bag}: incomplete: the bag begins in mid-run, at 1.1'
    )
    assert said[1] == f'replay: {bag}: the bag begins in mid-run, at 1.100000000 s'
    assert status_of('replay', bag, '--controller') == 0
    assert f' {COUNT - 1000} compared, 0 differ' in capsys.readouterr().out


def test_a_difference_is_put_down_to_a_controller_that_began_before_the_bag(
    tmp_path, capsys, made
):
    axis, gains = made.plant, replace(made.gains, K_i=3.0)
    ((_, run, _),) = computed([Piece(0, axis, gains, True, axis)], 301)
    messages = [told(CONTROLLER, gains.flat(), run=''), *entries(run, run='')]
    same = 'every message is the same, to the bit'
    differs = (
        'it differs: the recording begins 0.010000000 s after the controller, whose memory at '
        'that time is unknown'
    )
    late = START + 100 * STEP
    for number, (missing, last) in enumerate(
        (((), same), ((STATES,), differs), ((COMMANDS,), differs), ((STATES, COMMANDS), differs))
    ):
        bag = elsewhere(
            tmp_path / f'bag{number}',
            made,
            [one for one in messages if one[1] not in missing or one[0] >= late],
        )
        assert status_of('replay', bag, '--controller') == (last == differs)
        assert capsys.readouterr().out.splitlines()[-1] == last


def test_a_foreign_plant_is_answered_with_the_parameters_of_its_controller(tmp_path, capsys, made):
    axis, gains = made.plant, made.gains
    other = replace(gains, x_r=0.2)
    (_, one, _), (_, two, effort) = computed(
        [Piece(0, axis, gains, True, axis), Piece(200, axis, other, False, None)], 301
    )
    changes = [
        told(CONTROLLER, gains.flat(), run=''),
        told(CONTROLLER, other.flat(), ['x_r'], 200, run=''),
    ]
    messages = sorted(
        [*changes, *entries(one, run=''), *entries(two, 200, '', applied=effort)],
        key=lambda message: (message[0], message[1] != PARAMETERS),
    )
    bag = recorded_elsewhere(tmp_path / 'bag', sent(messages))
    assert status_of('replay', bag, '--controller') == 0
    said = capsys.readouterr()
    assert (said.err, ' 301 compared, 0 differ' in said.out) == ('', True)
    assert status_of('replay', bag, '--closed-loop') == 2
    assert 'no node of it has the parameters of a plant; its nodes: /controller' in (
        capsys.readouterr().err
    )


def test_a_withdrawn_effort_clears_the_memory(tmp_path, capsys, made):
    pieces, _, _ = reactivated(made)
    (_, one, _), (at, two, effort) = computed(pieces, 2001)
    zero = JointStateLayout('axis', f'run:{RUN}.0 {CONTROLLER}', ('effort',)).encode(0, 0, 0.0)
    withdrawn = START + (at - 1) * STEP, COMMANDS, zero
    for number, (more, expected) in enumerate((([withdrawn], 0), ([], 1))):
        messages = [*all_told(made), *entries(one), *more, *entries(two, at, applied=effort)]
        for record in (ours, elsewhere):
            bag = record(tmp_path / f'{record.__name__}{number}', made, messages)
            assert status_of('replay', bag, '--closed-loop') == expected
            capsys.readouterr()


def test_parameters_that_are_none_of_ours_are_refused_in_one_line(tmp_path, capsys, made):
    axis = made.plant
    ((_, run, _),) = computed([Piece(0, axis, made.gains, True, axis)], 301)
    for node, values, said in (
        (CONTROLLER, {**made.gains.flat(), 'gain': 3.0}, 'gain = 3.0'),
        (PLANT, {**axis.flat(), 'joint_name': 'lift'}, "joint_name = 'axis'"),
    ):
        both = [*all_told(made), *entries(run)]
        both = [
            told(node, values) if one[1] == PARAMETERS and node.encode() in one[2] else one
            for one in both
        ]
        bag = ours(tmp_path / node[1:6], made, both)
        assert status_of('replay', bag, '--controller') == 2
        err = capsys.readouterr().err
        assert said in err
        assert len(err.splitlines()) == 1


def test_a_state_without_its_stamp_is_in_no_run(tmp_path, capsys, made):
    axis = made.plant
    ((_, run, _),) = computed([Piece(0, axis, made.gains, True, axis)], 301)
    nothing = JointStateLayout('axis', f'run:{RUN}.0').encode(0, 0, 9.0, 9.0, 9.0)
    messages = [(START, STATES, nothing), *all_told(made), *entries(run)]
    bag = elsewhere(tmp_path / 'bag', made, messages)
    assert status_of('replay', bag, '--closed-loop') == 0


def test_a_plant_that_was_tuned_before_its_start_starts_as_it_tells_last(tmp_path, capsys, made):
    axis, gains = made.plant, made.gains
    moved, heavy = replace(axis, x_0=0.3), replace(axis, x_0=0.3, m=0.12)
    ((_, run, _),) = computed([Piece(0, heavy, gains, True, moved)], 301)
    messages = [
        told(PLANT, axis.flat()),
        told(PLANT, moved.flat(), ['x_0']),
        told(PLANT, moved.flat()),
        told(PLANT, heavy.flat(), ['m']),
        told(CONTROLLER, gains.flat()),
        *entries(run),
    ]
    for record in (ours, elsewhere):
        bag = record(tmp_path / record.__name__, made, messages)
        assert status_of('replay', bag, '--closed-loop') == 0
        said = capsys.readouterr()
        assert (said.err, ' 301 compared, 0 differ' in said.out) == ('', True)


def test_a_bag_from_before_there_was_supervision_is_answered_without_it(tmp_path, capsys, made):
    plain = replace(made, gains=replace(made.gains, supervision=False))
    axis, gains = plain.plant, plain.gains
    ((_, run, _),) = computed([Piece(0, axis, gains, True, axis)], COUNT)
    assert len(run.events)
    assert not len(run.verdicts)
    new = ('supervision', 'learn_mass', 'mass_ratio_limits.lower', 'mass_ratio_limits.upper')
    old = {name: value for name, value in gains.flat().items() if name not in new}
    bag = ours(
        tmp_path / 'bag',
        plain,
        [told(PLANT, axis.flat()), told(CONTROLLER, old), *entries(run)],
    )
    for how in ('--controller', '--closed-loop'):
        assert status_of('replay', bag, how) == 0
        assert 'every message is the same, to the bit' in capsys.readouterr().out
    assert status_of('replay', bag, '--controller', '-p', 'supervision:=true') == 1
    said = capsys.readouterr().out
    assert 'confirmed at ' in said
    assert ' is only replayed' in said


def test_a_verdict_that_the_law_does_not_give_is_a_difference(tmp_path, capsys, made):
    axis = made.plant
    ((_, run, _),) = computed([Piece(0, axis, made.gains, True, axis)], COUNT)
    run.verdicts[0]['verdict'] = VERDICTS.index('absent')
    bag = ours(tmp_path / 'bag', made, [*all_told(made), *entries(run)])
    assert status_of('replay', bag, '--controller') == 1
    said = capsys.readouterr().out
    assert 'absent at ' in said
    assert 'confirmed at ' in said
    assert status_of('analyze', bag, '--format', 'json') == 0
    (found,) = json.loads(capsys.readouterr().out)
    assert found['absent'] == 1
    assert found['learnt_mass'] is None  # by other verdicts than those of the law
