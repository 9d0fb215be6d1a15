"""The claims of section IV-C, on Fig. 5, with Coulomb friction."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impulse_control_ros.core.control_law import POSITION_ZERO
from impulse_control_ros.core.design import dead_zone, sampled_floor
from impulse_control_ros.core.hybrid import End, solve
from impulse_control_ros.tools.paper.claim import claim, Measured
from impulse_control_ros.tools.paper.gain_claims import TINY
from impulse_control_ros.tools.paper.runs import Case, Runs

WHERE = 'Fig. 5, section IV-C'


@claim(WHERE, 'PD alone sticks for ever within +-F_c / K of the set-point')
def sticks(pd: Case) -> Iterator[Measured]:
    end, zone = pd.run.position[-1], dead_zone(pd.gains, pd.axis.F_c)
    exact = float(pd.strict.at(pd.strict.end_time)[0])
    yield Measured(
        pd.strict.end is End.STICKS and exact < zone,
        'F_c / K = {:g} m; it sticks at {:.4f} m from {:.4f} s (sampled: at {:.4f} m)',
        (zone, exact, pd.strict.end_time, end),
    )


@claim(WHERE, 'after the first impulse the axis stops within +-F_c / K, and an impulse frees it')
def first_stop(case: Case) -> Iterator[Measured]:
    stop, zone = case.strict.events[1], dead_zone(case.gains, case.axis.F_c)
    yield Measured(
        bool(0.0 < stop['position'] < zone and stop['velocity_after'] < 0.0),
        'it stops at {:.4f} m at {:.4f} s and leaves with {:.3f} m/s',
        (stop['position'], stop['time'], stop['velocity_after']),
    )


@claim(WHERE, 'with impulses it converges to zero asymptotically')
def converges(runs: Runs) -> Iterator[Measured]:
    case = runs.coulomb
    time, position = case.strict.events['time'], case.strict.events['position']
    late = time > 1.0
    rate = -np.polyfit(time[late], np.log(position[late]), 1)[0]
    yield Measured(
        bool(rate > 0.0),
        'exponentially, by {:.2f} per second (e-fold), to {:.4f} mm after 2 s, with '
        'ever more impulses ({:.0f} by then)',
        (rate, 1e3 * float(case.strict.at(2.0)[0]), int(np.count_nonzero(time <= 2.0))),
        'exact',
    )
    ends = [1e3 * abs(run.position[-1]) for run in runs.steps.values()]
    yield Measured(
        bool(max(ends) < 1e3 * TINY),
        'to a floor of first order in the time step, {:.3f}, {:.4f} and {:.5f} mm at '
        '1e-3, 1e-4 and 1e-5 s: below 2 F_c dt / (kappa d_bar) ({:.4f} mm at 1e-4 s) a '
        'pulse of one sample does not overcome F_c',
        (*ends, 1e3 * sampled_floor(case.gains, case.axis.F_c)),
        'sampled',
    )
    stopped = replace(case.axis, x_0=float(position[1]))
    stuck = solve(stopped, replace(case.gains, impulses=False), 2.0)
    yield Measured(
        stuck.end is not End.STICKS,
        'v then stays 0 without a change, and the axis at {:.4f} m; an axis '
        'that stands must be a guard of its own',
        (float(stuck.at(2.0)[0]),),
        'by sign changes of v alone',
    )


@claim(WHERE, 'near zero, impulses act at both state axes')
def both_axes(case: Case) -> Iterator[Measured]:
    exact, run = case.strict.events, case.run
    ours = exact['guard'][exact['time'] <= 2.0] == POSITION_ZERO
    sampled = run.events['guard'][run.time[run.events['tick']] <= 2.0] == POSITION_ZERO
    yield Measured(
        bool(ours.any() and sampled.any()),
        '{:.0f} position zeros (sampled: {:.0f}) beside {:.0f} stops (sampled: {:.0f}) '
        'in 2 s: e = 0 is never crossed',
        (ours.sum(), sampled.sum(), (~ours).sum(), (~sampled).sum()),
    )
