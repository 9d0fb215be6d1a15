"""
Design from a requirement: settle in time, or be stiff, with the least effort.

The candidates are the gains that promise the settling time (core/promise.py), and others with a
bound d_bar above the identified one and critical damping, D = 2 sqrt(m K) - d_bar. Each is
simulated on the identified axis: at the least and the largest damping, with a damping that varies
between them, and at both ends of the interval of the mass.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math

import numpy as np

from impulse_control_ros.core.batch import simulate_batch
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.design import first_zero_time
from impulse_control_ros.core.identification import Identification
from impulse_control_ros.core.metrics import COUNTS
from impulse_control_ros.core.promise import gains_for
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.core.tick import ticks
from impulse_control_ros.errors import ParameterError, UsageError
from impulse_control_ros.files.experiment import ControllerParameters, PlantParameters
from impulse_control_ros.tools.identify.axis import rounded
from impulse_control_ros.tools.identify.gains import (
    ABOVE,
    damping_range,
    gains_of,
    Requirement,
    SMALL,
)

WIDEST = 20.0  # the largest d_bar of a candidate over the least one
LOSS = 1.2  # of settling time, that less effort may cost
SPARE = 1.2  # of force, beyond friction and offset
SLOW = 40.0  # simulated time constants of a loop of given stiffness
STIFFEST = 0.1  # rad a sample, of sqrt(K / m)
NEARLY = 0.95  # of the settling time, that the ideal loop is to take
CANDIDATES = 8
STRONGER = 1.6  # from one stiffness to the next
PATIENCE = 2.0  # simulated settling times
LONGEST = 64.0  # times the required settling time, at which the nearest is looked for
SOFTEST = 1.2  # stiffness over that at which d_bar alone damps critically
SEEDS = (1, 2, 3)  # of a varying damping and of noise


@dataclass(frozen=True, kw_only=True)
class Design:
    """
    Gains, and the worst of the simulated responses.

    ``settling_time`` [s] is to within ``band`` [m] of the set-point, inf if one never settles;
    ``peak_effort`` [N] and ``impulses`` are the largest of a response.
    """

    gains: ControllerParameters
    band: float
    settling_time: float
    peak_effort: float
    impulses: int
    impulses_at_rest: float = math.nan


def designed(found: Identification, plant: PlantParameters, need: Requirement) -> Design:
    """
    Return the design of least effort that meets a requirement.

    Raises `UsageError` if none does, with the nearest that can be met.
    """
    require_force(plant, need)
    bounds = np.geomspace(1.02 * ABOVE, ABOVE * WIDEST, CANDIDATES) * found.d_bar
    if need.stiffness is not None:
        designs = [*stiff_designs(found, plant, need, need.stiffness, bounds)]
        fastest = min(design.settling_time for design in designs)
        if not math.isfinite(fastest):
            raise UsageError(
                f'--stiffness {need.stiffness:g}: the axis does not settle; another stiffness, or '
                '--settling-time, is needed'
            )
        good = [one for one in designs if one.settling_time <= LOSS * fastest]
        good.sort(key=lambda one: one.peak_effort)
        return first_at_rest(good, plant, need)
    assert need.settling_time is not None
    designs = timed_designs(found, plant, need, need.settling_time, bounds)
    good = [
        one
        for one in [*promised(found, plant, need, need.settling_time), *designs]
        if one.settling_time <= need.settling_time
    ]
    if good:
        good.sort(key=lambda one: (rounded(one.peak_effort, 3), one.gains.K))
        return first_at_rest(good, plant, need)
    longer = need.settling_time
    while not any(math.isfinite(one.settling_time) for one in designs):
        longer *= 2.0
        if longer > LONGEST * need.settling_time:
            raise UsageError(
                f'--settling-time {need.settling_time:g}: the axis does not settle within '
                f'{LONGEST:g} times as long either; a larger --effort-limit is needed'
            )
        designs = timed_designs(found, plant, need, longer, bounds)
    fastest = min(one.settling_time for one in designs)
    raise UsageError(
        f'--settling-time {need.settling_time:g}: cannot be met; the nearest that can is '
        f'--settling-time {rounded(1.01 * fastest, 3):g}'
    )


def timed_designs(
    found: Identification,
    plant: PlantParameters,
    need: Requirement,
    settling_time: float,
    bounds: np.ndarray,
) -> list[Design]:
    """Return designs with each of the ``bounds``: of one grid, whatever the settling time [s]."""
    return [
        design
        for d_bar in bounds
        for design in quick_enough(found, plant, need, rounded(d_bar), settling_time)
    ]


def first_at_rest(designs: list[Design], plant: PlantParameters, need: Requirement) -> Design:
    """Return the first design without impulses at rest, or else the first with the fewest."""
    best: Design | None = None
    for design in designs:
        duration = ticks(3.0 * design.settling_time, plant.time_step) * plant.time_step
        run = simulate(replace(plant, x_0=need.travel), design.gains, duration)
        late = run.events['tick'] * plant.time_step > 1.5 * design.settling_time
        design = replace(
            design, impulses_at_rest=np.count_nonzero(late) / (1.5 * design.settling_time)
        )
        if best is None or design.impulses_at_rest < best.impulses_at_rest:
            best = design
        if not late.any():
            break
    assert best is not None
    return best


def require_force(plant: PlantParameters, need: Requirement) -> None:
    """Raise `UsageError` for an effort limit that cannot move the axis."""
    least = max(plant.F_c, plant.stribeck.F_s) + abs(plant.disturbance.force)
    if 0.0 < need.effort_limit <= SPARE * least:
        raise UsageError(
            f'--effort-limit {need.effort_limit:g}: must be above {SPARE * least:.3g} N, '
            f'{SPARE:g} times the friction and the offset'
        )


def stiff_designs(
    found: Identification,
    plant: PlantParameters,
    need: Requirement,
    K: float,
    bounds: np.ndarray,
) -> Iterator[Design]:
    """Yield the designs of one stiffness [N/m]; raises `UsageError` where it is too soft."""
    softest = bounds[0] ** 2 / (4.0 * plant.m)
    if softest > K:
        raise UsageError(
            f'--stiffness {K:g}: d_bar alone would overdamp the axis; the nearest that can be met '
            f'is --stiffness {rounded(1.001 * softest):g}'
        )
    longest = SLOW * max(1.0 / math.sqrt(K / plant.m), 4.0 * plant.m / bounds[0])
    for d_bar in bounds:
        if d_bar <= 2.0 * math.sqrt(plant.m * K):
            gains = gains_of(found, plant, need, K, rounded(d_bar))
            yield tried(found, plant, need, gains, longest)


def promised(
    found: Identification, plant: PlantParameters, need: Requirement, settling_time: float
) -> Iterator[Design]:
    """Yield the design that promises the settling time with the least effort, if any."""
    low, high = damping_range(found)
    known = gains_of(found, plant, need, 1.0, high)
    try:
        ideal = gains_for(NEARLY * settling_time, (low, high), need.travel, known)
    except ParameterError:
        return
    gains = gains_of(found, plant, need, rounded(ideal.K), rounded(ideal.d_bar))
    yield tried(found, plant, need, gains, PATIENCE * settling_time)


def quick_enough(
    found: Identification,
    plant: PlantParameters,
    need: Requirement,
    d_bar: float,
    settling_time: float,
) -> Iterator[Design]:
    """Yield designs of rising stiffness, up to the first that settles in time, or the stiffest."""
    K = rounded(SOFTEST * d_bar**2 / (4.0 * plant.m))
    while math.sqrt(K / plant.m) * plant.time_step < STIFFEST:
        gains = gains_of(found, plant, need, K, d_bar)
        if first_zero_time(gains, found.d_bar) <= settling_time:  # else it cannot settle in time
            design = tried(found, plant, need, gains, PATIENCE * settling_time)
            yield design
            if design.settling_time <= settling_time:
                return
        K = rounded(STRONGER * K)


def tried(
    found: Identification,
    plant: PlantParameters,
    need: Requirement,
    gains: ControllerParameters,
    duration: float,
) -> Design:
    """Return the design with these gains, from its simulated responses."""
    sensor = plant.sensor
    band = max(
        gains.position_deadband + 0.5 * sensor.resolution,
        2.0 * sensor.resolution + 4.0 * sensor.position_noise,
        SMALL * need.travel,
    )
    low, high = damping_range(found, 1.0)
    lightest, heaviest = found.parameters['m'].interval
    rows = np.array(
        [
            (low, low, plant.m),
            (high, high, plant.m),
            *((low, high, plant.m) for _ in SEEDS),
            (high, high, lightest),
            (high, high, heaviest),
        ]
    ).T
    seeds = np.array([1, 1, *SEEDS, 1, 1])
    axis = replace(plant, x_0=need.travel, damping=Damping(kind='noise', lower=low, upper=high))
    names = 'damping.lower', 'damping.upper', 'plant_simulator.m'
    varied = dict(zip(names, rows, strict=True)) | {'damping.seed': seeds, 'sensor.seed': seeds}
    steps = max(ticks(duration, plant.time_step), 100)
    seen = simulate_batch(axis, gains, steps * plant.time_step, varied, (band,))
    settled = np.where(seen['diverged'], np.nan, seen['settling_time'][:, 0])
    return Design(
        gains=gains,
        band=band,
        settling_time=math.inf if np.isnan(settled).any() else float(settled.max()),
        peak_effort=float(seen['peak_effort'].max()),
        impulses=int(np.sum([seen[name] for name in COUNTS], axis=0).max()),
    )
