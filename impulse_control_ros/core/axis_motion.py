"""
The direction in which an axis moves at each sample of a record, and where it stands.

==========  ==============  =======  ==========================================================
symbol      name            unit     meaning
==========  ==============  =======  ==========================================================
s           direction       1        mean of sign(v) over the sample that starts at t_k
==========  ==============  =======  ==========================================================
"""

from dataclasses import dataclass

import numpy as np

from impulse_control_ros.core.axis_record import derivative, REST, Samples, smooth

LONGEST_SMOOTHING = 0.05  # s, of a velocity for its sign


@dataclass(frozen=True, kw_only=True)
class Motion:
    """
    The motion of a piece of n ``samples``.

    ``friction`` (n,) is the mean direction of the two samples that meet at each time, ``forward``
    (n,) [m] the way in positive direction over half of both. ``stood`` (n + 1,) is the number of
    samples before each time in which the axis stands.
    """

    samples: Samples
    friction: np.ndarray
    forward: np.ndarray
    stood: np.ndarray


def smoothing_of(samples: Samples, window: float) -> float:
    """Return the time [s] to smooth the velocity over, 0 if a measured one is exact."""
    return 0.0 if samples.is_exact else min(window, LONGEST_SMOOTHING)


def motion_of(samples: Samples, window: float) -> Motion:
    """Return the motion of a piece for a window [s] of the weak form."""
    direction, standing = direction_of(samples, smoothing_of(samples, window))
    friction, forward = np.zeros_like(direction), np.zeros_like(direction)
    friction[1:] = 0.5 * (direction[1:] + direction[:-1])
    forward[1:-1] = samples.position[2:] - samples.position[:-2]
    forward[1:-1] *= 0.25 * (1.0 + friction[1:-1])
    return Motion(
        samples=samples,
        friction=friction,
        forward=forward,
        stood=np.concatenate([[0], standing.cumsum()]),
    )


def direction_of(samples: Samples, smoothing: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Return s (n,) over each sample, and whether the axis stands in it, bools (n,).

    A measured velocity without noise gives the sign to the sample; else it is that of the
    position, differentiated and smoothed over ``smoothing`` [s]. Standing is longer than half of
    that, with a margin to either side, because the friction is then anything up to F_c.
    """
    measured = samples.velocity if samples.is_exact else None
    if measured is not None:
        speed, least, margin, shortest = measured, 0.0, 0, 1
    else:
        length = max(int(round(smoothing / samples.time_step / 3.0)), 1)
        speed = derivative(smooth(samples.position, length), samples.time_step)
        # the derivative of a triple box of total length 3 L on white noise of the position
        noise = np.sqrt(samples.variance * 1.5 / (3 * length) ** 3) * 6.0 / samples.time_step
        least = max(4.0 * float(noise), REST * float(np.sqrt(np.mean(speed**2))))
        margin = shortest = (3 * length) // 2 + 1
    size, following = np.abs(speed), np.append(speed[1:], speed[-1])
    total = size + np.append(size[1:], size[-1])
    direction = (speed + following) / np.where(total > 0.0, total, 1.0)
    standing = _long_runs(size <= least, shortest)
    if measured is not None:  # the friction of a sample in which the axis stops is unknown too
        standing = np.append(standing[1:], standing[-1])
    return direction, _widened(standing, margin)


def _long_runs(mask: np.ndarray, least: int) -> np.ndarray:
    """Return ``mask`` without its runs shorter than ``least`` samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    kept = np.zeros(len(mask) + 1, int)
    for side, change in ((0, 1), (1, -1)):
        long = edges[1::2] - edges[::2] >= least
        np.add.at(kept, edges[side::2][long], change)
    return np.asarray(kept[:-1].cumsum() > 0)


def _widened(mask: np.ndarray, margin: int) -> np.ndarray:
    """Return ``mask`` with ``margin`` samples more at each side of its runs."""
    if margin == 0 or not mask.any():
        return mask
    count = np.concatenate([[0], mask.cumsum()])
    place = np.arange(len(mask))
    later, earlier = np.minimum(place + margin + 1, len(mask)), np.maximum(place - margin, 0)
    return np.asarray(count[later] > count[earlier])
