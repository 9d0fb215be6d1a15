"""What a law has learnt, read from its memory at chosen samples."""

from dataclasses import replace
import math

import numpy as np
import pytest

from impulse_control_ros.core.replay import answered, learnt_at, Piece, run_again
from impulse_control_ros.core.sampled_controller import SampledController
from impulse_control_ros.files.parameter_file import load_experiment
from test.conftest import CONFIG

COUNT = 4000


@pytest.fixture(scope='module')
def made():
    return load_experiment(CONFIG / 'underdamped.yaml')


def states_of(made, mass, gains):
    axis = replace(made.plant, m=mass)
    pieces = [Piece(0, axis, gains, True, axis)]
    states, answers = run_again(COUNT, pieces)
    return (states['position'], states['velocity'], pieces), answers


def test_the_mass_is_unknown_before_the_first_jump_and_then_the_right_one(made):
    run, answers = states_of(made, 0.25, made.gains)
    judged = int(np.flatnonzero(answers['verdict'])[0])
    before, after, end = learnt_at([judged - 1, judged, COUNT - 1], *run)
    assert math.isnan(before.mass)
    assert math.isnan(before.mass_spread)
    assert before.used_mass == made.gains.m
    assert after.mass == pytest.approx(0.25, rel=1e-2) == after.used_mass
    assert after.mass_spread == 0.0
    assert (end.delay, end.suspended, end.velocity_noise) == (0.0, 0.0, 0.0)


def test_a_suspension_begins_at_one_sample_and_then_runs_out(made):
    gains = replace(made.gains, learn_mass=False)
    run, answers = states_of(made, 0.048, gains)
    second = int(np.flatnonzero(answers['verdict'])[1])
    at = learnt_at([second - 1, second, second + 1000], *run)
    assert [one.suspended for one in at] == [0.0, 1.0, pytest.approx(0.9)]
    assert [one.is_suspended_anew for one in at] == [False, True, False]
    assert at[1].used_mass == gains.m
    assert not answers['guard'][second : second + 1000].any()


def test_the_node_reads_the_same_as_the_replay(made):
    run, answers = states_of(made, 0.25, made.gains)
    position, velocity, pieces = run
    law = SampledController(made.gains)
    for x, v, expected in zip(position, velocity, answers, strict=True):
        assert law.answer(float(x), float(v)) == expected.item()
    assert law.learnt() == learnt_at([COUNT - 1], *run)[0]
    assert not law.suspended
    assert answered(position, velocity, pieces).tobytes() == answers.tobytes()


def test_supervision_that_is_switched_on_in_mid_run_begins_there(made):
    axis, off = made.plant, replace(made.gains, supervision=False)
    on = replace(made.gains, x_r=0.3)
    pieces = [Piece(0, axis, off, True, axis), Piece(15_000, axis, on, False, None)]
    states, answers = run_again(30_000, pieces)
    assert not answers['verdict'][:15_000].any()
    assert {*answers['verdict'][15_000:]} == {0, 1}
    assert abs(states['position'][-1] - 0.3) < 1e-6


def test_supervision_that_is_switched_off_and_on_again_begins_anew(made):
    axis = replace(made.plant, m=0.25)
    off, again = replace(made.gains, supervision=False), replace(made.gains, x_r=0.3)
    pieces = [
        Piece(0, axis, made.gains, True, axis),
        Piece(8000, axis, off, False, None),
        Piece(9000, axis, again, False, None),
    ]
    states, _ = run_again(10_000, pieces)
    run = states['position'], states['velocity'], pieces
    known, anew, end = learnt_at([7999, 9000, 9999], *run)
    assert known.mass == pytest.approx(0.25, rel=1e-2) == end.mass
    assert math.isnan(anew.mass)
    assert anew.used_mass == made.gains.m
