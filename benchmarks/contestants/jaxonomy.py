"""Jaxonomy: a LeafSystem with zero crossings, compiled to JAX; its second run."""

import jax.numpy as jnp
from jaxonomy import LeafSystem, simulate, SimulatorOptions

READING = 'ONE_JUMP'
KIND = 'compiled'
PACKAGES = ('jaxonomy', 'jax', 'jaxlib')


class Loop(LeafSystem):
    """The closed loop: position, velocity, and the direction of the motion."""

    def __init__(self, case):
        super().__init__(name='loop')
        self.case = case
        self.declare_continuous_state(
            default_value=jnp.array([case.x_0, -case.kick * case.x_0, -1.0]), ode=self.flow
        )
        self.declare_continuous_state_output(name='state')
        self.declare_zero_crossing(
            lambda t, state: state.continuous_state[0], self.at_position_zero, name='position_zero'
        )
        self.declare_zero_crossing(
            lambda t, state: state.continuous_state[1], self.at_velocity_zero, name='velocity_zero'
        )

    def flow(self, t, state):
        """Flow in one direction."""
        case, (x, v, direction) = self.case, state.continuous_state
        force = -(case.d + case.D) * v - case.K * x - case.F_c * direction
        return jnp.array([v, force / case.m, 0.0])

    def at_position_zero(self, t, state):
        """Jump at x = 0."""
        v = self.case.bounce * state.continuous_state[1]
        return state.with_continuous_state(jnp.array([0.0, v, jnp.sign(v)]))

    def at_velocity_zero(self, t, state):
        """Jump at v = 0."""
        x = state.continuous_state[0]
        v = -self.case.kick * x
        return state.with_continuous_state(jnp.array([x, v, jnp.sign(v)]))


def prepare(case):
    """Return the run."""
    loop = Loop(case)
    context = loop.create_context()
    options = SimulatorOptions(
        ode_solver_method='dopri5',
        rtol=1e-8,
        atol=1e-10,
        max_major_steps=50_000,
        buffer_length=20_000,
        return_context=False,
    )
    signals = {'state': loop.output_ports[0]}

    def run():
        results = simulate(loop, context, (0.0, case.seconds), options, recorded_signals=signals)
        return results.time, results.outputs['state'][:, 0]

    return run
