"""
The claims of section III, on the jumps and their gains.

A gain outside (19), which our controller refuses, acts on an axis whose mass the controller
takes wrongly: alpha / (m abs(v)) is alpha_ratio times its mass over that of the axis.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impulse_control_ros.core.control_law import POSITION_ZERO, VELOCITY_ZERO
from impulse_control_ros.core.design import critical_damping
from impulse_control_ros.core.hybrid import End, Reading, Solution, solve
from impulse_control_ros.core.metrics import peak, settling_time
from impulse_control_ros.core.simulate import Run, simulate
from impulse_control_ros.tools.paper.claim import claim, Measured
from impulse_control_ros.tools.paper.runs import Case, SECONDS

STRICT, ONE_JUMP, SAMPLED = 'read strictly', 'one jump a crossing', 'sampled at 10 kHz'
SOON = 5e-3  # s: what we take for "almost immediate"
FINE, TINY = 1e-3, 1e-6  # m


def with_ratio(case: Case, ratio: float) -> tuple[Run, Solution, Solution]:
    """Return the run and both solutions with alpha = ``ratio`` m abs(v)."""
    gains = replace(case.gains, alpha_ratio=0.5, m=2.0 * ratio * case.axis.m)
    strict, one_jump = (solve(case.axis, gains, SECONDS, reading=reading) for reading in Reading)
    return simulate(case.axis, gains, SECONDS), strict, one_jump


def settled(run: Run, tolerance: float = FINE) -> float:
    """Return the settling time [s]; the set-point is 0."""
    return settling_time(run.time, run.position, tolerance)


def turns(solution: Solution) -> np.ndarray:
    """Return where [m] the motion turns, the start first."""
    return solution.events['position'][solution.events['guard'] == VELOCITY_ZERO]


@claim(
    '(10), (16), section III-B',
    'the flow set and the jump set are disjoint, and a jump gives one successor state',
)
def one_successor(case: Case) -> Iterator[Measured]:
    start, zero = case.strict.events[:2]
    yield Measured(
        bool(start['velocity_after'] != 0.0),
        'the jump leaves the guard, v+ = {:.2f} m/s',
        (start['velocity_after'],),
        'at v = 0',
    )
    ratio = abs(1.0 - 2.0 * case.gains.alpha_ratio)
    jumps = int(np.ceil(np.log(TINY / abs(zero['velocity_before'])) / np.log(ratio)))
    yield Measured(
        case.strict.end is not End.ORIGIN,
        'the successor lies on the guard again, and (10) shrinks v '
        'to {:.1f} of it at each of endless jumps of one instant ({:.0f} to 1e-6 m/s)',
        (ratio, jumps),
        'at e = 0',
    )


@claim('(18)', 'alpha = 0.5 m|v| leads into the origin at e = 0')
def alpha_stops(case: Case) -> Iterator[Measured]:
    run, strict, one_jump = with_ratio(case, 0.5)
    yield Measured(
        strict.end is End.ORIGIN and one_jump.end is End.ORIGIN,
        'at rest in the origin at {:.4f} s',
        (one_jump.end_time,),
        'exact, in either reading',
    )
    fine, tiny = settled(run), settled(run, TINY)
    text = 'within 1e-3 m from {:.4f} s, but within 1e-6 m only from {:.4f} s'
    yield Measured(fine < strict.end_time + SOON, text, (fine, tiny), SAMPLED)


@claim('after (18)', 'a smaller alpha cannot bring the state to the origin (here 0.4 m|v|)')
def alpha_too_small(case: Case) -> Iterator[Measured]:
    run, strict, one_jump = with_ratio(case, 0.4)
    text = 'the jumps, each to 0.2 v, end in the origin all the same at {:.4f} s'
    yield Measured(strict.end is not End.ORIGIN, text, (strict.end_time,), STRICT)
    text = 'the axis runs through, to {:.4f} m'
    yield Measured(one_jump.end is not End.ORIGIN, text, (turns(one_jump)[1],), ONE_JUMP)
    late = settled(run, TINY)
    text = 'it runs through, and is within 1e-6 m only from {:.4f} s'
    yield Measured(not late < strict.end_time + SOON, text, (late,), SAMPLED)


@claim('before (19)', 'alpha = m|v| ends in an endless cycle between +v and -v at e = 0')
def alpha_cycles(case: Case) -> Iterator[Measured]:
    run, strict, one_jump = with_ratio(case, 1.0)
    text = 'the jumps never end, at the one instant {:.4f} s'
    yield Measured(strict.end is End.ENDLESS_JUMPS, text, (strict.end_time,), STRICT)
    ratio = turns(one_jump)[2] / turns(one_jump)[1]
    text = 'the axis bounces, each time to {:.3f} of the last'
    yield Measured(bool(ratio > 0.99), text, (ratio,), ONE_JUMP)
    early, late = (peak(run.velocity[(run.time >= t) & (run.time < t + 0.1)]) for t in (0.5, 1.5))
    growth = float(np.log(late / early))
    text = 'it chatters and abs(v) grows, by {:.2f} per second (e-fold), to {:.0f} m/s at 1.6 s'
    yield Measured(abs(growth) < 0.01, text, (growth, late), SAMPLED)


@claim('(19)', '0.5 m|v| <= alpha < m|v| makes the axis converge (here up to 0.95 m|v|)')
def alpha_range(case: Case) -> Iterator[Measured]:
    tried = [with_ratio(case, ratio) for ratio in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95)]
    rests = all(solution.end is End.ORIGIN for _, solution, _ in tried)
    strict = max(solution.end_time for _, solution, _ in tried)
    yield Measured(rests, 'at rest in the origin at {:.4f} s', (strict,), STRICT)
    bounces = [turns(one_jump) for _, _, one_jump in tried if one_jump.end is not End.ORIGIN]
    worst = max(abs(turn[1] / turn[0]) for turn in bounces)
    text = 'the bounces shrink, to {:.3f} or less each time'
    yield Measured(bool(worst < 1.0), text, (worst,), ONE_JUMP)
    latest = max(settled(run) for run, _, _ in tried)
    text = 'within 1e-3 m from {:.4f} s at the latest'
    yield Measured(latest < strict + SOON, text, (latest,), SAMPLED)


@claim(
    'before (20), Table I',
    'D makes the loop critically damped at the upper bound of the damping',
)
def critical(case: Case) -> Iterator[Measured]:
    gains = case.gains
    square, four = (gains.d_bar + gains.D) ** 2, 4.0 * gains.m * gains.K
    text = '(d_bar + D)^2 = {:g} and 4 m K = {:g}, so D = {:g} N s/m is the right one'
    yield Measured(abs(square - four) < 1e-9, text, (square, four, critical_damping(gains)))


@claim('(25)', 'after the velocity jump the axis surely hits e = 0 for any damping below d_bar')
def reaches_zero(case: Case, coulomb: Case) -> Iterator[Measured]:
    times = tuple(zero_time(case, d) for d in (0.15, 1.0, 1.49))
    yield Measured(
        times[-1] < np.inf,
        'at {:.3f}, {:.3f} and {:.2f} s for '
        'd = 0.15, 1 and 1.49 N s/m (at d_bar itself it creeps there without a hit)',
        times,
        'without Coulomb friction',
    )
    least = least_start(coulomb)
    text = 'not from {:g} m as in Fig. 5; only from above {:.3f} m'
    yield Measured(least <= coulomb.axis.x_0, text, (coulomb.axis.x_0, least), 'with F_c = 1 N')


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


@claim('after (26)', 'c = 1 can be used throughout')
def weight_of_one(case: Case, coulomb: Case) -> Iterator[Measured]:
    axis = replace(coulomb.axis, x_0=0.04)
    rest = abs(simulate(axis, replace(coulomb.gains, c=1.0), SECONDS).position[-1])
    text = 'from {:g} m, where PD sticks, it moves on to {:.3f} mm after 2 s'
    yield Measured(bool(rest < 0.01 * axis.x_0), text, (axis.x_0, 1e3 * rest), 'a sticking axis')
    jump = solve(case.axis, replace(case.gains, c=1.0), SECONDS).events['velocity_after'][0]
    wanted = case.strict.events['velocity_after'][0]
    yield Measured(
        bool(abs(jump / wanted - 1.0) < 0.01),
        'beta doubles while (15) still jumps twice: '
        'v+ = {:.2f} m/s in place of the {:.2f} m/s of (25)',
        (jump, wanted),
        'a moving axis',
    )
