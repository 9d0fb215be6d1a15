"""Time is an integer tick."""

from fractions import Fraction

from hypothesis import given, strategies as st
import pytest

from impulse_control_ros.core.tick import nanoseconds, SECOND, stamp, ticks
from impulse_control_ros.errors import ParameterError


@given(st.integers(0, 10**12), st.integers(1, SECOND), st.integers(1, 10**18))
def test_a_stamp_is_start_plus_tick_times_step_exactly(tick, step_ns, start_ns):
    sec, nanosec = stamp(tick, start_ns, step_ns)
    assert 0 <= nanosec < SECOND
    assert Fraction(sec * SECOND + nanosec) == start_ns + tick * step_ns


def test_the_tick_that_floats_get_wrong():
    assert int(1291 * 1e-4 * 1e9) == 129_099_999
    assert stamp(1291, 0, nanoseconds(1e-4, 'time_step')) == (0, 129_100_000)


@pytest.mark.parametrize(
    ('seconds', 'expected'), [(1e-4, 100_000), (1e-9, 1), (0.1, 10**8), (3600.0, 3600 * SECOND)]
)
def test_seconds_are_whole_nanoseconds(seconds, expected):
    assert nanoseconds(seconds, 'time_step') == expected


@pytest.mark.parametrize('seconds', [1e-10, 1.5e-9, 1 / 3])
def test_parts_of_a_nanosecond_are_refused_by_name(seconds):
    with pytest.raises(ParameterError, match=f'time_step = {seconds}'):
        nanoseconds(seconds, 'time_step')


def test_a_duration_is_rounded_to_the_nearest_step():
    assert [ticks(2.0, 1e-4), ticks(0.3, 1e-4), ticks(0.0, 1e-4)] == [20_000, 3_000, 0]
