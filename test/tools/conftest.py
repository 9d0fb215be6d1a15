"""The paper's runs and claims, and a browser, made once."""

import pytest

from impulse_control_ros.tools.paper.claims import all_claims
from impulse_control_ros.tools.paper.runs import paper_runs
from test.tools.chromium import offline


@pytest.fixture(scope='session')
def runs():
    return paper_runs()


@pytest.fixture(scope='session')
def claims(runs):
    return {claim.key: claim for claim in all_claims(runs)}


@pytest.fixture(scope='session')
def browser(tmp_path_factory):
    yield from offline(tmp_path_factory.mktemp('profile'))
