"""
The noise of a velocity, learnt from samples of a moving or resting axis.

White noise of the velocity makes its second differences alternate in sign; a smooth motion does
not. The product of two successive second differences r of white noise has the mean -4 sigma^2.
For the difference of noisy positions, w = (x - x_before) / dt, the mean is -7.5 sigma_w^2, with
sigma_w = sqrt(2) sigma_x / dt. Only products in a row of three alternating second differences
count, each larger than LEAST of the speed; the mean is corrected for those left out. A jump or a
stop alternates at most once, so an exact sensor has a noise of exactly zero.

=========  ==============  =====  ==========================================================
symbol     name            unit   meaning
=========  ==============  =====  ==========================================================
v          velocity        m/s    velocity that the law uses
w          difference      m/s    difference of the positions over the last sample
r          curve           m/s    second difference of either
sigma      sd              m/s    standard deviation of the noise of either
=========  ==============  =====  ==========================================================
"""

from typing import NamedTuple

import numpy as np

from impulse_control_ros.core.jit import compiled

LEAST = 0.01  # of the speed: less noise than this does not matter
EVERY = 4.0  # samples per update, once there are UPDATES
UPDATES = 128.0  # that the average goes back
KNOWN = 48.0  # updates after which the noise counts as known
MOST = 9.0  # times the variance, that an update may have once the noise is known
# sigma^2 / the mean product, with those left out as 0; from 4,000,000 normal samples
OF_VELOCITY, OF_DIFFERENCE = 0.29504, 0.15055
NOTHING = 1e-18  # m^2/s^2: a smaller variance is rounding


class Signal(NamedTuple):
    """A noisy velocity: value, first and second difference [m/s], and what is known of it."""

    value: float
    step: float
    curve: float
    alternates: float
    variance: float
    sd: float


class Noise(NamedTuple):
    """Noise of the velocity and of the difference of positions; ``pause`` in samples."""

    updates: float
    count: float
    pause: float
    velocity: Signal
    difference: Signal


SILENT = Signal(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
UNKNOWN = Noise(0.0, 0.0, 0.0, SILENT, SILENT)


@compiled
def begun(velocity):
    """Return the `Noise` at the first sample."""
    return Noise(0.0, 0.0, 3.0, Signal(velocity, 0.0, 0.0, 0.0, 0.0, 0.0), SILENT)


@compiled
def is_known(noise):
    """Return whether enough samples were seen."""
    return noise.updates >= KNOWN


@compiled
def next_signal(signal, value, due, factor, weight):
    """Return the `Signal` one sample later; an update is ``due`` or not."""
    step = value - signal.value
    curve = step - signal.step
    product = curve * signal.curve
    least = LEAST * (abs(value) + abs(signal.value))
    alternates = product < 0.0 and min(abs(curve), abs(signal.curve)) > least
    variance, sd = signal.variance, signal.sd
    if due:
        fresh = -factor * product if alternates and signal.alternates != 0.0 else 0.0
        if weight < 1.0 / KNOWN and variance > NOTHING:  # a jump that is not seen yet
            fresh = min(fresh, MOST * variance)
        variance += weight * (fresh - variance)
        sd = np.sqrt(variance) if variance > NOTHING else 0.0
    return Signal(value, step, curve, 1.0 if alternates else 0.0, variance, sd)


@compiled
def next_noise(noise, velocity, difference, pause):
    """
    Return the `Noise` one sample later.

    ``pause`` leaves out so many samples, which a jump of the velocity disturbs; if negative, those
    left out before count again.
    """
    left = 0.0 if pause < 0.0 else max(noise.pause - 1.0, pause)
    count = noise.count + 1.0
    updates, weight = noise.updates, 0.0
    due = (count == EVERY or updates < UPDATES) and left <= 0.0
    if due:
        updates = min(updates + 1.0, UPDATES)
        weight = 1.0 / updates
    return Noise(
        updates,
        0.0 if count == EVERY else count,
        max(left, 0.0),
        next_signal(noise.velocity, velocity, due, OF_VELOCITY, weight),
        next_signal(noise.difference, difference, due, OF_DIFFERENCE, weight),
    )
