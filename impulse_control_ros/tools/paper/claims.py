"""All claims of the paper that numbers of ours can judge."""

from impulse_control_ros.tools.paper import (
    friction_claims as friction,
    gain_claims as gain,
    response_claims as response,
)
from impulse_control_ros.tools.paper.claim import Claim
from impulse_control_ros.tools.paper.runs import Runs


def all_claims(runs: Runs) -> tuple[Claim, ...]:
    """Return the claims in the paper's order."""
    case, pd, coulomb = runs.impulses, runs.pd_lower, runs.coulomb
    return (
        gain.one_successor(case),
        gain.alpha_stops(case),
        gain.alpha_too_small(case),
        gain.alpha_cycles(case),
        gain.alpha_range(case),
        gain.critical(case),
        gain.reaches_zero(case, coulomb),
        gain.weight_of_one(case, coulomb),
        response.critical_response(runs.pd_upper),
        response.oscillates(pd),
        response.faster(case, pd),
        response.linear(case),
        response.peak_velocity(case, pd),
        response.minor_peaks(case, pd),
        response.bounded_damping(runs.varying),
        response.comparable(runs),
        response.immediate(runs),
        friction.sticks(runs.pd_coulomb),
        friction.first_stop(coulomb),
        friction.converges(runs),
        friction.both_axes(coulomb),
    )
