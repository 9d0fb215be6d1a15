"""One axis of scripts/identify_axes.py: moved, identified and controlled over real nodes."""

from dataclasses import replace
import math

import pytest

from scripts.identify_axes import drawn, HEAD, passes, row, studied


def test_a_response_passes_if_it_settles_in_time_and_rests_where_it_may():
    axis = drawn(12)
    parameter = {'value': 1.0, 'interval': (0.9, 1.1)}
    found = {
        'parameters': {'m': parameter, 'F_c': parameter | {'value': None}},
        'd_bar': 2.0,
        'design': {'settling_time': 0.2, 'band': 1e-3},
    }
    good = {'settled': 0.23, 'final_error': -1e-3, 'impulses_at_rest': 0.0}
    assert passes(axis, found | {'response': good})
    assert len(row(12, axis, found | {'response': good})) == len(HEAD)
    for bad in ({'settled': 0.25}, {'settled': math.nan}, {'final_error': 2e-3}):
        assert not passes(axis, found | {'response': good | bad})
    assert not passes(axis, found | {'response': good | {'impulses_at_rest': 0.5}})


# the page of docs/how-to/your-axis.md has the same way, up to the simulated axis
@pytest.mark.soak
def test_a_random_axis_is_moved_identified_and_then_controlled_as_predicted(graph):
    axis = drawn(12)
    axis = replace(axis, plant=axis.plant | {'real_time_factor': 2.0})
    found = studied(axis, graph.folder / 'axis', graph.env)
    low, high = found['parameters']['m']['interval']
    assert low - 0.02 * axis.plant['m'] <= axis.plant['m'] <= high + 0.02 * axis.plant['m']
    assert axis.plant['damping.upper'] <= found['d_bar'] <= 3.0 * axis.plant['damping.upper']
    assert passes(axis, found), found['response']
