"""The loop of examples/ros2_control behind its delay; test/nodes has it with ROS."""

import pytest

from scripts.ros2_control_loop import DelayedAxis, KHZ, LAWS, row, simulated, table

DURATION = 0.5  # s, of a response
SUPERVISIONS = pytest.mark.parametrize('supervision', [True, False])


@SUPERVISIONS
def test_every_response_at_500_hz_and_5_ms_settles_and_rests(supervision):
    found = simulated(DelayedAxis(500), 20, DURATION, supervision=supervision)
    assert len(found) == 20
    for one in found:
        assert one.settled < 0.3
        assert one.overshoot < 0.015
        assert one.impulses_at_rest == 0.0


@SUPERVISIONS
def test_no_excursion_at_1_khz_with_a_sixth_of_the_states_lost_exceeds_twice_the_step(supervision):
    found = simulated(DelayedAxis(1000, lost=0.17), 20, DURATION, supervision=supervision, **KHZ)
    assert max(one.excursion for one in found) < 2.0


def test_a_table_has_a_row_for_each_law():
    rows = [row(law, simulated(DelayedAxis(500), 2, DURATION, **LAWS[law])) for law in LAWS]
    lines = table(rows).splitlines()
    assert len(lines) == 2 + len(LAWS)
    assert len({line.count('|') for line in lines}) == 1
    assert '| 2 of 2 |' in lines[-1]
    assert '| 0 of 2 |  |' in lines[2]
