"""All claims of the paper that numbers of ours can judge."""

from impulse_control_ros.tools.paper.claim import Claim
from impulse_control_ros.tools.paper.friction_claims import friction_claims
from impulse_control_ros.tools.paper.gain_claims import gain_claims
from impulse_control_ros.tools.paper.response_claims import response_claims
from impulse_control_ros.tools.paper.runs import Runs


def all_claims(runs: Runs) -> tuple[Claim, ...]:
    """Return the claims in the paper's order."""
    return (*gain_claims(runs), *response_claims(runs), *friction_claims(runs))
