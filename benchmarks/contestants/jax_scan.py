"""The plain loop's law as a jitted JAX scan at 1e-4."""

import jax
from jax import lax, numpy as jnp

READING = 'STRICT'
KIND = 'compiled'
PACKAGES = ('jax', 'jaxlib')
jax.config.update('jax_enable_x64', True)


def prepare(case):
    """Return the run."""
    m, d, F_c, K, D, dt = case.m, case.d, case.F_c, case.K, case.D, case.time_step
    against, towards = (1.0 - case.bounce) * m / dt, case.kick * m / dt

    def response(duration):
        decay = jnp.exp(-d * duration / m)
        gain = (1.0 - decay) / d
        return decay, gain, m * gain, (duration - m * gain) / d

    decay, gain, slide, push = (float(value) for value in response(dt))

    def turn(x, v, force, u):
        stop = jnp.log1p(-d * v / force) * m / d
        _, _, slid, pushed = response(stop)
        x = x + slid * v + pushed * force
        force = jnp.sign(u) * jnp.maximum(jnp.abs(u) - F_c, 0.0)
        _, gained, _, pushed = response(dt - stop)
        return x + pushed * force, gained * force

    def step(carry, _):
        x, v, right, forward, stood, pulsed = carry
        stands, ahead = jnp.abs(v) <= 1e-6, v > 0.0
        crossed = ((x > 0.0) != right) & ~stands
        turned = (stands | ((ahead != forward) & ~stood & ~pulsed)) & ~crossed
        turned &= jnp.abs(x) > 1e-6
        share = jnp.where(stands & stood, 0.5, 1.0)
        impulse = jnp.where(crossed, against * v, jnp.where(turned, towards * x * share, 0.0))
        u = -K * x - D * v - impulse
        direction = jnp.sign(jnp.where(v != 0.0, v, u))
        sticks = (v == 0.0) & (jnp.abs(u) <= F_c)
        force = jnp.where(sticks, 0.0, u - F_c * direction)
        next_v = decay * v + gain * force
        after = lax.cond(
            (v != 0.0) & (next_v * direction <= 0.0),
            turn,
            lambda x, v, force, u: (x + slide * v + push * force, next_v),
            x,
            v,
            force,
            u,
        )
        return (*after, right ^ crossed, ahead, stands, crossed | turned), x

    @jax.jit
    def trajectory(x_0):
        start = (x_0, 0.0, x_0 > 0.0, False, False, False)
        return lax.scan(step, start, length=case.steps + 1)[1]

    def run():
        positions = trajectory(case.x_0).block_until_ready()
        return jnp.arange(case.steps + 1) * dt, positions

    return run
