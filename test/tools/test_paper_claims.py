"""The numbers behind the paper's claims, by closed forms that import nothing of ours."""

from dataclasses import replace
from math import atan2, copysign, cos, exp, inf, log, pi, sin, sqrt

import pytest

from impulse_control_ros.tools.paper.claim import Claim, Measured
from impulse_control_ros.tools.paper.friction_claims import both_axes, converges, sticks
from impulse_control_ros.tools.paper.gain_claims import critical, reaches_zero
from impulse_control_ros.tools.paper.response_claims import (
    bounded_damping,
    comparable,
    critical_response,
    faster,
    peak_velocity,
)

# Table I, written once more.
m, K, D, F_c, d_low, d_bar = 0.1, 10.0, 0.5, 1.0, 0.15, 1.5
W2, JUMP = K / m, d_bar / (2 * m)  # JUMP: v+ = -JUMP e, (25)


def damped(d):
    """Return g and r of e'' + 2 g e' + (g^2 + r^2) e = 0."""
    g = (d + D) / (2 * m)
    return g, sqrt(W2 - g * g)


def first_zero(d, v):
    """Return the time of the first e = 0 from e = 1 and the velocity v."""
    g, r = damped(d)
    return atan2(r, -(v + g)) / r


def motion(d, e, v, t):
    """Return error and velocity after t."""
    g, r = damped(d)
    decay, c, s = exp(-g * t), cos(r * t), sin(r * t) / r
    return decay * (e * c + (v + g * e) * s), decay * (v * c - (W2 * e + g * v) * s)


def stop(d, e, v):
    """Return time and error of the next velocity zero of the moving axis."""
    g, r = damped(d)
    side = copysign(1.0, v)
    t = atan2(side * v * r, side * (W2 * e + g * v)) / r if v else pi / r
    return t, motion(d, e, v, t)[0]


def bounce():
    """Return by what the error shrinks from turn to turn when v is reversed at e = 0."""
    t = first_zero(d_low, -JUMP)
    return stop(d_low, 0.0, -motion(d_low, 1.0, -JUMP, t)[1])[1]


def friction_stop(e):
    """Return time and error of the stop after the jump (25), with friction."""
    t, shifted = stop(d_low, e - F_c / K, -JUMP * e)
    return t, shifted + F_c / K


def least_start():
    """Return the start from which the axis with friction just reaches e = 0."""
    low, high = 0.1, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if friction_stop(middle)[1] > 0 else (low, middle)
    return high


T1 = first_zero(d_low, -JUMP)
V1 = motion(d_low, 0.5, -0.5 * JUMP, T1)[1]
G, R = damped(d_low)
PD_STOP = stop(d_low, 0.15 - F_c / K, 0.0)
OVERSHOOT = 0.5 * exp(-G * pi / R)
FLOORS = [1e3 * F_c / (d_bar / (2 * dt) + K) for dt in (1e-3, 1e-4, 1e-5)]
FASTEST = max(-motion(d_low, 0.5, -0.5 * JUMP, T1 * i / 1e4)[1] for i in range(10_001))
PD_FASTEST = max(-motion(d_low, 0.5, 0.0, 0.2 * i / 1e4)[1] for i in range(10_001))


@pytest.mark.parametrize(
    ('key', 'at', 'value', 'truth', 'tolerance'),
    [
        ('one successor', 0, 0, -0.5 * JUMP, 1e-12),
        ('one successor', 1, 0, 0.2, 1e-12),
        ('one successor', 1, 1, 10, 0),
        ('alpha stops', 0, 0, T1, 1e-12),
        ('alpha stops', 1, 0, T1, 3e-4),
        ('alpha too small', 0, 0, T1, 1e-12),
        ('alpha too small', 1, 0, -0.2 * 0.5 * bounce(), 1e-12),
        ('alpha cycles', 0, 0, T1, 1e-12),
        ('alpha cycles', 1, 0, bounce(), 1e-9),
        # D acts over the whole sample of a reversal, d on its two halves against each other
        ('alpha cycles', 2, 0, D / m, 2e-2),
        ('alpha range', 0, 0, T1, 1e-12),
        ('alpha range', 1, 0, 0.9 * bounce(), 1e-9),
        ('alpha range', 2, 0, T1, 3e-4),
        ('critical', 0, 0, 4 * m * K, 1e-12),
        ('critical', 0, 2, 2 * sqrt(m * K) - d_bar, 1e-12),
        ('reaches zero', 0, 0, T1, 1e-12),
        ('reaches zero', 0, 1, first_zero(1.0, -JUMP), 1e-12),
        ('reaches zero', 0, 2, first_zero(1.49, -JUMP), 1e-9),
        ('reaches zero', 1, 1, least_start(), 2e-6),
        ('weight of one', 0, 1, 0.5 * FLOORS[1], 1e-3),
        ('weight of one', 1, 0, -JUMP, 1e-12),
        ('critical response', 0, 2, 0.8458, 2e-4),  # 500 (1 + 10 t) exp(-10 t) = 1
        ('oscillates', 0, 0, OVERSHOOT, 3e-4),
        ('oscillates', 0, 2, 2 * pi / R, 3e-4),
        ('oscillates', 0, 3, 1.114, 1e-3),  # this and the next: physics of the case, by mpmath
        ('oscillates', 0, 5, 1.789, 1e-3),
        ('faster', 0, 0, T1, 3e-4),
        ('faster', 1, 0, 0.5950, 2e-4),  # by mpmath
        ('faster', 2, 0, T1, 3e-4),
        ('linear', 0, 0, -0.5 * JUMP, 1e-12),
        ('linear', 0, 1, -FASTEST, 1e-5),
        ('linear', 0, 2, V1, 1e-11),
        ('linear', 0, 4, T1, 1e-12),
        ('linear', 0, 5, first_zero(d_low, 0.0), 1e-8),
        ('peak velocity', 0, 0, FASTEST, 5e-3),
        ('peak velocity', 0, 1, PD_FASTEST, 5e-3),
        ('peak velocity', 0, 3, 1.2 * m * -V1 / 1e-4, 10.0),
        ('minor peaks', 1, 0, 1e3 * 0.2 * 0.5 * bounce(), 1e-9),
        ('minor peaks', 1, 2, 1e3 * OVERSHOOT, 0.3),
        ('sticks', 0, 1, PD_STOP[1] + F_c / K, 1e-12),
        ('sticks', 0, 2, PD_STOP[0], 1e-12),
        ('sticks', 0, 3, PD_STOP[1] + F_c / K, 1e-4),
        ('first stop', 0, 0, friction_stop(0.15)[1], 1e-12),
        ('first stop', 0, 1, friction_stop(0.15)[0], 1e-12),
        ('first stop', 0, 2, -JUMP * friction_stop(0.15)[1], 1e-12),
        ('converges', 0, 0, d_bar / (4 * m), 2e-2),  # m v+ / 2 F_c of each stop, for small errors
        ('converges', 1, 0, FLOORS[0], 0.02 * FLOORS[0]),
        ('converges', 1, 1, FLOORS[1], 0.02 * FLOORS[1]),
        ('converges', 1, 2, FLOORS[2], 0.02 * FLOORS[2]),
        ('converges', 2, 0, friction_stop(0.15)[1], 1e-12),
        ('both axes', 0, 2, 8444, 0),  # by mpmath
    ],
)
def test_a_measured_number_is_that_of_its_closed_form(claims, key, at, value, truth, tolerance):
    assert claims[key].measured[at].values[value] == pytest.approx(truth, abs=tolerance, rel=0)


def test_what_holds_and_what_does_not(claims):
    held = {
        key: ''.join('ny'[one.holds] for one in claim.measured) for key, claim in claims.items()
    }
    assert held == {
        'one successor': 'yn',
        'alpha stops': 'yy',
        'alpha too small': 'nyy',
        'alpha cycles': 'ynn',
        'alpha range': 'yyy',
        'critical': 'y',
        'reaches zero': 'yn',
        'weight of one': 'yn',
        'critical response': 'y',
        'oscillates': 'y',
        'faster': 'yyy',
        'linear': 'y',
        'peak velocity': 'y',
        'minor peaks': 'yny',
        'bounded damping': 'yn',
        'comparable': 'yn',
        'immediate': 'yny',
        'sticks': 'y',
        'first stop': 'y',
        'converges': 'ynn',
        'both axes': 'n',
    }


def test_another_motion_gets_another_judgement(runs):
    overdamped = replace(runs.impulses, gains=replace(runs.impulses.gains, D=1.0))
    assert critical(overdamped).verdict == 'no'
    assert critical_response(runs.pd_lower).verdict == 'no'
    assert faster(runs.pd_lower, runs.pd_lower).verdict == 'no'
    assert peak_velocity(runs.impulses, runs.pd_upper).verdict == 'no'
    assert sticks(runs.pd_lower).verdict == 'no'
    assert both_axes(runs.impulses).verdict == 'yes'
    assert (
        reaches_zero(
            runs.impulses, replace(runs.coulomb, axis=replace(runs.coulomb.axis, x_0=0.3))
        ).verdict
        == 'yes'
    )
    assert bounded_damping(replace(runs.varying, run=runs.pd_upper.run)).measured[1].holds is False
    pairs = ((runs.pd_varying.run, runs.varying.run),)
    ours, theirs = comparable(runs).measured[0].values[:2]
    one = comparable(replace(runs, seeds=pairs)).measured[1]
    assert (one.holds, one.values) == (True, (ours / theirs,) * 3)
    fine = {step: replace(run, position=run.position * 1e-9) for step, run in runs.steps.items()}
    assert converges(replace(runs, steps=fine)).measured[1].holds


@pytest.mark.parametrize(
    ('holds', 'verdict', 'numbers'),
    [
        ((True, True), 'yes', 'here: 1.5 m; 2 s'),
        ((False, False), 'no', 'here: 1.5 m; 2 s'),
        ((True, False), 'with a condition', 'here: yes, 1.5 m; no, 2 s'),
    ],
)
def test_a_claim_holds_in_all_or_nothing_or_under_a_condition_that_is_named(
    holds, verdict, numbers
):
    claim = Claim(
        key='',
        where='',
        says='',
        measured=(
            Measured(holds[0], '{:g} m', (1.5,), 'here'),
            Measured(holds[1], '{:g} s', (2.0,)),
        ),
    )
    assert (claim.verdict, claim.numbers) == (verdict, numbers)


def test_the_closed_forms_above_are_those_of_table_1():
    assert first_zero(d_low, -JUMP) == pytest.approx(0.12143680500356, abs=1e-13)
    assert bounce() == pytest.approx(0.4563166449, abs=1e-9)
    assert first_zero(1.5 - 1e-9, -JUMP) < inf
    assert log(500 * (1 + 8.458)) == pytest.approx(8.458, abs=1e-2)
