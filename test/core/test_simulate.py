"""The closed loop offline: the paper's figures, and the laws of a simulation."""

import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import POSITION_ZERO, VELOCITY_ZERO
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.metrics import first_position_zero, overshoot, settling_time
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import DivergedError, ParameterError

PD = ControlGains(impulses=False)
FIRST_ZERO = 0.12143680500356
FIRST_ZERO_SPEED = 3.49358568945


def peaks(position):
    """Return the extrema after each change of the error's side."""
    turns = np.flatnonzero(np.diff(np.sign(position)))
    return [np.abs(part).max() for part in np.split(position, turns + 1)[1:]]


def test_fig_1_damping_at_its_upper_bound_does_not_overshoot():
    run = simulate(Plant(F_c=0.0, damping=Damping(value=1.5)), PD, 3.0)
    assert overshoot(run.position) == 0.0
    critical = 0.5 * (1 + 10 * run.time) * np.exp(-10 * run.time)
    assert np.abs(run.position - critical).max() < 6e-4  # zero-order hold of PD: one sample late


def test_fig_1_damping_at_its_lower_bound_oscillates():
    run = simulate(Plant(F_c=0.0), PD, 3.0)
    assert len([peak for peak in peaks(run.position) if peak > 0.01 * 0.5]) >= 4
    assert overshoot(run.position) == pytest.approx(0.170, abs=1e-3)


@pytest.mark.parametrize(
    'damping',
    [Damping(), Damping(kind='noise'), Damping(kind='sinusoidal')],
    ids=lambda damping: damping.kind,
)
def test_figs_2_and_4_the_origin_is_reached_within_5_ms_of_the_first_zero(damping):
    run = simulate(Plant(F_c=0.0, damping=damping), ControlGains(), 2.0)
    zero = run.time[first_position_zero(run.position)]
    assert settling_time(run.time, run.position, 1e-3) < zero + 5e-3
    late = run.time > zero + 5e-3
    assert np.abs(run.position[late]).max() < 1e-3
    assert np.abs(run.velocity[late]).max() < 1e-1


def test_fig_2_the_first_zero_converges_at_first_order_to_that_of_the_exact_flow():
    errors = []
    for step in (1e-3, 1e-4, 1e-5):
        run = simulate(Plant(F_c=0.0, time_step=step), ControlGains(time_step=step), 0.2)
        at = first_position_zero(run.position)
        x, v = run.position[at - 1], run.velocity[at - 1]
        errors.append(abs(run.time[at - 1] + x / abs(v) - FIRST_ZERO))
        assert v == pytest.approx(-FIRST_ZERO_SPEED, rel=20 * step)
    assert errors[1] < errors[0] / 8
    assert errors[2] < errors[1] / 8


def test_with_hold_off_the_axis_bounces():
    run = simulate(Plant(F_c=0.0), ControlGains(hold_off=10), 1.0)
    after = run.position[first_position_zero(run.position) :]
    assert after.max() == pytest.approx(0.0456, abs=3e-4)
    guards = run.events['guard']
    assert list(guards[:4]) == [VELOCITY_ZERO, POSITION_ZERO, VELOCITY_ZERO, POSITION_ZERO]


def test_fig_5_pd_alone_sticks_inside_the_dead_zone():
    run = simulate(Plant(F_c=1.0, x_0=0.15), PD, 2.0)
    assert run.velocity[-1] == 0.0
    assert run.position[-1] == pytest.approx(0.0830, abs=2e-4)
    assert run.position[-1] < 1.0 / PD.K


@pytest.mark.parametrize('step', [1e-3, 1e-4])
def test_fig_5_with_impulses_the_error_falls_to_the_sampled_floor(step):
    run = simulate(
        Plant(F_c=1.0, x_0=0.15, time_step=step),
        ControlGains(time_step=step, supervision=False),
        5.0,
    )
    floor = 2 * 1.0 * step / 1.5
    assert 0.5 * floor < run.position[-1] < 1.01 * floor
    assert np.min(run.position) > 0.0


def test_the_first_half_of_a_run_is_the_run_of_half_the_duration():
    axis, controller = Plant(F_c=0.5, damping=Damping(kind='noise')), ControlGains()
    whole, half = simulate(axis, controller, 1.0), simulate(axis, controller, 0.5)
    assert whole.position[:5001].tobytes() == half.position.tobytes()
    assert whole.effort[:5001].tobytes() == half.effort.tobytes()


def test_the_arrays_have_the_documented_shapes():
    run = simulate(Plant(F_c=0.0), ControlGains(), 0.01)
    assert [
        run.time.shape,
        run.position.shape,
        run.velocity.shape,
        run.effort.shape,
        run.damping.shape,
    ] == [(101,)] * 4 + [(100,)]
    assert run.time[-1] == pytest.approx(0.01)
    assert list(run.events['tick']) == [0]


def test_a_controller_with_another_time_step_is_refused():
    with pytest.raises(ParameterError, match='time_step = 0.001'):
        simulate(Plant(), ControlGains(time_step=1e-3), 1.0)


def test_a_loop_that_diverges_says_when_and_returns_nothing():
    with pytest.raises(DivergedError, match=r'at 0\.\d+ s position = .* both must be < 1e\+100'):
        simulate(Plant(), ControlGains(K=1e9, impulses=False), 1.0)


@pytest.mark.parametrize('duration', [0.0, -1.0])
def test_a_run_without_a_step_is_refused(duration):
    with pytest.raises(ParameterError, match=f'duration = {duration}'):
        simulate(Plant(), ControlGains(), duration)
