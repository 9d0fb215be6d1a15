"""Diffrax: diffeqsolve to the next event inside a jitted while loop; the events are kept."""

import diffrax
import jax
from jax import lax, numpy as jnp
import optimistix

READING = 'ONE_JUMP'
KIND = 'compiled'
PACKAGES = ('diffrax', 'jax', 'jaxlib')
LIMIT = 20_000
jax.config.update('jax_enable_x64', True)


def prepare(case):
    """Return the run."""
    m, damping, F_c, K = case.m, case.d + case.D, case.F_c, case.K
    seconds = case.seconds

    def flow(t, state, args):
        x, v = state
        return v, -(damping * v + K * x + F_c * args[0]) / m

    def guard(t, y, args, **_):
        direction, armed = args  # a zero that the arc starts at would count at once
        return jnp.maximum(jnp.where(armed, direction * y[0], -1.0), -direction * y[1])

    event = diffrax.Event(guard, optimistix.Bisection(1e-10, 1e-10), direction=True)
    term, solver = diffrax.ODETerm(flow), diffrax.Dopri5()
    control = diffrax.PIDController(rtol=1e-8, atol=1e-10)

    def arc(carry):
        count, t, x, v, times, positions = carry
        direction, armed = jnp.sign(v), x * v < 0.0
        solution = diffrax.diffeqsolve(
            term,
            solver,
            t,
            seconds,
            1e-3,
            (x, v),
            (direction, armed),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=control,
            event=event,
            adjoint=diffrax.ForwardMode(),
        )
        t, x, v = solution.ts[-1], solution.ys[0][-1], solution.ys[1][-1]
        jumps, crossed = solution.event_mask, armed & (direction * x > -direction * v)
        v = jnp.where(jumps, jnp.where(crossed, case.bounce * v, -case.kick * x), v)
        x = jnp.where(jumps & crossed, 0.0, x)
        count += 1
        return count, t, x, v, times.at[count].set(t), positions.at[count].set(x)

    def flows(carry):
        return (carry[1] < seconds) & (carry[0] < LIMIT - 1)

    @jax.jit
    def trajectory(x_0):
        times = jnp.zeros(LIMIT)
        return lax.while_loop(
            flows, arc, (0, 0.0, x_0, -case.kick * x_0, times, times.at[0].set(x_0))
        )

    def run():
        count, *_, times, positions = trajectory(case.x_0)
        return times[: int(count) + 1], positions[: int(count) + 1]

    return run
