"""The requirement of a user, and gains, dead bands and velocity source for it."""

from dataclasses import dataclass, replace
import math

from impulse_control_ros.core.design import quiet_error
from impulse_control_ros.core.identification import Identification
from impulse_control_ros.errors import UsageError
from impulse_control_ros.files.experiment import ControllerParameters, PlantParameters
from impulse_control_ros.tools.identify.axis import rounded

FASTER = 10.0 / (2.0 * math.pi)  # corner of the velocity estimate [Hz] over sqrt(K / m) [rad/s]
INTEGRAL = 0.1  # of the largest stable K_i
ROOM = 1.05  # dead bands over what check_gains asks for
ABOVE = 1.15  # d_bar of the controller over that of the records, which bounds these alone
LEAST = 1e-3  # of d_bar: the damping is above 0 (1)
RATIO = 0.6  # of alpha, unless the interval of the mass asks for another one
SMALL = 1e-3  # of the travel, within which an axis with an ideal sensor has settled


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """
    The requirement for the loop over a step of ``travel`` [m].

    Either ``settling_time`` [s] or ``stiffness`` K [N/m] is given. ``effort_limit`` [N] is that
    of the drive, 0 for none.
    """

    travel: float
    settling_time: float | None = None
    stiffness: float | None = None
    effort_limit: float = 0.0


def damping_range(found: Identification, wider: float = ABOVE) -> tuple[float, float]:
    """Return the range [N s/m] of the recorded damping, widened at each end."""
    high = wider * found.d_bar
    return min(max(found.d_range[0] / wider, LEAST * high), high), high


def gains_of(
    found: Identification, plant: PlantParameters, need: Requirement, K: float, d_bar: float
) -> ControllerParameters:
    """Return the gains of a candidate, with dead bands for the sensor and the friction."""
    sensor = plant.sensor
    estimates = sensor.velocity == 'none' or (
        sensor.velocity == 'difference' and sensor.resolution + sensor.position_noise > 0.0
    )
    D = max(2.0 * math.sqrt(plant.m * K) - d_bar, 0.0)
    bandwidth = rounded(min(max(FASTER * math.sqrt(K / plant.m), 5.0), 0.1 / plant.time_step), 3)
    blur = sensor.resolution + 2.0 * sensor.position_noise
    noise = 4.0 * math.pi * bandwidth * blur if estimates else 5.0 * sensor.velocity_noise
    force = abs(plant.disturbance.force)
    gains = ControllerParameters(
        m=plant.m,
        K=K,
        D=D,
        d_bar=d_bar,
        alpha_ratio=ratio_for(found),
        K_i=rounded(INTEGRAL * (D + found.d_range[0]) * K / plant.m) if force > plant.F_c else 0.0,
        effort_limit=need.effort_limit,
        velocity_deadband=max(rounded(ROOM * noise), 1e-6),
        stiction_wait_samples=plant.actuator.delay + 1,
        velocity_source='estimated' if estimates else 'measured',
        velocity_bandwidth=bandwidth if estimates else 50.0,
        supervision=False,  # the promise is that of the law with the identified mass
        time_step=plant.time_step,
    )
    quiet = quiet_error(gains, plant.F_c, plant.m) if plant.F_c else 0.0
    sensed = 1.5 * sensor.resolution + 4.0 * sensor.position_noise
    least = max(ROOM * max(quiet, sensed), 0.5 * SMALL * need.travel)
    return replace(gains, position_deadband=rounded(least))


def ratio_for(found: Identification) -> float:
    """Return an alpha_ratio that stays within (19) for every mass of the interval."""
    low, high = (end / found.parameters['m'].value for end in found.parameters['m'].interval)
    if 0.5 * high <= RATIO < low:
        return RATIO
    if 0.5 * high >= low:
        raise UsageError(
            f'the interval of m is too wide for (19): its ends are {low:.3g} and {high:.3g} times '
            'its value, and must be less than a factor of 2 apart'
        )
    return rounded(0.5 * (0.5 * high + low), 3)
