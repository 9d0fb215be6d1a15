"""
Supervision of impulses: every impulse is checked by the jump that it causes.

An impulse of area J makes the velocity jump by J / m. While one is in flight, no other starts. Its
jump confirms it or not, and measures the mass and the delay of the loop.

============  ==============  ========  =====================================================
symbol        name            unit      meaning
============  ==============  ========  =====================================================
J             area            N s       area of the impulse in flight, sent so far
y             level           m/s       velocity before the jump, a mean over ``size`` samples
sigma         sd              m/s       noise of y, see core/velocity_noise.py
jump          jump            m/s       change of y, along J, without the trend
r             ratio           1         jump / abs(J / m)
n             delay           samples   from an impulse to its jump, beyond the first sample
============  ==============  ========  =====================================================

* The jump is seen in the measured velocity or in the difference of positions, whichever has less
  noise, over blocks of samples that are as long as the noise requires. Trend is the change per
  block before the jump: feedback, friction and damping.
* The mass is the median of the last five J / jump from jumps that clearly exceed the noise and the
  change that friction makes in a sample.
* An impulse is absent if no jump is seen for response_timeout samples. It is out of band if r is
  above 1.4, or below 0.6 for an axis that moved: friction may keep a resting axis from moving.
  Two such impulses in a row suspend impulses, and so does abs(e) above 1.1 times its last turning
  point while impulses act, or sticking impulses that hardly bring the axis nearer. Impulses are
  suspended for 1 s, then 2, 4, ... 64 s.
"""

from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.velocity_noise import begun, is_known, next_noise, Noise, UNKNOWN

VERDICTS = ('', 'confirmed', 'absent', 'out_of_band', 'reversed', 'growing', 'stalled')
NO_VERDICT, CONFIRMED, ABSENT, OUT_OF_BAND, REVERSED, GROWING, STALLED = range(7)
LOW, HIGH = 0.6, 1.4  # of the expected jump; above 1.66 alpha_ratio 0.6 is unstable
LONGEST = 64.0  # samples of a block
NEAR = 0.05  # a learnt mass this near the assumed one changes nothing


class Flight(NamedTuple):
    """The impulse in flight: ``age`` [samples], 0 for none, and the search for its jump."""

    age: float
    area: float
    at_rest: float
    by_difference: float
    size: float
    count: float
    total: float
    level: float
    level_size: float
    trend: float
    seen: float
    before: float
    first: float
    seen_age: float
    seen_position: float


class Learnt(NamedTuple):
    """Delay [samples], number of jumps, the last five m / assumed m, and their median."""

    delay: float
    jumps: float
    mass_0: float
    mass_1: float
    mass_2: float
    mass_3: float
    mass_4: float
    mass: float


class Suspension(NamedTuple):
    """Strikes and what is left [samples], the envelope [m], and progress of sticking impulses."""

    strikes: float
    left: float
    back_off: float
    acted: float
    bound: float
    floor: float
    hops: float
    hop_error: float
    hop_age: float


class Supervision(NamedTuple):
    """Memory of the supervision between samples, all floats."""

    noise: Noise
    flight: Flight
    learnt: Learnt
    suspension: Suspension


class Finding(NamedTuple):
    """What a sample tells: verdict, ratio r, and whether a jump begins, ends or was none."""

    verdict: int
    ratio: float
    jump: float
    delay: float
    pause: float


NO_FLIGHT = Flight(*[0.0] * len(Flight._fields))
NEW = Supervision(
    UNKNOWN,
    NO_FLIGHT,
    Learnt(*[0.0] * len(Learnt._fields)),
    Suspension(*[0.0] * len(Suspension._fields)),
)


@compiled
def supervision_at(options, error, velocity):
    """Return the `Supervision` at the first sample."""
    flight = Flight(
        0.0, 0.0, 0.0, options.estimates, 1.0, 0.0, 0.0, velocity, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    )
    learnt = Learnt(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return Supervision(begun(velocity), flight, learnt, envelope_at(error))


@compiled
def envelope_at(error):
    """Return the `Suspension` of a new response."""
    return Suspension(0.0, 0.0, 0.0, 0.0, abs(error), 0.1 * abs(error), 0.0, abs(error), 0.0)


@compiled
def mass_scale(learnt, options):
    """Return the mass to compute with, relative to m."""
    if options.learn_mass == 0.0 or abs(learnt.mass - 1.0) < NEAR:
        return 1.0
    return learnt.mass


@compiled
def observed(supervision, state, gains, options, position, error, velocity):
    """Return the `Supervision` after a sample, before the law answers it, and the `Finding`."""
    noise, flight = supervision.noise, supervision.flight
    learnt, suspension = supervision.learnt, supervision.suspension
    difference = (position - state.position) * gains.sample_rate
    finding = Finding(NO_VERDICT, 0.0, 0.0, learnt.delay, 0.0)
    if flight.age == 0.0:
        flight = idle(flight, noise, options, velocity, difference)
    else:
        expected = flight.area * options.inverse_m / mass_scale(learnt, options)
        flight, finding = watched(
            flight, noise, learnt, state, gains, options, expected, position, velocity, difference
        )
        if finding.jump != 0.0 or finding.delay != learnt.delay:
            learnt, finding = learnt_from(learnt, finding, flight, options)
    noise = next_noise(noise, velocity, difference, finding.pause)
    suspension, verdict = suspended(suspension, finding.verdict, state, gains, error)
    if finding.verdict != NO_VERDICT or suspension.left > 0.0:
        flight = landed(flight)
    finding = Finding(verdict, finding.ratio, finding.jump, finding.delay, finding.pause)
    return Supervision(noise, flight, learnt, suspension), finding


@compiled
def idle(flight, noise, options, velocity, difference):
    """Follow level and trend while no impulse is in flight."""
    by_difference = flight.by_difference
    if options.estimates == 0.0:
        better = noise.velocity.sd > noise.difference.sd / flight.size
        by_difference = 1.0 if better else 0.0
    value = difference if by_difference != 0.0 else velocity
    if by_difference != flight.by_difference:
        level, trend = value, 0.0
    elif flight.size == 1.0:
        level, trend = value, value - flight.level
    else:
        gain = 1.0 / flight.size
        level = flight.level + gain * (value - flight.level)
        trend = flight.trend + 0.25 * gain * (flight.size * (level - flight.level) - flight.trend)
    return Flight(
        0.0, 0.0, 0.0, by_difference, flight.size, 0.0, 0.0, level, flight.size, trend,
        0.0, 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


@compiled
def landed(flight):
    """Return the flight ended; level and trend stay."""
    return Flight(
        0.0, 0.0, 0.0, flight.by_difference, flight.size, 0.0, 0.0, flight.level,
        flight.level_size, flight.trend, 0.0, 0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip


@compiled
def block_noise(noise, by_difference, size):
    """Return the standard deviation [m/s] of a mean over ``size`` samples."""
    return noise.difference.sd / size if by_difference != 0.0 else noise.velocity.sd / np.sqrt(size)


@compiled
def block_size(noise, by_difference, expected):
    """Return the samples of a block whose noise is small against the ``expected`` jump [m/s]."""
    ratio = 40.0 / abs(expected)
    needed = ratio * noise.difference.sd if by_difference != 0.0 else (ratio * noise.velocity.sd) ** 2
    return min(max(np.ceil(needed), 1.0), LONGEST)


@compiled
def watched(
    flight, noise, learnt, state, gains, options, expected, position, velocity, difference
):
    """Return the flight one sample later, and the `Finding`."""
    f = flight
    age, count = f.age + 1.0, f.count + 1.0
    total = f.total + (difference if f.by_difference != 0.0 else velocity)
    verdict, ratio, jump, delay, pause = NO_VERDICT, 0.0, 0.0, learnt.delay, 0.0
    size, level, level_size, trend = f.size, f.level, f.level_size, f.trend
    seen, before, first = f.seen, f.before, f.first
    seen_age, seen_position = f.seen_age, f.seen_position
    if count == size:
        mean = total / size
        count, total = 0.0, 0.0
        way, most = sign(expected), abs(expected)
        change = way * (mean - level)
        surplus = change - way * trend
        sd = block_noise(noise, f.by_difference, size)
        old_sd = block_noise(noise, f.by_difference, level_size)
        least = max(
            (0.05 if f.by_difference != 0.0 else 0.1) * most,
            7.0 * np.sqrt(sd * sd + old_sd * old_sd),
        )
        sure = is_known(noise)
        if seen == 0.0:
            if surplus > least:
                seen, before, first, seen_age, seen_position = 1.0, level, surplus, age, position
                pause = 3.0
                if learnt.jumps == 0.0:
                    delay = max(age - 1.0 - size, 0.0)
            elif sure and -surplus > max(0.3 * most, least):
                verdict, ratio, pause = REVERSED, -1.0, 3.0
            elif age > options.response_timeout:
                age = 0.0
                if least < LOW * most:
                    verdict = ABSENT
        else:
            seen += 1.0
            risen = way * (level - before)
            rise = risen - 0.5 * (way * trend + change) * (seen - 1.0)
            moved = way * (position - seen_position)
            proven = sure or (
                seen >= 3.0 and moved > 0.5 * rise * (seen - 1.0) * size * gains.time_step
            )
            grows = min(change, surplus) >= max(0.1 * risen, 5.0 * sd) or state.pending != 0.0
            falls = not sure and way * (mean - before) < 0.5 * first
            if falls or (rise < 0.5 * least and not grows):
                seen, pause = 0.0, -1.0
                if learnt.jumps == 0.0:
                    delay = 0.0
            elif age > options.response_timeout:
                age = 0.0
            elif proven and not grows:
                ratio = rise / most
                fits = ratio < HIGH and (ratio > LOW or f.at_rest != 0.0)
                verdict, pause = (CONFIRMED if fits else OUT_OF_BAND), 3.0
                if rise > 10.0 * sd and rise > 10.0 * abs(change):
                    jump = rise
                    late = seen_age - 1.0 - size * first / rise
                    late -= 0.5 if f.by_difference != 0.0 else 0.0
                    delay = max(np.floor(late + 0.5), 0.0)
        if seen == 0.0:
            gain = 1.0 if size == 1.0 else 0.25
            trend += gain * (way * change - trend)
            if sure and age > 0.0 and verdict == NO_VERDICT:
                size = max(size, block_size(noise, f.by_difference, expected))
        elif verdict != NO_VERDICT:
            trend = way * change
        level, level_size = mean, f.size
    after = Flight(
        age, f.area if age > 0.0 else 0.0, f.at_rest, f.by_difference, size, count, total, level,
        level_size, trend, seen, before, first, seen_age, seen_position,
    )  # fmt: skip
    return after, Finding(verdict, ratio, jump, delay, pause)


@compiled
def learnt_from(learnt, finding, flight, options):
    """Return what is `Learnt` with a jump more; the first jumps confirm the mass they give."""
    if finding.jump == 0.0:
        return (
            Learnt(
                finding.delay, learnt.jumps, learnt.mass_0, learnt.mass_1, learnt.mass_2,
                learnt.mass_3, learnt.mass_4, learnt.mass,
            ),
            finding,
        )
    scale = mass_scale(learnt, options)
    mass = scale / finding.ratio
    mass = min(max(mass, options.least_mass), options.most_mass)
    jumps = min(learnt.jumps + 1.0, 5.0)
    agree = learnt.jumps > 0.0 and abs(mass - learnt.mass_0) < 0.3 * mass
    if finding.verdict == OUT_OF_BAND and agree:
        jumps = 2.0  # the mass has changed: forget the older ones
    median = median_of(
        mass, learnt.mass_0, learnt.mass_1, learnt.mass_2, learnt.mass_3, jumps
    )
    verdict = finding.verdict
    if options.learn_mass != 0.0 and jumps <= 2.0:
        verdict = CONFIRMED
    after = Learnt(
        finding.delay, jumps, mass, learnt.mass_0, learnt.mass_1, learnt.mass_2, learnt.mass_3, median
    )
    return after, Finding(verdict, finding.ratio, finding.jump, finding.delay, finding.pause)


@compiled
def median_of(a, b, c, d, e, count):
    """Return the median of the first ``count`` of five values."""
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


@compiled
def suspended(suspension, verdict, state, gains, error):
    """Return the `Suspension` after a sample, and the verdict."""
    s, size = suspension, abs(error)
    strikes, left, back_off, acted, bound = s.strikes, s.left, s.back_off, s.acted, s.bound
    floor, hops, hop_error, hop_age = s.floor, s.hops, s.hop_error, s.hop_age + 1.0
    if left > 0.0:
        left -= 1.0
        if left == 0.0:
            acted, bound, hops, hop_error, hop_age = 0.0, max(size, floor), 0.0, size, 0.0
    if state.x_r != gains.x_r:
        acted, bound, floor, hops, hop_error, hop_age = 0.0, size, 0.1 * size, 0.0, size, 0.0
    if size > 1.1 * bound:
        if acted > 0.0 and left == 0.0:
            verdict, strikes = GROWING, 1.0
        bound = size
    if hops >= 8.0:
        if size > hop_error * (1.0 - 0.2 * hop_age * gains.time_step):
            verdict, strikes = STALLED, 1.0
        hops, hop_error, hop_age = 0.0, size, 0.0
    if verdict == CONFIRMED:
        strikes, back_off = 0.0, 0.0
    elif verdict != NO_VERDICT:
        strikes += 1.0
    if strikes >= 2.0 and left == 0.0:
        back_off = min(max(2.0 * back_off, gains.sample_rate), 64.0 * gains.sample_rate)
        left, strikes, acted = back_off, 0.0, 0.0
    return (
        Suspension(strikes, left, back_off, acted, bound, floor, hops, hop_error, hop_age),
        verdict,
    )


@compiled
def sent(supervision, options, direction, before, owed, left, error):
    """
    Return the `Supervision` after the law's answer.

    ``owed`` [N s] is the area due and ``left`` [N s] the part that acts over this sample;
    ``direction`` and ``before`` are the signs of the velocity at this and the last sample.
    """
    flight, s = supervision.flight, supervision.suspension
    acted, bound, hops, hop_error, hop_age = s.acted, s.bound, s.hops, s.hop_error, s.hop_age
    if owed != 0.0:
        f, rests = flight, direction == 0.0
        age, size, count, total, at_rest = f.age, f.size, f.count, f.total, f.at_rest
        if age == 0.0:
            age, count, total, at_rest = 1.0, 0.0, 0.0, 1.0 if rests else 0.0
            expected = owed * options.inverse_m / mass_scale(supervision.learnt, options)
            size = block_size(supervision.noise, f.by_difference, expected)
            hops = hops + 1.0 if rests else 0.0
            if not rests:
                hop_error, hop_age = abs(error), 0.0
        acted += 1.0
        flight = Flight(
            age, f.area + left, at_rest, f.by_difference, size, count, total, f.level,
            f.level_size, f.trend, f.seen, f.before, f.first, f.seen_age, f.seen_position,
        )  # fmt: skip
    if direction != before and before != 0.0:
        bound, acted = max(abs(error), s.floor), 1.0 if owed != 0.0 else 0.0
    suspension = Suspension(
        s.strikes, s.left, s.back_off, acted, bound, s.floor, hops, hop_error, hop_age
    )
    return Supervision(supervision.noise, flight, supervision.learnt, suspension)


@compiled
def may_fire(supervision):
    """Return whether the next impulse may start."""
    return (supervision.flight.age == 0.0) & (supervision.suspension.left == 0.0)
