"""The claims of sections IV-A and IV-B, on Figs. 1 to 4, without Coulomb friction."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impulse_control_ros.core.hybrid import End, Solution, solve
from impulse_control_ros.core.metrics import (
    first_position_zero,
    overshoot,
    peak,
    settling_time,
)
from impulse_control_ros.core.simulate import Run
from impulse_control_ros.tools.paper.claim import Claim, Measured
from impulse_control_ros.tools.paper.gain_claims import (
    FINE,
    ONE_JUMP,
    SAMPLED,
    SOON,
    STRICT,
    TINY,
    turns,
)
from impulse_control_ros.tools.paper.runs import Case, Runs

NEGLIGIBLE = 1e-2  # of the start: what we take for negligible


def response_claims(runs: Runs) -> Iterator[Claim]:
    """Yield the claims on Figs. 1 to 4 in the paper's order."""
    yield critical_response(runs.pd_upper)
    yield oscillates(runs.pd_lower)
    yield faster(runs.impulses, runs.pd_lower)
    yield linear(runs.impulses)
    yield peak_velocity(runs.impulses, runs.pd_lower)
    yield minor_peaks(runs.impulses, runs.pd_lower)
    yield bounded_damping(runs.varying)
    yield comparable(runs)
    yield immediate(runs)


def settled(run: Run, tolerance: float = FINE) -> float:
    """Return the settling time [s]; the set-point is 0."""
    return settling_time(run.time, run.position, tolerance)


def settled_exactly(solution: Solution, time: np.ndarray, tolerance: float = FINE) -> float:
    """Return the settling time [s] of a solution on a grid of times."""
    return settling_time(time, solution.at(time)[0], tolerance)


def zero_of(run: Run) -> tuple[float, float]:
    """Return when [s] the position first is 0, between its samples, and the velocity before."""
    at = first_position_zero(run.position)
    assert at is not None
    velocity = float(run.velocity[at - 1])
    return float(run.time[at - 1] + run.position[at - 1] / abs(velocity)), velocity


def critical_response(pd: Case) -> Claim:
    """Fig. 1, d at its upper bound."""
    beyond = overshoot(pd.run.position)
    critical = pd.axis.x_0 * (1.0 + 10.0 * pd.run.time) * np.exp(-10.0 * pd.run.time)
    apart = peak(pd.run.position - critical)
    return Claim(
        key='critical response',
        figure=1,
        where='Fig. 1, section IV',
        says='at the upper bound of the damping, PD alone responds critically damped',
        measured=(
            Measured(
                holds=beyond == 0.0 and apart < 1e-3,
                values=(beyond, 1e3 * apart, settled(pd.run)),
                text='no overshoot ({:.0f} m), at most {:.2f} mm off the closed form (the '
                'hold of one '
                'sample), within 1e-3 m from {:.4f} s',
            ),
        ),
    )


def oscillates(pd: Case) -> Claim:
    """Fig. 1, d at its lower bound."""
    zeros = np.flatnonzero(np.diff(np.sign(pd.run.position)))
    parts = np.split(pd.run.position, zeros + 1)[1:]
    swings = sum(peak(part) > NEGLIGIBLE * pd.axis.x_0 for part in parts)
    period = pd.run.time[zeros[2]] - pd.run.time[zeros[0]]
    late = settled(pd.run, 1e-2)
    return Claim(
        key='oscillates',
        figure=1,
        where='Fig. 1, section IV',
        says='at the lower bound it oscillates, and converges after several periods',
        measured=(
            Measured(
                holds=swings >= 4,
                values=(
                    overshoot(pd.run.position),
                    swings,
                    period,
                    late,
                    late / period,
                    settled(pd.run),
                ),
                text='overshoot {:.3f} m, {:.0f} half swings above 1 % of the start, '
                'period {:.3f} s; '
                'within 1e-2 m from {:.4f} s ({:.1f} periods), within 1e-3 m from {:.4f} s',
            ),
        ),
    )


def faster(case: Case, pd: Case) -> Claim:
    """Fig. 2, convergence."""
    without, time = settled(pd.run), pd.run.time
    text = 'within 1e-3 m from {:.4f} s, PD from {:.4f} s, so {:.1f} times sooner'
    return Claim(
        key='faster',
        figure=2,
        where='Fig. 2, section IV-A',
        says='with impulses the position converges much faster',
        measured=tuple(
            Measured(
                when=when,
                holds=late < 0.5 * without,
                values=(late, without, without / late),
                text=text,
            )
            for when, late in (
                (STRICT, settled_exactly(case.strict, time)),
                (ONE_JUMP, settled_exactly(case.one_jump, time)),
                (SAMPLED, settled(case.run)),
            )
        ),
    )


def linear(case: Case) -> Claim:
    """Fig. 2, the way to the first position zero."""
    end = case.strict.end_time
    time = np.linspace(0.0, end, 1001)[:-1]
    position, velocity = case.strict.at(time)
    bent = peak(position - case.axis.x_0 * (1.0 - time / end)) / case.axis.x_0
    unstarted = replace(case.axis, v_0=-1e-9)  # not on the guard
    later = solve(unstarted, case.gains, 2.0).end_time
    return Claim(
        key='linear',
        figure=2,
        where='Fig. 2, section IV-A',
        says='it does so at a nearly linear rate, that of the induced velocity',
        measured=(
            Measured(
                holds=bent < 0.05,
                values=(
                    velocity[0],
                    velocity.min(),
                    case.strict.events[1]['velocity_before'],
                    1e2 * bent,
                    end,
                    later,
                ),
                text='the impulse at t = 0 induces {:.2f} m/s as (25) says; then v is {:.2f} to '
                '{:.2f} m/s and x at most {:.1f} % of the start off a line to e = 0 at {:.4f} s '
                '(without an impulse at t = 0, which the paper does not state, at {:.4f} s)',
            ),
        ),
    )


def peak_velocity(case: Case, pd: Case) -> Claim:
    """Fig. 2, the price."""
    ours, theirs = peak(case.run.velocity), peak(pd.run.velocity)
    return Claim(
        key='peak velocity',
        figure=2,
        where='Fig. 2, section IV-A',
        says='the peak velocity is not significantly higher than that of PD',
        measured=(
            Measured(
                holds=ours < 1.5 * theirs,
                values=(
                    ours,
                    theirs,
                    1e2 * (ours / theirs - 1.0),
                    peak(case.run.effort),
                    peak(pd.run.effort),
                ),
                text='{:.3f} m/s against {:.3f} m/s, {:.0f} % more; the peak effort, '
                'which the paper '
                'does not give, is {:.0f} N for one sample against {:.0f} N',
            ),
        ),
    )


def minor_peaks(case: Case, pd: Case) -> Claim:
    """Fig. 2, what remains after the first position zero."""
    start, first = case.axis.x_0, case.strict.end_time
    time = pd.run.time[pd.run.time > first]
    sampled = peak(case.run.position[-len(time) :])
    found = (
        (STRICT, peak(case.strict.at(time)[0])),
        (ONE_JUMP, turns(case.one_jump)[1]),
        (SAMPLED, sampled),
    )
    return Claim(
        key='minor peaks',
        figure=2,
        where='Fig. 2, section IV-A',
        says='the transient peaks near zero are negligible beside the swings of PD',
        measured=tuple(
            Measured(
                when=when,
                holds=bool(most < NEGLIGIBLE * start),
                values=(1e3 * most, 1e2 * most / start, 1e3 * overshoot(pd.run.position)),
                text='{:.2f} mm, {:.2g} % of the start (PD: {:.0f} mm)',
            )
            for when, most in found
        ),
    )


def bounded_damping(case: Case) -> Claim:
    """Fig. 3."""
    damping, limits = case.run.damping, case.axis.damping
    held = float(np.mean((damping <= limits.lower) | (damping >= limits.upper)))
    within = damping.min() >= limits.lower and damping.max() <= limits.upper
    return Claim(
        key='bounded damping',
        figure=3,
        where='Fig. 3, section IV-B',
        says='low-pass filtered white noise with a bias gives a damping that meets (1)',
        measured=(
            Measured(
                when='held at the bounds',
                holds=bool(within),
                values=(damping.min(), damping.max(), damping.mean(), limits.bandwidth),
                text='{:.3f} to {:.3f} N s/m, mean {:.3f} N s/m ({:g} Hz, our choice: the paper '
                'gives neither corner nor variance)',
            ),
            Measured(
                when='by its bias alone',
                holds=held == 0.0,
                values=(1e2 * held,),
                text='it would leave them {:.1f} % of the time',
            ),
        ),
    )


def comparable(runs: Runs) -> Claim:
    """Fig. 4, the first position zero."""
    theirs, ours = zero_of(runs.pd_varying.run), zero_of(runs.varying.run)
    ratios = [
        zero_of(with_impulses)[1] / zero_of(without)[1] for without, with_impulses in runs.seeds
    ]
    return Claim(
        key='comparable',
        figure=4,
        where='Fig. 4, section IV-B',
        says='the first position zero is passed at comparable velocities',
        measured=(
            Measured(
                when='the damping of our Fig. 3',
                holds=0.5 < ours[1] / theirs[1] < 2.0,
                values=(ours[1], theirs[1], ours[0], theirs[0]),
                text='{:.2f} m/s with and {:.2f} m/s without impulses, at {:.3f} and {:.3f} s',
            ),
            Measured(
                when=f'{len(ratios)} other signals',
                holds=max(ratios) < 2.0,
                values=(float(np.median(ratios)), min(ratios), max(ratios)),
                text='the ratio is {:.1f} in the median, {:.1f} to {:.1f}',
            ),
        ),
    )


def immediate(runs: Runs) -> Claim:
    """Fig. 4, after the first position zero."""
    run, time = runs.varying.run, runs.varying.run.time
    zero, pd_zero = zero_of(run)[0], zero_of(runs.pd_varying.run)[0]
    pd = settled(runs.pd_varying.run) - pd_zero
    tiny = settled(run, TINY) - zero
    worst = max(
        settled(with_impulses, TINY) - zero_of(with_impulses)[0] for _, with_impulses in runs.seeds
    )
    bounce = settled_exactly(runs.varying.one_jump, time, TINY) - zero
    return Claim(
        key='immediate',
        figure=4,
        where='Fig. 4, section IV-B',
        says='then the convergence is almost immediate, and only with impulses',
        measured=(
            Measured(
                when=STRICT,
                holds=runs.varying.strict.end is End.ORIGIN,
                text='at rest in the origin at that instant',
            ),
            Measured(
                when=ONE_JUMP,
                holds=bool(bounce < SOON),
                values=(bounce,),
                text='the axis bounces, within 1e-6 m only {:.2f} s later',
            ),
            Measured(
                when=SAMPLED,
                holds=worst < SOON,
                values=(1e3 * tiny, len(runs.seeds), 1e3 * worst, pd),
                text='within 1e-6 m {:.1f} ms later (worst of {:.0f} other signals {:.1f} ms); '
                'PD within 1e-3 m {:.2f} s later',
            ),
        ),
    )
