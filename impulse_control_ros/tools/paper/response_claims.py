"""The claims of sections IV, IV-A and IV-B, on Figs. 1 to 4."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impulse_control_ros.core.hybrid import End, Solution, solve
from impulse_control_ros.core.metrics import first_position_zero, overshoot, peak, settling_time
from impulse_control_ros.core.simulate import Run
from impulse_control_ros.tools.paper.claim import claim, Measured
from impulse_control_ros.tools.paper.gain_claims import (
    FINE,
    ONE_JUMP,
    SAMPLED,
    settled,
    SOON,
    STRICT,
    TINY,
    turns,
)
from impulse_control_ros.tools.paper.runs import Case, Runs

NEGLIGIBLE = 1e-2  # of the start: what we take for negligible
FIG_1, FIG_2 = 'Fig. 1, section IV', 'Fig. 2, section IV-A'
FIG_3, FIG_4 = 'Fig. 3, section IV-B', 'Fig. 4, section IV-B'


def settled_exactly(solution: Solution, time: np.ndarray, tolerance: float = FINE) -> float:
    """Return the settling time [s] of a solution on a grid of times."""
    return settling_time(time, solution.at(time)[0], tolerance)


def zero_of(run: Run) -> tuple[float, float]:
    """Return when [s] the position first is 0, between its samples, and the velocity before."""
    at = first_position_zero(run.position)
    assert at is not None
    velocity = float(run.velocity[at - 1])
    return float(run.time[at - 1] + run.position[at - 1] / abs(velocity)), velocity


@claim(FIG_1, 'at the upper bound of the damping, PD alone responds critically damped')
def critical_response(pd: Case) -> Iterator[Measured]:
    beyond = overshoot(pd.run.position)
    critical = pd.axis.x_0 * (1.0 + 10.0 * pd.run.time) * np.exp(-10.0 * pd.run.time)
    apart = peak(pd.run.position - critical)
    yield Measured(
        beyond == 0.0 and apart < 1e-3,
        'no overshoot ({:.0f} m), at most {:.2f} mm off the closed form (the '
        'hold of one sample), within 1e-3 m from {:.4f} s',
        (beyond, 1e3 * apart, settled(pd.run)),
    )


@claim(FIG_1, 'at the lower bound it oscillates, and converges after several periods')
def oscillates(pd: Case) -> Iterator[Measured]:
    run, zeros = pd.run, np.flatnonzero(np.diff(np.sign(pd.run.position)))
    parts = np.split(run.position, zeros + 1)[1:]
    swings = sum(peak(part) > NEGLIGIBLE * pd.axis.x_0 for part in parts)
    period, late = run.time[zeros[2]] - run.time[zeros[0]], settled(run, 1e-2)
    yield Measured(
        swings >= 4,
        'overshoot {:.3f} m, {:.0f} half swings above 1 % of the start, period {:.3f} s; '
        'within 1e-2 m from {:.4f} s ({:.1f} periods), within 1e-3 m from {:.4f} s',
        (overshoot(run.position), swings, period, late, late / period, settled(run)),
    )


@claim(FIG_2, 'with impulses the position converges much faster')
def faster(case: Case, pd: Case) -> Iterator[Measured]:
    without, time = settled(pd.run), pd.run.time
    text = 'within 1e-3 m from {:.4f} s, PD from {:.4f} s, so {:.1f} times sooner'
    for when, late in (
        (STRICT, settled_exactly(case.strict, time)),
        (ONE_JUMP, settled_exactly(case.one_jump, time)),
        (SAMPLED, settled(case.run)),
    ):
        yield Measured(late < 0.5 * without, text, (late, without, without / late), when)


@claim(FIG_2, 'it does so at a nearly linear rate, that of the induced velocity')
def linear(case: Case) -> Iterator[Measured]:
    end = case.strict.end_time
    time = np.linspace(0.0, end, 1001)[:-1]
    position, velocity = case.strict.at(time)
    bent = peak(position - case.axis.x_0 * (1.0 - time / end)) / case.axis.x_0
    fastest, last = velocity.min(), case.strict.events[1]['velocity_before']
    unstarted = replace(case.axis, v_0=-1e-9)  # not on the guard
    later = solve(unstarted, case.gains, 2.0).end_time
    yield Measured(
        bent < 0.05,
        'the impulse at t = 0 induces {:.2f} m/s as (25) says; then v is {:.2f} to '
        '{:.2f} m/s and x at most {:.1f} % of the start off a line to e = 0 at {:.4f} s '
        '(without an impulse at t = 0, which the paper does not state, at {:.4f} s)',
        (velocity[0], fastest, last, 1e2 * bent, end, later),
    )


@claim(FIG_2, 'the peak velocity is not significantly higher than that of PD')
def peak_velocity(case: Case, pd: Case) -> Iterator[Measured]:
    ours, theirs = peak(case.run.velocity), peak(pd.run.velocity)
    efforts = peak(case.run.effort), peak(pd.run.effort)
    yield Measured(
        ours < 1.5 * theirs,
        '{:.3f} m/s against {:.3f} m/s, {:.0f} % more; the peak effort, which the paper '
        'does not give, is {:.0f} N for one sample against {:.0f} N',
        (ours, theirs, 1e2 * (ours / theirs - 1.0), *efforts),
    )


@claim(FIG_2, 'the transient peaks near zero are negligible beside the swings of PD')
def minor_peaks(case: Case, pd: Case) -> Iterator[Measured]:
    start, time = case.axis.x_0, pd.run.time[pd.run.time > case.strict.end_time]
    text = '{:.2f} mm, {:.2g} % of the start (PD: {:.0f} mm)'
    for when, most in (
        (STRICT, peak(case.strict.at(time)[0])),
        (ONE_JUMP, turns(case.one_jump)[1]),
        (SAMPLED, peak(case.run.position[-len(time) :])),
    ):
        values = (1e3 * most, 1e2 * most / start, 1e3 * overshoot(pd.run.position))
        yield Measured(bool(most < NEGLIGIBLE * start), text, values, when)


@claim(FIG_3, 'low-pass filtered white noise with a bias gives a damping that meets (1)')
def bounded_damping(case: Case) -> Iterator[Measured]:
    damping, limits = case.run.damping, case.axis.damping
    yield Measured(
        bool(damping.min() >= limits.lower and damping.max() <= limits.upper),
        '{:.3f} to {:.3f} N s/m, mean {:.3f} N s/m ({:g} Hz, our choice: the paper '
        'gives neither corner nor variance)',
        (damping.min(), damping.max(), damping.mean(), limits.bandwidth),
        'held at the bounds',
    )
    held = float(np.mean((damping <= limits.lower) | (damping >= limits.upper)))
    text = 'it would leave them {:.1f} % of the time'
    yield Measured(held == 0.0, text, (1e2 * held,), 'by its bias alone')


@claim(FIG_4, 'the first position zero is passed at comparable velocities')
def comparable(runs: Runs) -> Iterator[Measured]:
    theirs, ours = zero_of(runs.pd_varying.run), zero_of(runs.varying.run)
    yield Measured(
        0.5 < ours[1] / theirs[1] < 2.0,
        '{:.2f} m/s with and {:.2f} m/s without impulses, at {:.3f} and {:.3f} s',
        (ours[1], theirs[1], ours[0], theirs[0]),
        'the damping of our Fig. 3',
    )
    ratios = [zero_of(impulses)[1] / zero_of(without)[1] for without, impulses in runs.seeds]
    yield Measured(
        max(ratios) < 2.0,
        'the ratio is {:.1f} in the median, {:.1f} to {:.1f}',
        (float(np.median(ratios)), min(ratios), max(ratios)),
        f'{len(ratios)} other signals',
    )


@claim(FIG_4, 'then the convergence is almost immediate, and only with impulses')
def immediate(runs: Runs) -> Iterator[Measured]:
    exactly_at_rest = runs.varying.strict.end is End.ORIGIN
    yield Measured(exactly_at_rest, 'at rest in the origin at that instant', when=STRICT)
    run, pd = runs.varying.run, runs.pd_varying.run
    zero = zero_of(run)[0]
    bounce = settled_exactly(runs.varying.one_jump, run.time, TINY) - zero
    text = 'the axis bounces, within 1e-6 m only {:.2f} s later'
    yield Measured(bool(bounce < SOON), text, (bounce,), ONE_JUMP)
    tiny = settled(run, TINY) - zero
    worst = max(settled(other, TINY) - zero_of(other)[0] for _, other in runs.seeds)
    yield Measured(
        worst < SOON,
        'within 1e-6 m {:.1f} ms later (worst of {:.0f} other signals {:.1f} ms); '
        'PD within 1e-3 m {:.2f} s later',
        (1e3 * tiny, len(runs.seeds), 1e3 * worst, settled(pd) - zero_of(pd)[0]),
        SAMPLED,
    )
