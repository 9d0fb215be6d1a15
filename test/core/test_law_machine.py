"""The control law under any sequence of samples, set-points and switches, checked at each step."""

import math

from hypothesis import settings, strategies as st
from hypothesis.stateful import initialize, invariant, rule, RuleBasedStateMachine
import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import (
    COMMAND,
    control_in_place,
    LawState,
    NO_IMPULSE,
    POSITION_ZERO,
    STATES,
    STICKING,
    VELOCITY_ZERO,
)
from impulse_control_ros.core.supervision import SUPERVISION

DT = 1e-3
sizes = st.floats(1e-9, 10.0)
signed = st.one_of(st.just(0.0), sizes, sizes.map(lambda size: -size))
anywhere = st.one_of(signed, st.floats(-1e9, 1e9))
bands = st.sampled_from([0.0, 1e-6, 0.5])


class Law(RuleBasedStateMachine):
    """Samples of an axis that does whatever it likes, and what the law answers."""

    @initialize(
        values=st.fixed_dictionaries(
            {
                'm': st.floats(0.01, 10.0),
                'K': st.floats(0.1, 1e3),
                'D': st.floats(0.0, 10.0),
                'd_bar': st.floats(0.01, 10.0),
                'c': st.sampled_from([1.0, 2.0]),
                'alpha_ratio': st.floats(0.5, 0.99),
                'effort_limit': st.sampled_from([0.0, 0.5, 20.0]),
                'hold_off': st.integers(0, 3),
                'guard_lookahead': st.sampled_from([0.0, 0.5, 1.0]),
                'position_deadband': bands,
                'velocity_deadband': bands,
                'position_hysteresis': bands,
                'velocity_hysteresis': bands,
                'stiction_wait_samples': st.integers(1, 4),
                'K_i': st.sampled_from([0.0, 5.0]),
                'velocity_source': st.sampled_from(['measured', 'estimated']),
            }
        )
    )
    def begin(self, values):
        self.values = values | {
            'time_step': DT,
            'x_r': 0.0,
            'impulses': True,
            'supervision': False,
        }
        self.set()
        self.state, self.command = np.zeros(STATES), np.zeros(1, COMMAND)
        self.memory = np.zeros(1, SUPERVISION)
        self.effort, self.guard, self.area = 0.0, NO_IMPULSE, 0.0
        self.before = None
        self.owed = self.sent = 0.0
        self.scale = 1.0
        self.since_position_zero = self.since_impulse = math.inf
        self.armed, self.direction, self.integral = True, 0.0, 0.0

    def set(self, **changed):
        self.values |= changed
        self.gains = ControlGains(**self.values)
        self.law = self.gains.packed().view(float)

    @rule(x_r=signed)
    def move_the_set_point(self, x_r):
        self.set(x_r=x_r)

    @rule()
    def switch_impulses(self):
        self.set(impulses=not self.values['impulses'])

    @rule(position=anywhere, velocity=st.one_of(anywhere, st.just(math.nan)))
    def sample(self, position, velocity):
        waiting = LawState(*self.state).pending
        control_in_place(self.state, self.memory, self.law, position, velocity, self.command)
        self.effort, self.area, self.guard, taken, *_ = self.command.item()
        gains = self.gains
        if gains.velocity_source == 'measured' and not math.isnan(velocity):
            assert taken == velocity
        now = (position, taken, gains.x_r)
        self.judge(*now)
        error, limit = position - gains.x_r, gains.effort_limit or math.inf
        grown = self.integral + gains.K_i * error * DT
        windup = abs(gains.K * error + gains.D * taken + grown) > limit and (
            np.sign(gains.K * error + gains.D * taken + grown) == np.sign(error)
        )
        self.integral = self.integral if windup else grown
        feedback = -gains.K * error - gains.D * taken - self.integral
        feedback = min(max(feedback, -limit), limit)
        if np.sign(waiting + self.area) == np.sign(error) == np.sign(taken):
            self.owed -= waiting
            waiting = 0.0
        if gains.impulses:
            self.owed += self.area
            if waiting or self.area:
                self.sent += (self.effort - feedback) * DT
            self.scale = max(self.scale, abs(self.area), abs(self.effort) * DT)
        else:  # what waited is dropped
            assert self.effort == pytest.approx(feedback)
            self.owed = self.sent = 0.0
        self.before = now

    @rule()
    def the_same_sample_again(self):
        if self.before:
            self.sample(*self.before[:2])

    def judge(self, position, velocity, x_r):
        """One impulse for one event, of the area and the energy that the law says."""
        gains, error = self.gains, position - x_r
        lead = gains.guard_lookahead * DT
        ahead, speed, stood = position + lead * velocity - x_r, abs(velocity), not self.direction
        moves = speed > gains.velocity_deadband + gains.velocity_hysteresis or (
            speed > gains.velocity_deadband and np.sign(velocity) == self.direction
        )
        direction = float(np.sign(velocity)) if moves else 0.0
        if self.guard == NO_IMPULSE:
            assert self.area == 0.0
        elif self.guard == POSITION_ZERO:
            assert direction
            assert self.before is None or np.sign(
                self.before[0] + lead * self.before[1] - x_r
            ) != np.sign(ahead)
            assert self.since_position_zero > gains.hold_off
            assert self.armed
            alpha, m = gains.alpha_ratio, gains.m
            energy = self.area * velocity + self.area**2 / (2.0 * m)
            assert energy == pytest.approx(-2.0 * alpha * (1.0 - alpha) * m * velocity**2)
        else:
            assert abs(error) > gains.position_deadband
            if not direction and stood and self.before:
                assert self.since_impulse >= gains.stiction_wait_samples
            if self.guard == STICKING:
                assert not direction
                assert stood
            else:
                assert self.guard == VELOCITY_ZERO
                assert self.before is None or self.before[2] != x_r or direction != self.direction
            share = 1.0 if self.guard == STICKING else 2.0
            assert self.area == pytest.approx(
                -share * abs(error) * gains.d_bar / (2.0 * gains.c) * np.sign(error)
            )
        fired = self.guard == POSITION_ZERO
        self.since_position_zero = 1 if fired else self.since_position_zero + 1
        self.since_impulse = 1 if self.area else self.since_impulse + 1
        self.armed = abs(ahead) > gains.position_hysteresis or (self.armed and not fired)
        self.direction = direction
        assert self.guard == NO_IMPULSE or gains.impulses

    @invariant()
    def the_effort_is_finite_and_within_its_limit(self):
        if not hasattr(self, 'gains'):
            return
        assert math.isfinite(self.effort)
        if self.gains.effort_limit:
            assert abs(self.effort) <= self.gains.effort_limit
        assert all(math.isfinite(value) for value in self.state)

    @invariant()
    def what_is_owed_leaves_or_waits(self):
        if hasattr(self, 'gains'):
            waits = LawState(*self.state).pending
            assert self.owed == pytest.approx(self.sent + waits, abs=1e-6 * self.scale)


TestLaw = Law.TestCase
TestLaw.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
