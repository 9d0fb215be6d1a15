"""The identified axis as a simulated plant."""

import math

import numpy as np

from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.identification import Identification, Record
from impulse_control_ros.core.nonidealities import Actuator, Disturbance, MOST_DELAY, Sensor
from impulse_control_ros.core.tick import SECOND
from impulse_control_ros.files.experiment import PlantParameters

DIGITS = 4  # of an identified value
SAME = 1e-6  # relative error of what is the same
VARIES = 1.5  # errors of a block that the blocks of d(t) spread by if it varies
NOTABLY = 0.02  # of d, that they then spread by at least
LEAST = 1e-3  # of d_bar: the least damping of a simulated axis is above 0


def rounded(value: float, digits: int = DIGITS) -> float:
    """Return a value rounded to ``digits`` significant digits."""
    return float(f'{value:.{digits}g}')


def plant_of(found: Identification, records: list[Record], effort_limit: float) -> PlantParameters:
    """
    Return the axis that was ``found`` in ``records``, at rest at 0 m.

    ``effort_limit`` [N] is that of its drive, 0 for none. A friction force or an offset whose
    interval includes 0 is left out.
    """
    time_step = time_step_of(found)
    return PlantParameters(
        m=rounded(found.parameters['m'].value),
        F_c=max(certain(found, 'F_c'), 0.0),
        x_0=0.0,
        time_step=time_step,
        damping=damping_of(found),
        sensor=Sensor(
            resolution=rounded(found.encoder_step),
            position_noise=notable(found.position_noise, records, 'position'),
            velocity=velocity_of(records),
            velocity_noise=notable(found.velocity_noise, records, 'velocity'),
        ),
        actuator=Actuator(limit=effort_limit, delay=delay_of(found, time_step)),
        disturbance=Disturbance(force=0.0 - certain(found, 'offset')),
    )


def certain(found: Identification, name: str) -> float:
    """Return a parameter, or 0 where it is not identified or may be 0."""
    estimate = found.parameters[name]
    low, high = estimate.interval
    return rounded(estimate.value) if estimate.is_identified and low * high > 0.0 else 0.0


def time_step_of(found: Identification) -> float:
    """Return the time step [s] of the first record, in whole microseconds from 10 us on."""
    step = found.time_step[0]
    unit = 1000 if step >= 1e-5 else 1
    return round(step * SECOND / unit) * unit / SECOND


def delay_of(found: Identification, time_step: float) -> int:
    """Return the delay of the effort in samples, 0 if it is not known."""
    delay = found.effort_delay
    return min(round(delay / time_step), MOST_DELAY) if delay > 0.0 else 0


def damping_of(found: Identification) -> Damping:
    """Return the damping: constant, or between bounds if the blocks spread beyond their errors."""
    blocks, (low, _) = found.d_blocks, found.d_range
    high = rounded(found.d_bar)
    low = min(max(rounded(low), LEAST * high), high)
    error = float(np.sqrt(np.mean(blocks.standard_error**2)))
    if float(np.std(blocks.d)) > max(VARIES * error, NOTABLY * float(np.mean(blocks.d))):
        return Damping(kind='noise', lower=low, upper=high, value=low)
    d = found.parameters['d']
    value = d.value if d.is_identified else float(np.mean(blocks.d))
    return Damping(value=max(rounded(value), low))


def notable(noise: float, records: list[Record], signal: str) -> float:
    """Return the noise of a signal, or 0 where it is below the signal's precision, or nan."""
    values = [getattr(record, signal) for record in records]
    if not noise > 0.0 or any(value is None for value in values):
        return 0.0
    return rounded(noise) if noise > SAME * max(map(np.ptp, values)) else 0.0


def has_velocity(records: list[Record]) -> bool:
    """Return whether every record has a measured velocity."""
    return all(record.velocity is not None for record in records)


def velocity_of(records: list[Record]) -> str:
    """Return the source of the velocity, as `Sensor` names it."""
    if not has_velocity(records):
        return 'none'
    return 'difference' if all(map(is_difference, records)) else 'ideal'


def is_difference(record: Record) -> bool:
    """Return whether the velocity is the difference of the positions over a sample."""
    assert record.velocity is not None
    steps = np.diff(record.time)
    difference = np.diff(record.position) / np.where(steps > 0.0, steps, math.inf)
    error = float(np.sqrt(np.mean((record.velocity[1:] - difference) ** 2)))
    return error <= SAME * float(np.sqrt(np.mean(difference**2)))
