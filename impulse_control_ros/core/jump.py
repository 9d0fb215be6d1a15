"""
The velocity jump of the impulse in flight, and the mass and the delay that it measures.

============  ==============  ========  =====================================================
symbol        name            unit      meaning
============  ==============  ========  =====================================================
J             area            N s       area of the impulse in flight, sent so far
y             level           m/s       velocity before the jump, a mean over ``size`` samples
sigma         sd              m/s       noise of y, see core/velocity_noise.py
jump          rise            m/s       change of y in the direction of J, less the trend
r             ratio           1         jump / abs(J / m)
n             delay           samples   from an impulse to its jump, beyond the first sample
============  ==============  ========  =====================================================

* The jump is detected in the measured velocity or in the difference of positions, whichever has
  less noise. It is computed from the means of blocks of samples, which are as long as the noise
  requires. The trend is the change per block before the jump, by feedback, friction and damping.
* A lag or effort_limit spreads a jump over many samples. The rise of the blocks above the trend is
  therefore summed, with a slow decay. The jump is complete once it grows no more in the last third
  of its time. The flight begins with the first part of the area, response_timeout with the last.
* Mass and delay are medians of the last five jumps that clearly exceed the noise and the
  change that friction makes in a sample. Once they are known, a jump with r below 0.6 on a resting
  axis is attributed to friction and not used.
* An impulse is absent if no jump is seen for response_timeout samples. It is out of band if r is
  above 1.4, or below 0.6 on a moving axis: friction may hold a resting axis.
"""

import numpy as np

from impulse_control_ros.core.impulse_verdicts import (
    ABSENT,
    CONFIRMED,
    NO_VERDICT,
    OUT_OF_BAND,
    REVERSED,
)
from impulse_control_ros.core.jit import compiled, record, sign
from impulse_control_ros.core.velocity_noise import is_known

LOW, HIGH = 0.6, 1.4  # of the expected jump; above 1.66 alpha_ratio 0.6 is unstable
LONGEST = 64.0  # samples of a block
TREND = 0.02  # share of a sample in the trend while an impulse is in flight
NEAR = 0.05  # a relative difference of learnt and assumed mass that is ignored
JUMPS = 5

FLIGHT = record(
    [
        (name, 'f8')
        for name in (
            'age',  # [samples] since the impulse in flight; 0 for none
            'area',  # [N s] sent so far
            'sent_age',  # [samples] when the last of it was
            'at_rest',  # whether the axis stood or turned
            'hidden',  # whether the noise hides its jump
            'by_difference',  # whether the jump is seen in the difference of positions
            'size',  # [samples] of a block
            'count',  # samples in this block
            'total',  # [m/s] their sum
            'level',  # [m/s] mean of the last block, of
            'level_size',  # so many samples
            'trend',  # [m/s] change per block before the jump
            'gathered',  # [m/s] what the last blocks rose above it
            'rising',  # so many blocks
            'seen',  # blocks since the jump began; 0 before it was seen
            'begun',  # blocks then
            'before',  # [m/s] level before the jump
            'first',  # [m/s] part of the jump in its first block
            'mark',  # [m/s] a level since, of
            'mark_seen',  # this block
            'seen_age',  # [samples] at the end of that block
            'seen_position',  # [m] there
        )
    ]
)
LEARNT = record(
    [
        ('jumps', 'f8'),  # learnt from, up to JUMPS
        ('delays', 'f8', (JUMPS,)),  # [samples] the newest first
        ('delay', 'f8'),  # [samples] their median; before the first jump was measured, an estimate
        ('masses', 'f8', (JUMPS,)),  # m / assumed m, the newest first
        ('mass', 'f8'),  # their median
        ('inverse_m', 'f8'),  # [1/kg] of the assumed m
    ]
)


@compiled
def mass_scale(learnt, options):
    """Return the mass to compute with, relative to m."""
    if options.learn_mass == 0.0 or abs(learnt.mass - 1.0) < NEAR:
        return 1.0
    return min(max(learnt.mass, options.least_mass), options.most_mass)


@compiled
def assume_mass(learnt, inverse_m):
    """Keep the learnt mass when m is set to another value."""
    change = inverse_m / learnt.inverse_m
    learnt.inverse_m = inverse_m
    learnt.mass *= change
    for i in range(JUMPS):
        learnt.masses[i] *= change


@compiled
def choose_signal(memory):
    """Choose the velocity or the difference of positions, whichever has less noise."""
    flight, noise = memory.flight, memory.noise
    better = noise.velocity.sd * flight.size > noise.difference.sd
    by_difference = 1.0 if memory.estimated != 0.0 or better else 0.0
    if by_difference != flight.by_difference:
        signal = noise.difference if by_difference != 0.0 else noise.velocity
        flight.by_difference, flight.level, flight.trend = by_difference, signal.value, 0.0


@compiled
def follow(memory, velocity, difference):
    """Follow level and trend while no impulse is in flight."""
    flight, noise = memory.flight, memory.noise
    choose_signal(memory)
    value = difference if flight.by_difference != 0.0 else velocity
    before = flight.level
    if flight.size == 1.0:
        sd = block_noise(noise, flight.by_difference, 1.0)
        gain = 1.0 if sd == 0.0 else TREND
        flight.level = value
        flight.trend += gain * (value - before - flight.trend)
    else:
        gain = 1.0 / flight.size
        flight.level += gain * (value - before)
        flight.trend += 0.25 * gain * (flight.size * (flight.level - before) - flight.trend)


@compiled
def end_flight(flight):
    """Let the next impulse start; level and trend stay."""
    flight.age = flight.area = flight.count = flight.total = flight.seen = 0.0
    flight.gathered = flight.rising = 0.0


@compiled
def block_noise(noise, by_difference, size):
    """Return the standard deviation [m/s] of a mean over ``size`` samples."""
    return (
        noise.difference.sd / size if by_difference != 0.0 else noise.velocity.sd / np.sqrt(size)
    )


@compiled
def block_size(noise, by_difference, expected):
    """Return the block size whose noise is small compared with the ``expected`` jump [m/s]."""
    ratio = 40.0 / abs(expected)
    needed = (
        ratio * noise.difference.sd if by_difference != 0.0 else (ratio * noise.velocity.sd) ** 2
    )
    return max(np.ceil(needed), 1.0)


@compiled
def watch(memory, state, gains, options, position, velocity, difference):
    """Look for the jump of the impulse in flight, block by block."""
    flight, noise, learnt = memory.flight, memory.noise, memory.learnt
    flight.age += 1.0
    flight.count += 1.0
    flight.total += difference if flight.by_difference != 0.0 else velocity
    if flight.count < flight.size:
        return
    mean = flight.total / flight.size
    flight.count = flight.total = 0.0
    expected = flight.area * options.inverse_m / mass_scale(learnt, options)
    way, most = sign(expected), abs(expected)
    change = way * (mean - flight.level)
    surplus = change - way * flight.trend
    sd = block_noise(noise, flight.by_difference, flight.size)
    old_sd = block_noise(noise, flight.by_difference, flight.level_size)
    share = (0.05 if flight.by_difference != 0.0 else 0.1) * most
    least = max(share, 7.0 * np.sqrt(sd * sd + old_sd * old_sd))
    gain = 1.0 if flight.size == 1.0 else 0.25
    if is_known(noise) and 100.0 * sd < share:  # a jump may take many samples
        gain = min(TREND * flight.size, gain)
    if flight.seen == 0.0:
        look(memory, state, options, gain, most, least, surplus, mean, position)
    else:
        flight.seen += 1.0
        measure_jump(memory, state, gains, options, most, least, change, sd, mean, position)
    if flight.seen == 0.0:
        flight.trend += gain * (way * change - flight.trend)
    elif memory.verdict != NO_VERDICT:
        flight.trend = way * change
    flight.level, flight.level_size = mean, flight.size
    if flight.seen == 0.0 and is_known(noise):
        flight.size = max(
            flight.size, min(block_size(noise, flight.by_difference, expected), LONGEST)
        )


@compiled
def is_late(flight, options):
    """Return whether the jump is overdue."""
    return flight.age > options.response_timeout + 1.5 * flight.sent_age


@compiled
def look(memory, state, options, gain, most, least, surplus, mean, position):
    """Look for the first block of the jump, ``least`` [m/s] above the trend."""
    flight, noise, learnt = memory.flight, memory.noise, memory.learnt
    comes = learnt.jumps == 0.0 or flight.age > 0.8 * learnt.delay
    earlier = (1.0 - gain) * flight.gathered if comes and gain < 0.25 else 0.0
    flight.gathered = max(earlier + surplus, 0.0)
    flight.rising = flight.rising + 1.0 if earlier > 0.0 and surplus <= least else 1.0
    if flight.gathered > least:
        flight.seen = flight.begun = flight.rising
        flight.first = flight.gathered
        flight.before = flight.level - sign(flight.area) * earlier
        flight.mark, flight.mark_seen = mean, flight.seen
        flight.seen_age, flight.seen_position = flight.age, position
        noise.pause = 4.0 if is_known(noise) else noise.pause
        if learnt.jumps == 0.0 and flight.sent_age == 1.0:
            learnt.delay = max(flight.age - 1.0 - flight.size, 0.0)
    elif is_known(noise) and state.pending == 0.0 and -surplus > max(0.3 * most, least):
        memory.verdict, memory.ratio, noise.pause = REVERSED, -1.0, 4.0
    elif is_late(flight, options):
        end_flight(flight)
        if least < LOW * most:
            memory.verdict = ABSENT
    elif least > most and learnt.jumps > 0.0 and flight.age > learnt.delay + 2.0 * flight.size:
        end_flight(flight)  # the noise hides it


@compiled
def measure_jump(memory, state, gains, options, most, least, change, sd, mean, position):
    """Measure the jump once it has not grown in the last third of the time since it began."""
    flight, noise, learnt = memory.flight, memory.noise, memory.learnt
    way, since = sign(flight.area), flight.seen - flight.mark_seen
    risen, growth = way * (flight.level - flight.before), way * (mean - flight.mark)
    added = 0.5 * (way * flight.trend + growth / since) * (flight.seen - flight.begun)
    rise, surplus = risen - added, growth - way * flight.trend * since
    grows = min(growth, surplus) >= max(0.1 * risen, 5.0 * sd) or state.pending != 0.0
    early = flight.seen < 1.5 * flight.mark_seen
    sure = is_known(noise)
    fallen = way * (mean - flight.before) < 0.5 * flight.first
    if flight.by_difference != 0.0:  # a step of the encoder looks like a jump
        fallen = fallen or (state.pending == 0.0 and abs(added) > 0.3 * risen)
    falls = fallen and not sure
    if falls or (rise < max(0.5 * least, flight.seen * sd) and not grows):
        flight.seen = flight.gathered = noise.pause = 0.0  # it was noise
        if learnt.jumps == 0.0:
            learnt.delay = 0.0
        return
    if is_late(flight, options):
        end_flight(flight)
        return
    if grows and not early:
        flight.mark, flight.mark_seen = mean, flight.seen
    moved = way * (position - flight.seen_position)
    steady = 0.5 * rise * (flight.seen - 1.0) * flight.size * gains.time_step
    if grows or early or not (sure or (flight.seen >= 3.0 and moved > steady)):
        return
    memory.ratio, noise.pause = rise / most, 4.0
    fits = memory.ratio < HIGH and (memory.ratio > LOW or flight.at_rest != 0.0)
    clear, slow = rise > 10.0 * sd, abs(added) > 0.3 * most
    memory.verdict = CONFIRMED if fits or (clear and slow) else OUT_OF_BAND
    held = flight.at_rest != 0.0 and memory.ratio < LOW and learnt.jumps >= 2.0  # by friction
    if clear and not held and rise > 10.0 * max(abs(change), abs(added)):
        late = flight.seen_age - 1.0 - flight.size * flight.first / rise
        late -= 0.5 if flight.by_difference != 0.0 else 0.0
        learn(memory, options, max(np.floor(late + 0.5), 0.0))


@compiled
def learn(memory, options, delay):
    """Learn delay and mass from a jump; with learn_mass, the first two jumps are confirmed."""
    learnt = memory.learnt
    mass = mass_scale(learnt, options) / memory.ratio
    mass = min(max(mass, options.least_mass), options.most_mass)
    agrees = learnt.jumps > 0.0 and abs(mass - learnt.masses[0]) < 0.3 * mass
    learnt.jumps = min(learnt.jumps + 1.0, float(JUMPS))
    if memory.verdict == OUT_OF_BAND and agrees:
        learnt.jumps = 2.0  # the mass has changed: forget the older ones
    for i in range(JUMPS - 1, 0, -1):
        learnt.delays[i], learnt.masses[i] = learnt.delays[i - 1], learnt.masses[i - 1]
    learnt.delays[0], learnt.masses[0] = delay, mass
    learnt.delay = median_of(learnt.delays, learnt.jumps)
    learnt.mass = median_of(learnt.masses, learnt.jumps)
    if options.learn_mass != 0.0 and learnt.jumps <= 2.0:
        memory.verdict = CONFIRMED


@compiled
def median_of(values, count):
    """Return the median of the first ``count`` of five values."""
    a, b, c, d, e = values[0], values[1], values[2], values[3], values[4]
    if count == 1.0:
        return a
    if count == 2.0:
        return 0.5 * (a + b)
    low, high = min(a, b), max(a, b)
    if count == 3.0:
        return max(low, min(high, c))
    f, g = max(low, min(c, d)), min(high, max(c, d))
    if count == 4.0:
        return 0.5 * (f + g)
    return max(min(f, g), min(max(f, g), e))
