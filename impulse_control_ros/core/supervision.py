"""
Supervision of impulses: each impulse is checked by the velocity jump that it causes.

An impulse of area J changes the velocity by J / m. While one impulse is in flight, no other
starts. Its jump confirms it or not, and measures the mass and the delay of the loop: core/jump.py.
Impulses that are not confirmed are suspended: core/suspension.py. Impulses on a resting axis whose
jumps are hidden by the noise join the one in flight. They are judged together, once their sum
exceeds the noise.
"""

from impulse_control_ros.core.impulse_verdicts import NO_VERDICT
from impulse_control_ros.core.jit import compiled, record
from impulse_control_ros.core.jump import (
    assume_mass,
    block_size,
    choose_signal,
    end_flight,
    FLIGHT,
    follow,
    LEARNT,
    LONGEST,
    mass_scale,
    watch,
)
from impulse_control_ros.core.suspension import (
    begin_hops,
    begin_response,
    judge,
    judge_error,
    SUSPENSION,
)
from impulse_control_ros.core.velocity_noise import begin_noise, next_noise, NOISE, pass_exact

TRIAL = 0.5  # of the area, after a suspension

SUPERVISION = record(
    [
        ('noise', NOISE),
        ('flight', FLIGHT),
        ('learnt', LEARNT),
        ('suspension', SUSPENSION),
        ('estimated', 'f8'),  # whether the velocity is
        ('verdict', 'i8'),  # of the present sample
        ('ratio', 'f8'),
    ]
)


@compiled
def begin_supervision(memory, options, error, velocity):
    """Start at the first sample, or at the one at which supervision is switched on."""
    flight, learnt, suspension = memory.flight, memory.learnt, memory.suspension
    end_flight(flight)
    flight.trend = learnt.jumps = learnt.delay = 0.0
    suspension.strikes = suspension.left = suspension.back_off = suspension.trial = 0.0
    begin_noise(memory.noise, velocity)
    flight.by_difference, flight.level = memory.estimated, velocity
    flight.size = flight.level_size = learnt.mass = 1.0
    learnt.inverse_m = options.inverse_m
    begin_response(suspension, error)


@compiled
def observe(memory, state, gains, options, position, error, velocity, exact):
    """Judge a sample before the law answers it; an ``exact`` sample has no noise."""
    noise, flight, suspension = memory.noise, memory.flight, memory.suspension
    difference = (position - state.position) * gains.sample_rate
    memory.verdict, memory.ratio = NO_VERDICT, 0.0
    if options.inverse_m != memory.learnt.inverse_m:
        assume_mass(memory.learnt, options.inverse_m)
    if flight.age == 0.0 or flight.area == 0.0:  # none, or the limit holds it back
        follow(memory, velocity, difference)
    else:
        watch(memory, state, gains, options, position, velocity, difference)
    if exact:
        pass_exact(noise, 1.0)
    else:
        next_noise(noise, velocity, difference, memory.estimated)
    if state.x_r != gains.x_r:
        begin_response(suspension, error)
    judge_error(memory, gains, abs(error))
    if memory.verdict != NO_VERDICT:
        judge(memory, gains)
        end_flight(flight)


@compiled
def note_impulse(memory, options, crosses, direction, owed, left, error):
    """Record that the area ``owed`` [N s] is due, of which ``left`` acts over this sample."""
    flight, suspension = memory.flight, memory.suspension
    expected = (flight.area + owed) * options.inverse_m / mass_scale(memory.learnt, options)
    if flight.age == 0.0:
        choose_signal(memory)
        flight.age, flight.at_rest = 1.0, 0.0 if crosses else 1.0
        if direction == 0.0:
            suspension.hops += 1.0
            suspension.hop_last = abs(error)
        elif not crosses:
            begin_hops(suspension, error)
    needed = block_size(memory.noise, flight.by_difference, expected)
    if flight.age == 1.0:
        flight.size = min(needed, LONGEST)
    flight.hidden = 1.0 if needed > LONGEST else 0.0
    flight.area += left
    flight.sent_age = flight.age
    suspension.acted += 1.0


@compiled
def may_fire(memory):
    """Return whether an impulse may start, or join one in flight that is hidden by the noise."""
    flight, learnt, suspension = memory.flight, memory.learnt, memory.suspension
    is_hidden = flight.hidden != 0.0 and flight.at_rest != 0.0 and flight.seen == 0.0
    acts = learnt.jumps > 0.0 and flight.age > flight.sent_age + learnt.delay
    joins = is_hidden and acts and memory.estimated == 0.0 and suspension.back_off == 0.0
    return (flight.age == 0.0 or joins) and suspension.left == 0.0
