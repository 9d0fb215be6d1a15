"""
Validation of the model on a part of a record that was not used for the fit.

The model is identified from the first two thirds of each record. The last third of the longest one
is then simulated with the recorded effort. The simulation restarts from the recorded state every
SEGMENT seconds, because without feedback the position drifts with the smallest error of a force.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impulse_control_ros.core.identification import Identification, Record
from impulse_control_ros.core.plant import axis_step
from impulse_control_ros.errors import ParameterError

SEEN = 2 / 3
SEGMENT = 0.5  # s
MOST = 200_000  # samples
SLOPE = 0.01  # s to each side, from which the velocity at the start of a segment is taken


@dataclass(frozen=True, kw_only=True)
class Validation:
    """
    Measured and simulated ``position`` [m] at ``time`` [s] of the record ``name``: shape (n,).

    ``seen`` is true if the fit used these samples too, because the others did not suffice.
    """

    name: str
    time: np.ndarray
    position: np.ndarray
    simulated: np.ndarray
    seen: bool

    @property
    def error(self) -> np.ndarray:
        """Measured minus simulated position [m]."""
        return self.position - self.simulated


def validated(
    records: Sequence[Record],
    found: Identification,
    fit: Callable[[Sequence[Record]], Identification],
) -> Validation:
    """Return the validation of records; ``found`` is the ``fit`` of them all."""
    record = max(records, key=lambda one: one.time[-1] - one.time[0])
    begin = record.time[0] + SEEN * (record.time[-1] - record.time[0])
    try:
        early = fit([first_part(one) for one in records])
    except ParameterError:  # too short
        early = found
    seen = not early.is_identified
    last = first_samples(part(record, begin, np.inf))
    return Validation(
        name=record.name,
        time=last.time,
        position=last.position,
        simulated=simulated(last, found if seen else early),
        seen=seen,
    )


def first_part(record: Record) -> Record:
    """Return the part of a record that is used for the fit."""
    start, end = record.time[0], record.time[-1]
    return part(record, start, start + SEEN * (end - start))


def part(record: Record, begin: float, end: float) -> Record:
    """Return the samples of a record from ``begin`` [s] to ``end`` [s], without this one."""
    inside = (record.time >= begin) & (record.time < end)
    velocity = None if record.velocity is None else record.velocity[inside]
    return replace(
        record,
        time=record.time[inside],
        position=record.position[inside],
        effort=record.effort[inside],
        velocity=velocity,
    )


def first_samples(record: Record) -> Record:
    """Return at most the first MOST samples of a record."""
    return part(record, record.time[0], record.time[MOST]) if len(record.time) > MOST else record


def simulated(record: Record, found: Identification) -> np.ndarray:
    """Return the position [m] of the model at the n samples of a record; nan without a mass."""
    values = {
        name: one.value if one.is_identified else 0.0 for name, one in found.parameters.items()
    }
    force = held(record, found) - values['offset']
    steps = np.diff(record.time)
    positions = record.position.copy()
    if not values['m']:
        return np.full(len(positions), np.nan)
    begun, x, v = -np.inf, 0.0, 0.0
    for k, step in enumerate(steps):
        if record.time[k] - begun >= SEGMENT:
            begun, x, v = record.time[k], record.position[k], speed_at(record, k)
        x, v = axis_step(
            x, v, force[k], max(values['d'], 0.0), values['m'], max(values['F_c'], 0.0), step
        )
        positions[k + 1] = x
    return positions


def speed_at(record: Record, k: int) -> float:
    """Return the velocity [m/s] at a sample, by a parabola through the positions around it."""
    around = np.abs(record.time - record.time[k]) <= SLOPE
    if np.count_nonzero(around) < 5:
        around[max(k - 2, 0) : k + 3] = True
    return float(np.polyfit(record.time[around] - record.time[k], record.position[around], 2)[1])


def held(record: Record, found: Identification) -> np.ndarray:
    """Return the effort [N] that acts from each sample to the next."""
    effort, after = record.effort, np.append(record.effort[1:], record.effort[-1:])
    return {'before': after, 'sampled': 0.5 * (effort + after)}.get(found.effort_held, effort)
