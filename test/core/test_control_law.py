"""The control law of one sample: guards, gains, memory, limits."""

from dataclasses import replace

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import (
    COMMAND,
    control_in_place,
    control_step,
    FRESH,
    NO_IMPULSE,
    POSITION_ZERO,
    STATES,
    STICKING,
    VELOCITY_ZERO,
)
from impulse_control_ros.core.supervision import SUPERVISION

M, K, D, D_BAR, STEP = 0.1, 10.0, 0.5, 1.5, 1e-4


def answers(samples, gains=None):
    """
    Answer a sequence of (position, velocity); a third entry changes gains from there on.

    The law without options and the one with all of them off do, and say the same to the bit.
    """
    plain, state, command = FRESH, np.zeros(STATES), np.zeros(1, COMMAND)
    memory = np.zeros(1, SUPERVISION)
    given_answers, changes = [], [gains or ControlGains()]
    for position, velocity, *change in samples:
        changes += change
        if changes:
            gains = changes.pop()
        law = replace(gains, supervision=False).packed().view(float)
        control_in_place(state, memory, law, position, velocity, command)
        expected, plain = control_step(plain, gains.values, None, None, position, velocity)
        assert np.array(command[0].item()[:2]).tobytes() == np.array(expected[:2]).tobytes()
        assert command[0]['guard'] == expected.guard
        given_answers.append(command[0].copy())
    return np.array(given_answers, COMMAND)


def pd(position, velocity, x_r=0.0):
    return K * (x_r - position) - D * velocity


@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize('direction', [-1.0, 1.0])
@pytest.mark.parametrize('ratio', [0.5, 0.6, 0.9])
def test_a_position_zero_gives_minus_two_alpha_against_the_motion(side, direction, ratio):
    velocity = direction * 3.0
    given_answers = answers(
        [(side * 1e-3, velocity), (-side * 1e-3, velocity)], ControlGains(alpha_ratio=ratio)
    )
    assert list(given_answers['guard']) == [NO_IMPULSE, POSITION_ZERO]
    assert given_answers['area'][1] == pytest.approx(-2 * ratio * M * 3.0 * direction)
    assert given_answers['effort'][1] == pytest.approx(
        pd(-side * 1e-3, velocity) + given_answers['area'][1] / STEP
    )


@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize(('before', 'after'), [(1.0, -1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, 0.0)])
@pytest.mark.parametrize('c', [1.0, 2.0])
def test_a_velocity_zero_gives_minus_two_beta_towards_the_set_point(side, before, after, c):
    given_answers = answers([(side * 0.2, before), (side * 0.2, after)], ControlGains(c=c))
    assert list(given_answers['guard']) == [NO_IMPULSE, VELOCITY_ZERO]
    assert given_answers['area'][1] == pytest.approx(-2.0 * side * 0.2 * D_BAR / (2 * c))


@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize('c', [1.0, 2.0])
def test_a_stick_gives_minus_one_beta_at_every_sample(side, c):
    given_answers = answers([(side * 0.05, side), *[(side * 0.05, 0.0)] * 4], ControlGains(c=c))
    assert list(given_answers['guard']) == [NO_IMPULSE, VELOCITY_ZERO, *[STICKING] * 3]
    assert given_answers['area'][2:] == pytest.approx(-side * 0.05 * D_BAR / (2 * c))


@pytest.mark.parametrize(
    ('position', 'velocity', 'guard'),
    [
        (0.5, 0.0, VELOCITY_ZERO),
        (-0.5, 0.0, VELOCITY_ZERO),
        (0.0, 1.0, POSITION_ZERO),
        (0.0, 0.0, NO_IMPULSE),
        (0.5, 1.0, NO_IMPULSE),
    ],
)
def test_the_first_sample_acts_when_it_lies_on_a_guard(position, velocity, guard):
    assert answers([(position, velocity)])['guard'][0] == guard


def test_the_first_impulse_gives_the_induced_velocity_of_25():
    assert answers([(0.5, 0.0)])['area'][0] / M == pytest.approx(-0.5 * D_BAR / (2 * M))


@pytest.mark.parametrize('errors', [[1, 0, -1], [1, 0, 0, -1], [1, 0, 1], [1, -1], [-1, 0, 1]])
def test_an_exact_zero_neither_hides_nor_doubles_a_crossing(errors):
    given_answers = answers([(error * 1e-3, -errors[0] * 2.0) for error in errors])
    assert list(given_answers['guard']).count(POSITION_ZERO) == 1


def test_tiny_errors_change_sign_like_any_other():
    given_answers = answers([(5e-324, -1.0), (-5e-324, -1.0)])
    assert given_answers['guard'][1] == POSITION_ZERO


def test_a_sample_at_both_guards_acts_as_a_position_zero():
    given_answers = answers([(1e-3, -2.0), (-1e-3, 1.0)])
    assert given_answers['guard'][1] == POSITION_ZERO
    assert given_answers['area'][1] < 0.0


def test_a_jump_of_our_own_is_no_velocity_zero():
    given_answers = answers([(1e-3, -2.0), (-1e-3, -2.0), (-1e-3, 0.4), (-5e-4, 0.4)])
    assert list(given_answers['guard']) == [NO_IMPULSE, POSITION_ZERO, NO_IMPULSE, NO_IMPULSE]


def test_a_set_point_jump_over_the_position_is_no_position_zero():
    given_answers = answers([(0.25, -4.0), (0.2496, -4.0, ControlGains(x_r=0.3)), (0.2492, -4.0)])
    assert list(given_answers['guard']) == [NO_IMPULSE] * 3


def test_a_set_point_jump_at_rest_acts_like_a_start():
    given_answers = answers([(0.0, 0.0), (0.0, 1e-47), (0.0, 1e-47, ControlGains(x_r=0.3))])
    assert list(given_answers['guard']) == [NO_IMPULSE, NO_IMPULSE, VELOCITY_ZERO]
    assert given_answers['area'][2] == pytest.approx(0.3 * D_BAR / 2)


@pytest.mark.parametrize(('offset', 'first'), [(0.0, 10), (0.25, 10), (0.75, 10), (-0.25, 11)])
def test_a_set_point_ramp_is_crossed_once(offset, first):
    step = 2.0**-12  # sums of it are exact; the error grows by half of it at each sample
    ramp = [
        (step * (k + offset / 2), 1.0, ControlGains(x_r=step * (5 + 0.5 * k))) for k in range(15)
    ]
    assert list(np.flatnonzero(answers(ramp)['guard'])) == [first]


def test_inside_the_dead_bands_there_is_no_impulse():
    gains = ControlGains(position_deadband=1e-3, velocity_deadband=0.05)
    wiggle = [((-1) ** k * 9e-4, (-1) ** (k // 2) * 0.04) for k in range(40)]
    assert not answers(wiggle, gains)['guard'].any()
    assert answers([(1e-3, 1.0), (-1e-3, 0.06)], gains)['guard'][1] == POSITION_ZERO
    assert answers([(1.1e-3, 1.0), (1.1e-3, 0.04)], gains)['guard'][1] == VELOCITY_ZERO


@pytest.mark.parametrize('hold_off', [0, 1, 5])
def test_no_impulse_starts_for_hold_off_samples_after_a_position_zero(hold_off):
    zigzag = [((-1) ** k * 1e-3, 2.0) for k in range(60)]
    fired = np.flatnonzero(answers(zigzag, ControlGains(hold_off=hold_off))['guard'])
    assert len(fired) > 5
    assert np.diff(fired).min() == hold_off + 1


def test_without_impulses_the_law_is_pd_to_the_last_bit():
    samples = [((-1) ** k * 0.1, 2.0 - 0.5 * k) for k in range(12)]
    given_answers = answers(samples, ControlGains(impulses=False))
    assert list(given_answers['effort']) == [K * (0.0 - x) - D * v for x, v in samples]
    assert not given_answers['guard'].any()


@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize('wrong', [-1e4, 1e4])
def test_the_area_of_one_wrong_sample_does_not_drive_the_axis_away(side, wrong):
    limited = ControlGains(effort_limit=20.0)
    away = [(k * 1e-4 * side, side) for k in (-2, -1, 1)]
    given_answers = answers(
        [*away[:2], (away[2][0], wrong), *[(2e-4 * side, side)] * 2, *[(-2e-4 * side, -side)] * 2],
        limited,
    )
    assert abs(given_answers['area'][2]) == pytest.approx(1200.0)
    pushes = [answer['effort'] * side for answer in given_answers[3:]]
    # that of the wrong sign leaves at once, the other one brakes and leaves at the set-point
    assert max(pushes[:2]) < 0.0
    assert given_answers['effort'][-1] * side == limited.effort_limit  # against the motion


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-0.5, 0.5), st.floats(-5.0, 5.0)), min_size=1, max_size=30),
    st.floats(10.0, 100.0),
)
def test_an_effort_limit_holds_and_keeps_the_area_of_every_impulse(samples, limit):
    gains = ControlGains(effort_limit=limit)
    # At rest in the set-point nothing new fires, and what waits can leave.
    owed = np.abs(answers(samples, gains)['area']).sum()
    rest = [(0.0, 0.0)] * (2 + int(owed / (limit * STEP)))
    given_answers = answers(samples + rest, gains)
    assert (np.abs(given_answers['effort']) <= limit).all()
    waits = 0.0
    for (x, v), answer in zip(samples + rest, given_answers, strict=True):
        if np.sign(waits + answer['area']) == np.sign(x) == np.sign(v):
            waits = 0.0
        feedback = np.clip(pd(x, v), -limit, limit)
        waits += answer['area'] - (answer['effort'] - feedback) * STEP
    assert waits == pytest.approx(0.0, abs=1e-9)


def test_impulses_switched_off_leave_nothing_of_one_that_waits():
    limited = ControlGains(effort_limit=20.0)
    off = ControlGains(effort_limit=20.0, impulses=False)
    given_answers = answers([(0.5, 0.0, limited), (0.5, 0.0, off), (0.5, -1.0, limited)])
    assert list(given_answers['effort'][1:]) == [pd(0.5, 0.0), pd(0.5, -1.0)]


def test_while_an_impulse_waits_the_velocity_guards_rest():
    given_answers = answers(
        [(0.5, 0.0), (0.5, 0.0), (0.5, -0.01), (0.5, 0.01)], ControlGains(effort_limit=20.0)
    )
    assert list(given_answers['guard']) == [VELOCITY_ZERO, NO_IMPULSE, NO_IMPULSE, NO_IMPULSE]


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), max_size=20))
def test_the_effort_is_finite_and_an_impulse_never_pumps_a_crossing(samples):
    for sample, answer in zip(samples, answers(samples), strict=True):
        assert np.isfinite(answer['effort'])
        if answer['guard'] == POSITION_ZERO:
            assert answer['area'] * sample[1] < 0.0
            assert abs(sample[1] + answer['area'] / M) < abs(sample[1])
        elif answer['guard']:
            assert answer['area'] * sample[0] < 0.0
