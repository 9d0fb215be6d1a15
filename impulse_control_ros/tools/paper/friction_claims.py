"""The claims of section IV-C, on Fig. 5, with Coulomb friction."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impulse_control_ros.core.design import dead_zone, sampled_floor
from impulse_control_ros.core.hybrid import End, solve
from impulse_control_ros.core.impulse import POSITION_ZERO
from impulse_control_ros.tools.paper.claim import Claim, Measured
from impulse_control_ros.tools.paper.gain_claims import TINY
from impulse_control_ros.tools.paper.runs import Case, Runs


def friction_claims(runs: Runs) -> Iterator[Claim]:
    """Yield the claims on Fig. 5 in the paper's order."""
    yield sticks(runs.pd_coulomb)
    yield first_stop(runs.coulomb)
    yield converges(runs)
    yield both_axes(runs.coulomb)


def sticks(pd: Case) -> Claim:
    """Fig. 5 without impulses."""
    end, zone = pd.run.position[-1], dead_zone(pd.gains, pd.axis.F_c)
    exact = float(pd.strict.at(pd.strict.end_time)[0])
    return Claim(
        key='sticks',
        figure=5,
        where='Fig. 5, section IV-C',
        says='PD alone sticks for ever within +-F_c / K of the set-point',
        measured=(
            Measured(
                holds=pd.strict.end is End.STICKS and exact < zone,
                values=(zone, exact, pd.strict.end_time, end),
                text='F_c / K = {:g} m; it sticks at {:.4f} m from {:.4f} s (sampled: at {:.4f} '
                'm)',
            ),
        ),
    )


def first_stop(case: Case) -> Claim:
    """Fig. 5, the first impulse."""
    stop = case.strict.events[1]
    zone = dead_zone(case.gains, case.axis.F_c)
    return Claim(
        key='first stop',
        figure=5,
        where='Fig. 5, section IV-C',
        says='after the first impulse the axis stops within +-F_c / K, and an impulse frees it',
        measured=(
            Measured(
                holds=bool(0.0 < stop['position'] < zone and stop['velocity_after'] < 0.0),
                values=(stop['position'], stop['time'], stop['velocity_after']),
                text='it stops at {:.4f} m at {:.4f} s and leaves with {:.3f} m/s',
            ),
        ),
    )


def converges(runs: Runs) -> Claim:
    """Fig. 5 with impulses."""
    case = runs.coulomb
    ends = [1e3 * abs(run.position[-1]) for run in runs.steps.values()]
    position = case.strict.events['position']
    late = case.strict.events['time'] > 1.0
    rate = -np.polyfit(case.strict.events['time'][late], np.log(position[late]), 1)[0]
    stuck = solve(
        replace(case.axis, x_0=float(position[1])), replace(case.gains, impulses=False), 2.0
    )
    return Claim(
        key='converges',
        figure=5,
        where='Fig. 5, section IV-C',
        says='with impulses it converges to zero asymptotically',
        measured=(
            Measured(
                when='exact',
                holds=bool(rate > 0.0),
                values=(
                    rate,
                    1e3 * float(case.strict.at(2.0)[0]),
                    int(np.count_nonzero(case.strict.events['time'] <= 2.0)),
                ),
                text='exponentially, by {:.2f} per second (e-fold), to {:.4f} mm after 2 s, with '
                'ever more impulses ({:.0f} by then)',
            ),
            Measured(
                when='sampled',
                holds=bool(max(ends) < 1e3 * TINY),
                values=(*ends, 1e3 * sampled_floor(case.gains, case.axis.F_c)),
                text='to a floor of first order in the time step, {:.3f}, {:.4f} and {:.5f} mm at '
                '1e-3, 1e-4 and 1e-5 s: below 2 F_c dt / (kappa d_bar) ({:.4f} mm at 1e-4 s) a '
                'pulse of one sample does not overcome F_c',
            ),
            Measured(
                when='by sign changes of v alone',
                holds=stuck.end is not End.STICKS,
                values=(float(stuck.at(2.0)[0]),),
                text='v then stays 0 without a change, and the axis at {:.4f} m; an axis '
                'that stands must be a guard of its own',
            ),
        ),
    )


def both_axes(case: Case) -> Claim:
    """Fig. 5, the zoom; its first 2 s."""
    early = case.strict.events['time'] <= 2.0, case.run.time[case.run.events['tick']] <= 2.0
    exact, sampled = (
        events['guard'][part]
        for events, part in zip((case.strict.events, case.run.events), early, strict=True)
    )
    zeros, sampled_zeros = (int(np.sum(guards == POSITION_ZERO)) for guards in (exact, sampled))
    return Claim(
        key='both axes',
        figure=5,
        where='Fig. 5, section IV-C',
        says='near zero, impulses act at both state axes',
        measured=(
            Measured(
                holds=zeros > 0 and sampled_zeros > 0,
                values=(zeros, sampled_zeros, len(exact) - zeros, len(sampled) - sampled_zeros),
                text='{:.0f} position zeros (sampled: {:.0f}) beside {:.0f} stops '
                '(sampled: {:.0f}) '
                'in 2 s: e = 0 is never crossed',
            ),
        ),
    )
