"""
The claims of section III, on the jumps and their gains.

A gain outside (19), which our controller refuses, acts on an axis whose mass the controller
takes wrongly: alpha / (m abs(v)) is alpha_ratio times its mass over that of the axis.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impulse_control_ros.core.design import critical_damping
from impulse_control_ros.core.hybrid import End, Reading, Solution, solve
from impulse_control_ros.core.impulse import ControlGains, POSITION_ZERO, VELOCITY_ZERO
from impulse_control_ros.core.metrics import peak, settling_time
from impulse_control_ros.core.simulate import Run, simulate
from impulse_control_ros.tools.paper.claim import Claim, Measured
from impulse_control_ros.tools.paper.runs import Case, Runs, SECONDS

STRICT, ONE_JUMP, SAMPLED = 'read strictly', 'one jump a crossing', 'sampled at 10 kHz'
SOON = 5e-3  # s: what we take for "almost immediate"
FINE, TINY = 1e-3, 1e-6  # m


def gain_claims(runs: Runs) -> Iterator[Claim]:
    """Yield the claims of section III in the paper's order."""
    case = runs.impulses
    yield one_successor(case)
    yield alpha_stops(case)
    yield alpha_too_small(case)
    yield alpha_cycles(case)
    yield alpha_range(case)
    yield critical(case)
    yield reaches_zero(case, runs.coulomb)
    yield weight_of_one(case, runs.coulomb)


def with_ratio(case: Case, ratio: float) -> tuple[Run, Solution, Solution]:
    """Return the run and both solutions with alpha = ``ratio`` m abs(v)."""
    gains = replace(case.gains, alpha_ratio=0.5, m=2.0 * ratio * case.axis.m)
    strict, one_jump = (solve(case.axis, gains, SECONDS, reading=reading) for reading in Reading)
    return simulate(case.axis, gains, SECONDS), strict, one_jump


def turns(solution: Solution) -> np.ndarray:
    """Return where [m] the motion turns, the start first."""
    return solution.events['position'][solution.events['guard'] == VELOCITY_ZERO]


def one_successor(case: Case) -> Claim:
    """(10)(16): each hit of a guard has one successor, which lies outside the guards."""
    ratio = abs(1.0 - 2.0 * case.gains.alpha_ratio)
    zero = case.strict.events[1]
    jumps = int(np.ceil(np.log(TINY / abs(zero['velocity_before'])) / np.log(ratio)))
    start = case.strict.events[0]
    return Claim(
        key='one successor',
        where='(10), (16), section III-B',
        says='the flow set and the jump set are disjoint, and a jump gives one successor state',
        measured=(
            Measured(
                when='at v = 0',
                holds=bool(start['velocity_after'] != 0.0),
                values=(start['velocity_after'],),
                text='the jump leaves the guard, v+ = {:.2f} m/s',
            ),
            Measured(
                when='at e = 0',
                holds=case.strict.end is not End.ORIGIN,
                values=(ratio, jumps),
                text='the successor lies on the guard again, and (10) shrinks v '
                'to {:.1f} of it at each of endless jumps of one instant ({:.0f} to 1e-6 m/s)',
            ),
        ),
    )


def alpha_stops(case: Case) -> Claim:
    """(18): half of m abs(v) stops the axis in the origin."""
    run, strict, one_jump = with_ratio(case, 0.5)
    exact = strict.end is End.ORIGIN and one_jump.end is End.ORIGIN
    fine, tiny = (settling_time(run.time, run.position, size) for size in (FINE, TINY))
    return Claim(
        key='alpha stops',
        where='(18)',
        says='alpha = 0.5 m|v| leads into the origin at e = 0',
        measured=(
            Measured(
                when='exact, in either reading',
                holds=exact,
                values=(one_jump.end_time,),
                text='at rest in the origin at {:.4f} s',
            ),
            Measured(
                when=SAMPLED,
                holds=fine < strict.end_time + SOON,
                values=(fine, tiny),
                text='within 1e-3 m from {:.4f} s, but within 1e-6 m only from {:.4f} s',
            ),
        ),
    )


def alpha_too_small(case: Case) -> Claim:
    """(18): less than half does not stop it."""
    run, strict, one_jump = with_ratio(case, 0.4)
    settled = settling_time(run.time, run.position, TINY)
    return Claim(
        key='alpha too small',
        where='after (18)',
        says='a smaller alpha cannot bring the state to the origin (here 0.4 m|v|)',
        measured=(
            Measured(
                when=STRICT,
                holds=strict.end is not End.ORIGIN,
                values=(strict.end_time,),
                text='the jumps, each to 0.2 v, end in the origin all the same at {:.4f} s',
            ),
            Measured(
                when=ONE_JUMP,
                holds=one_jump.end is not End.ORIGIN,
                values=(turns(one_jump)[1],),
                text='the axis runs through, to {:.4f} m',
            ),
            Measured(
                when=SAMPLED,
                holds=not settled < strict.end_time + SOON,
                values=(settled,),
                text='it runs through, and is within 1e-6 m only from {:.4f} s',
            ),
        ),
    )


def alpha_cycles(case: Case) -> Claim:
    """After (18): alpha = m abs(v) cycles for ever between +-v."""
    run, strict, one_jump = with_ratio(case, 1.0)
    ratio = turns(one_jump)[2] / turns(one_jump)[1]
    early, late = (peak(run.velocity[(run.time >= t) & (run.time < t + 0.1)]) for t in (0.5, 1.5))
    growth = float(np.log(late / early))
    return Claim(
        key='alpha cycles',
        where='before (19)',
        says='alpha = m|v| ends in an endless cycle between +v and -v at e = 0',
        measured=(
            Measured(
                when=STRICT,
                holds=strict.end is End.ENDLESS_JUMPS,
                values=(strict.end_time,),
                text='the jumps never end, at the one instant {:.4f} s',
            ),
            Measured(
                when=ONE_JUMP,
                holds=bool(ratio > 0.99),
                values=(ratio,),
                text='the axis bounces, each time to {:.3f} of the last',
            ),
            Measured(
                when=SAMPLED,
                holds=abs(growth) < 0.01,
                values=(growth, late),
                text='it '
                'chatters and abs(v) grows, by {:.2f} per second (e-fold), to {:.0f} m/s '
                'at 1.6 s',
            ),
        ),
    )


def alpha_range(case: Case) -> Claim:
    """(19): the criterion of alpha."""
    tried = [with_ratio(case, ratio) for ratio in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)]
    rests = all(solution.end is End.ORIGIN for _, solution, _ in tried)
    strict = max(solution.end_time for _, solution, _ in tried)
    latest = max(settling_time(run.time, run.position, FINE) for run, _, _ in tried)
    worst = max(
        abs(turns(one_jump)[1] / turns(one_jump)[0])
        for _, _, one_jump in tried
        if one_jump.end is not End.ORIGIN
    )
    return Claim(
        key='alpha range',
        where='(19)',
        says='0.5 m|v| <= alpha < m|v| makes the axis converge (here up to 0.95 m|v|)',
        measured=(
            Measured(
                when=STRICT,
                holds=rests,
                values=(strict,),
                text='at rest in the origin at {:.4f} s',
            ),
            Measured(
                when=ONE_JUMP,
                holds=bool(worst < 1.0),
                values=(worst,),
                text='the bounces shrink, to {:.3f} or less each time',
            ),
            Measured(
                when=SAMPLED,
                holds=latest < strict + SOON,
                values=(latest,),
                text='within 1e-3 m from {:.4f} s at the latest',
            ),
        ),
    )


def critical(case: Case) -> Claim:
    """Before (20): the eigen-dynamics are critically damped by D."""
    gains = case.gains
    square, four = (gains.d_bar + gains.D) ** 2, 4.0 * gains.m * gains.K
    return Claim(
        key='critical',
        where='before (20), Table I',
        says='D makes the loop critically damped at the upper bound of the damping',
        measured=(
            Measured(
                holds=abs(square - four) < 1e-9,
                values=(square, four, critical_damping(gains)),
                text='(d_bar + D)^2 = {:g} and 4 m K = {:g}, so D = {:g} N s/m is the right one',
            ),
        ),
    )


def reaches_zero(case: Case, coulomb: Case) -> Claim:
    """(25): any damping below the bound makes the axis hit e = 0."""
    times = {d: zero_time(case, d) for d in (0.15, 1.0, 1.49, 1.5)}
    least = least_start(coulomb)
    return Claim(
        key='reaches zero',
        where='(25)',
        says='after the velocity jump the axis surely hits e = 0 for any damping below d_bar',
        measured=(
            Measured(
                when='without Coulomb friction',
                holds=times[1.49] < np.inf,
                values=(times[0.15], times[1.0], times[1.49]),
                text='at {:.3f}, {:.3f} and {:.2f} s for '
                'd = 0.15, 1 and 1.49 N s/m (at d_bar itself it creeps there without a hit)',
            ),
            Measured(
                when='with F_c = 1 N',
                holds=least <= coulomb.axis.x_0,
                values=(coulomb.axis.x_0, least),
                text='not from {:g} m as in Fig. 5; only from above {:.3f} m',
            ),
        ),
    )


def zero_time(case: Case, d: float) -> float:
    """Return when [s] e = 0 is first hit, or inf."""
    axis = replace(case.axis, damping=replace(case.axis.damping, value=d))
    events = solve(axis, case.gains, 20.0).events
    hits = events['time'][events['guard'] == POSITION_ZERO]
    return float(hits[0]) if hits.size else float('inf')


def least_start(coulomb: Case) -> float:
    """Return the start [m] above which the axis with friction hits e = 0, by bisection."""
    low, high = 0.0, 1.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        solution = solve(replace(coulomb.axis, x_0=middle), coulomb.gains, SECONDS, event_limit=2)
        hits = solution.events['guard'][1] == POSITION_ZERO
        low, high = (low, middle) if hits else (middle, high)
    return high


def weight_of_one(case: Case, coulomb: Case) -> Claim:
    """After (26): c = 1 can be used throughout."""
    one: ControlGains = replace(case.gains, c=1.0)
    jump = solve(case.axis, one, SECONDS).events['velocity_after'][0]
    wanted = case.strict.events['velocity_after'][0]
    axis = replace(coulomb.axis, x_0=0.04)
    rest = abs(simulate(axis, replace(coulomb.gains, c=1.0), SECONDS).position[-1])
    return Claim(
        key='weight of one',
        where='after (26)',
        says='c = 1 can be used throughout',
        measured=(
            Measured(
                when='a sticking axis',
                holds=bool(rest < 0.01 * axis.x_0),
                values=(axis.x_0, 1e3 * rest),
                text='from {:g} m, where PD sticks, it moves on to {:.3f} mm after 2 s',
            ),
            Measured(
                when='a moving axis',
                holds=bool(abs(jump / wanted - 1.0) < 0.01),
                values=(jump, wanted),
                text='beta doubles while (15) still jumps twice: '
                'v+ = {:.2f} m/s in place of the {:.2f} m/s of (25)',
            ),
        ),
    )
