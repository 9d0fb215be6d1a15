"""One axis of scripts/identify_axes.py: moved, identified and controlled over real nodes."""

from dataclasses import replace

from scripts.identify_axes import drawn, HEAD, passes, row, studied


def test_a_random_axis_is_moved_identified_and_then_controlled_as_predicted(graph):
    axis = drawn(12)
    axis = replace(axis, plant=axis.plant | {'real_time_factor': 2.0})
    found = studied(axis, graph.folder / 'axis', graph.env)
    low, high = found['parameters']['m']['interval']
    assert low - 0.02 * axis.plant['m'] <= axis.plant['m'] <= high + 0.02 * axis.plant['m']
    assert axis.plant['damping.upper'] <= found['d_bar'] <= 3.0 * axis.plant['damping.upper']
    assert passes(axis, found), found['response']
    assert len(row(12, axis, found)) == len(HEAD)
    assert not passes(axis, found | {'response': found['response'] | {'settled': float('nan')}})
