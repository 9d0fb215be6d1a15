"""
The noise of a velocity, estimated while the axis moves or rests.

White noise of the velocity makes its second differences alternate in sign; a smooth motion does
not. The product of two successive second differences r of white noise has the mean -4 sigma^2.
For the difference of noisy positions, w = (x - x_before) / dt, the mean is -7.5 sigma_w^2, with
sigma_w = sqrt(2) sigma_x / dt. A product counts only if three second differences in a row
alternate in sign, each larger than LEAST of the speed; the mean is corrected for the others. A
jump or a stop alternates at most once, so an exact sensor has a noise of exactly zero. Noise that
was hidden by the speed appears as SURPRISES updates far above the estimate, which then follows
fast. Once the speed has halved, every sample is used again.

=========  ==============  =====  ==========================================================
symbol     name            unit   meaning
=========  ==============  =====  ==========================================================
v          velocity        m/s    velocity that the law uses
w          difference      m/s    difference of the positions over the last sample
r          curve           m/s    second difference of either
sigma      sd              m/s    standard deviation of the noise of either
=========  ==============  =====  ==========================================================
"""

import numpy as np

from impulse_control_ros.core.jit import compiled, record

LEAST = 0.01  # of the speed: less noise than this does not matter
EVERY, LOOK = 16.0, 4.0  # samples per update, once there are UPDATES, of which the last count
UPDATES = 128.0  # that the average goes back
KNOWN = 48.0  # updates after which the noise counts as known
MOST = 9.0  # times the variance, that an update may have once the noise is known
SURPRISES = 3.0  # in a row: the noise was hidden by the speed
# sigma^2 / the mean product, with those left out as 0; from 4,000,000 normal samples
OF_VELOCITY, OF_DIFFERENCE = 0.29504, 0.15055
NOTHING = 1e-18  # m^2/s^2: a smaller variance is rounding


# a noisy velocity [m/s]: value, first and second differences, and what is known of its noise
SIGNAL = record(
    [
        (name, 'f8')
        for name in ('value', 'step', 'curve', 'alternates', 'variance', 'sd', 'surprises')
    ]
)
# pause: samples still to skip; count: samples since the last update; speed [m/s]: the largest
# measured one, which hides noise below LEAST of it
NOISE = record(
    [
        *((name, 'f8') for name in ('updates', 'count', 'pause', 'speed')),
        ('velocity', SIGNAL),
        ('difference', SIGNAL),
    ]
)


@compiled
def begin_noise(noise, velocity):
    """Start at the first sample, with a cleared memory of dtype NOISE."""
    noise.pause, noise.velocity.value = 4.0, velocity


@compiled
def is_known(noise):
    """Return whether enough samples were seen."""
    return noise.updates >= KNOWN


@compiled
def next_value(signal, value):
    """Take the value of the next sample; return minus its product if that counts, else 0."""
    step = value - signal.value
    curve = step - signal.step
    product = curve * signal.curve
    least = LEAST * (abs(value) + abs(signal.value))
    alternates = product < 0.0 and min(abs(curve), abs(signal.curve)) > least
    counts = alternates and signal.alternates != 0.0
    signal.value, signal.step, signal.curve = value, step, curve
    signal.alternates = 1.0 if alternates else 0.0
    return -product if counts else 0.0


@compiled
def update(signal, fresh, weight):
    """Update the variance with the ``fresh`` one [m^2/s^2]."""
    if fresh > 0.0:
        surprise = fresh > max(100.0 * signal.variance, NOTHING)
        signal.surprises = signal.surprises + 1.0 if surprise else 0.0
    if signal.surprises >= SURPRISES:
        weight = max(weight, 1.0 / 16.0)
    elif weight < 1.0 / KNOWN and signal.variance > NOTHING:  # a jump that is not seen yet
        fresh = min(fresh, MOST * signal.variance)
    if fresh == signal.variance:
        return
    signal.variance += weight * (fresh - signal.variance)
    signal.sd = np.sqrt(signal.variance) if signal.variance > NOTHING else 0.0


@compiled
def pass_exact(noise, samples):
    """Skip samples that are known to have no noise, with the same result as `next_noise`."""
    noise.updates = min(
        noise.updates + samples - min(max(noise.pause - 1.0, 0.0), samples), UPDATES
    )
    noise.pause = max(noise.pause - samples, 0.0)


@compiled
def next_noise(noise, velocity, difference, estimated):
    """Take the next sample [m/s]; ``estimated`` is 1 if the velocity is an estimate."""
    noise.count += 1.0
    noise.pause = max(noise.pause - 1.0, 0.0)
    speed = 0.0 if estimated != 0.0 else abs(velocity)
    if speed < 0.5 * noise.speed and noise.velocity.sd < LEAST * noise.speed:
        noise.updates, noise.speed = min(noise.updates, KNOWN), speed
    noise.speed = max(noise.speed, speed)
    if noise.updates == UPDATES and noise.count <= EVERY - LOOK:
        noise.velocity.value, noise.difference.value = velocity, difference
        return
    of_velocity = next_value(noise.velocity, velocity)
    of_difference = next_value(noise.difference, difference)
    if noise.pause == 0.0 and (noise.count >= EVERY or noise.updates < UPDATES):
        noise.count = 0.0
        noise.updates = min(noise.updates + 1.0, UPDATES)
        weight = 1.0 / noise.updates
        update(noise.velocity, OF_VELOCITY * of_velocity, weight)
        # a resting encoder tells nothing, and would seem better than the velocity
        if estimated != 0.0 or difference != 0.0 or noise.difference.step != 0.0:
            update(noise.difference, OF_DIFFERENCE * of_difference, weight)
