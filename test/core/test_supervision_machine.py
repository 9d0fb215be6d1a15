"""The supervised law under any samples, set-points and parameters, checked at each step."""

import math

from hypothesis import settings, strategies as st
from hypothesis.stateful import initialize, rule, RuleBasedStateMachine
import numpy as np

from impulse_control_ros.core.control_gains import ControlGains, MassRatioLimits
from impulse_control_ros.core.control_law import (
    COMMAND,
    control_in_place,
    NO_IMPULSE,
    POSITION_ZERO,
    STATES,
)
from impulse_control_ros.core.impulse_verdicts import NO_VERDICT
from impulse_control_ros.core.supervision import SUPERVISION

DT = 1e-3
LOWER, UPPER = 0.25, 4.0
sizes = st.floats(1e-6, 10.0)
signed = st.one_of(st.just(0.0), sizes, sizes.map(lambda size: -size))


class SupervisedLaw(RuleBasedStateMachine):
    """Samples of an axis that may follow the law or not, and what the law answers."""

    @initialize(
        values=st.fixed_dictionaries(
            {
                'm': st.floats(0.01, 10.0),
                'alpha_ratio': st.floats(0.5, 0.99),
                'effort_limit': st.sampled_from([0.0, 5.0, 100.0]),
                'learn_mass': st.booleans(),
                'response_timeout': st.integers(1, 20),
                'velocity_deadband': st.sampled_from([0.0, 1e-3, 0.1]),
                'velocity_source': st.sampled_from(['measured', 'estimated']),
            }
        )
    )
    def begin(self, values):
        limits = MassRatioLimits(lower=LOWER, upper=UPPER)
        self.values = {'time_step': DT, 'x_r': 0.0, 'mass_ratio_limits': limits} | values
        self.state, self.memory = np.zeros(STATES), np.zeros(1, SUPERVISION)
        self.command = np.zeros(1, COMMAND)
        self.position, self.velocity = 1.0, 0.0

    def answer(self):
        gains = ControlGains(**self.values)
        flight, left = self.memory['flight']['age'][0], self.memory['suspension']['left'][0]
        law = gains.packed().view(float)
        control_in_place(self.state, self.memory, law, self.position, self.velocity, self.command)
        effort, area, guard, used, verdict, ratio = self.command.item()
        assert math.isfinite(effort)
        assert math.isfinite(ratio)
        assert abs(effort) <= (gains.effort_limit or math.inf)
        if guard != NO_IMPULSE:
            noise = self.memory['noise']
            hidden = any(noise[name]['sd'][0] > 0.0 for name in ('velocity', 'difference'))
            ended = verdict != NO_VERDICT or flight >= gains.response_timeout
            assert flight == 0.0 or ended or hidden
            assert left <= 1.0
            if guard == POSITION_ZERO:
                assert abs(area) <= 2.0 * gains.m * UPPER * 1e4
            else:
                assert area * (self.position - gains.x_r) < 0.0
        learnt = self.memory['learnt'][0]
        assert learnt['jumps'] == 0.0 or (learnt['masses'][: int(learnt['jumps'])] > 0.0).all()
        assert all(np.isfinite(list(item)).all() for item in self.memory['suspension'])
        return effort

    @rule(x_r=signed)
    def move_the_set_point(self, x_r):
        self.values |= {'x_r': x_r}

    @rule(m=st.floats(0.01, 10.0))
    def assume_another_mass(self, m):
        before, old = self.memory['learnt']['mass'][0], self.values['m']
        self.values |= {'m': m}
        if self.state[0]:
            was = self.memory['learnt']['jumps'][0]
            self.answer()
            if self.memory['learnt']['jumps'][0] == was and self.command['verdict'] == NO_VERDICT:
                assert math.isclose(
                    self.memory['learnt']['mass'][0] * m, before * old, rel_tol=1e-9
                )

    @rule(steps=st.integers(1, 30), mass=st.floats(0.005, 20.0), delay=st.integers(0, 3))
    def follow_the_law(self, steps, mass, delay):
        queue = [0.0] * delay
        for _ in range(steps):
            queue.append(self.answer())
            self.velocity += DT * queue.pop(0) / mass
            self.position += DT * self.velocity
            if max(abs(self.position), abs(self.velocity)) > 1e3:
                self.position, self.velocity = 1.0, 0.0

    @rule(position=signed, velocity=st.one_of(signed, st.just(math.nan)))
    def jump_anywhere(self, position, velocity):
        self.position, self.velocity = position, velocity
        self.answer()
        self.velocity = 0.0 if math.isnan(velocity) else velocity


TestSupervisedLaw = SupervisedLaw.TestCase
TestSupervisedLaw.settings = settings(max_examples=30, stateful_step_count=20, deadline=None)
