"""The control law under any sequence of samples, set-points and switches, checked at each step."""

import math

from hypothesis import settings, strategies as st
from hypothesis.stateful import initialize, invariant, rule, RuleBasedStateMachine
import numpy as np
import pytest

from impulse_control_ros.core.careful import control_carefully, fresh_watch, packed_care
from impulse_control_ros.core.impulse import (
    ANSWER,
    Controller,
    fresh_memory,
    NO_IMPULSE,
    POSITION_ZERO,
    STICKING,
    VELOCITY_ZERO,
)

DT = 1e-3
sizes = st.floats(1e-9, 10.0)
signed = st.one_of(st.just(0.0), sizes, sizes.map(lambda size: -size))
anywhere = st.one_of(signed, st.floats(-1e9, 1e9))


class Law(RuleBasedStateMachine):
    """Samples of an axis that does whatever it likes, and what the law answers."""

    @initialize(m=st.floats(0.01, 10.0), K=st.floats(0.1, 1e3), D=st.floats(0.0, 10.0),
                d_bar=st.floats(0.01, 10.0), c=st.sampled_from([1.0, 2.0]),
                alpha_ratio=st.floats(0.5, 0.99), limit=st.sampled_from([0.0, 0.5, 20.0]),
                hold_off=st.integers(0, 3))
    def begin(self, m, K, D, d_bar, c, alpha_ratio, limit, hold_off):
        self.values = {'m': m, 'K': K, 'D': D, 'd_bar': d_bar, 'c': c, 'alpha_ratio': alpha_ratio,
                       'effort_limit': limit, 'hold_off': hold_off, 'time_step': DT, 'x_r': 0.0,
                       'impulses': True}
        self.set()
        self.memory, self.watch = fresh_memory(), fresh_watch()
        self.answer = np.zeros(1, ANSWER)
        self.effort, self.guard, self.area = 0.0, NO_IMPULSE, 0.0
        self.before = None
        self.owed = self.sent = 0.0
        self.scale = 1.0
        self.since_position_zero = math.inf

    def set(self, **changed):
        self.values |= changed
        self.gains = Controller(**self.values)
        self.packed, self.care = self.gains.packed(), packed_care(self.gains.flat(), 1)

    @rule(x_r=signed)
    def move_the_set_point(self, x_r):
        self.set(x_r=x_r)

    @rule()
    def switch_impulses(self):
        self.set(impulses=not self.values['impulses'])

    @rule(position=anywhere, velocity=anywhere)
    def sample(self, position, velocity):
        waiting = float(self.memory['pending'][0])
        control_carefully(self.memory, self.watch, self.packed, self.care, position, velocity,
                          self.answer)
        self.effort, self.area, self.guard, _ = self.answer.item()
        now = (position, velocity, self.gains.x_r)
        self.judge(*now)
        feedback = -self.gains.K * (position - self.gains.x_r) - self.gains.D * velocity
        limit = self.gains.effort_limit or math.inf
        feedback = min(max(feedback, -limit), limit)
        if np.sign(waiting) == np.sign(position - self.gains.x_r) == np.sign(velocity):
            self.owed -= waiting
            waiting = 0.0
        if self.gains.impulses:
            self.owed += self.area
            if waiting or self.area:
                self.sent += (self.effort - feedback) * DT
            self.scale = max(self.scale, abs(self.area), abs(self.effort) * DT)
        else:  # what waited is dropped
            assert self.effort == feedback
            self.owed = self.sent = 0.0
        self.before = now

    @rule()
    def the_same_sample_again(self):
        if self.before:
            self.sample(*self.before[:2])

    def judge(self, position, velocity, x_r):
        """One impulse for one event, of the area and the energy that the law says."""
        gains, error = self.gains, position - x_r
        direction = 0.0 if abs(velocity) <= gains.velocity_deadband else np.sign(velocity)
        if self.guard == NO_IMPULSE:
            assert self.area == 0.0
        elif self.guard == POSITION_ZERO:
            assert direction
            assert self.before is None or np.sign(self.before[0] - x_r) != np.sign(error)
            assert self.since_position_zero > gains.hold_off
            alpha, m = gains.alpha_ratio, gains.m
            energy = self.area * velocity + self.area**2 / (2.0 * m)
            assert energy == pytest.approx(-2.0 * alpha * (1.0 - alpha) * m * velocity**2)
        else:
            assert abs(error) > gains.position_deadband
            stood = self.before and abs(self.before[1]) <= gains.velocity_deadband
            if self.guard == STICKING:
                assert not direction
                assert stood
            else:
                assert self.guard == VELOCITY_ZERO
                assert self.before is None or self.before[2] != x_r or (
                    direction != (0.0 if stood else np.sign(self.before[1])))
            share = 1.0 if self.guard == STICKING else 2.0
            assert self.area == pytest.approx(
                -share * abs(error) * gains.d_bar / (2.0 * gains.c) * np.sign(error))
        self.since_position_zero = 1 if self.guard == POSITION_ZERO else (
            self.since_position_zero + 1)
        assert self.guard == NO_IMPULSE or gains.impulses

    @invariant()
    def the_effort_is_finite_and_within_its_limit(self):
        if not hasattr(self, 'gains'):
            return
        assert math.isfinite(self.effort)
        if self.gains.effort_limit:
            assert abs(self.effort) <= self.gains.effort_limit
        assert all(math.isfinite(value) for value in self.memory.item())

    @invariant()
    def what_is_owed_leaves_or_waits(self):
        if hasattr(self, 'gains'):
            waits = float(self.memory['pending'][0])
            assert self.owed == pytest.approx(self.sent + waits, abs=1e-6 * self.scale)


TestLaw = Law.TestCase
TestLaw.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
