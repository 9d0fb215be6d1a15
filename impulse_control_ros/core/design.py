"""
Gains from requirements, predictions, and findings: values that are valid but unwise.

============  ==========================  =======  ============================================
symbol        name                        unit     equation
============  ==========================  =======  ============================================
D             `critical_damping`          N s/m    (d_bar + D)^2 = 4 m K, before (20)
K             `least_stiffness`           N/m      the same with D = 0
alpha         `alpha_bounds`              N s      0.5 m abs(v) <= alpha < m abs(v) (19)
beta          `beta`                      N s      abs(e) d_bar / (2 c) (26)
F_c / K       `dead_zone`                 m        where PD alone sticks (section IV-C)
e_floor       `sampled_floor`             m        2 F_c dt / (kappa d_bar), kappa = 2 / c
e_quiet       `quiet_error`               m        e_floor, more where a release is not seen
t_1           `first_zero_time`           s        first e = 0, from (12)
v_max         `peak_speed`                m/s      largest abs(v) until then, from (12)
tau           `delay_margin`              s        least phase margin over crossover frequency
============  ==========================  =======  ============================================

The predictions are closed forms for a start at rest, constant damping and no Coulomb friction,
with the first impulse (25) if impulses act. core/hybrid.py solves all other cases exactly, and
core/promise.py states what holds for any course of the damping.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum
import math

import numpy as np

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.flow import first_zero, flow
from impulse_control_ros.core.plant import Plant


class Level(Enum):
    """Severity of a finding; the value describes it."""

    ERROR = 'the loop does not work so'
    WARNING = 'a condition of the paper does not hold'
    NOTE = 'a consequence to know of'


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One unwise value; ``text`` states the value, its unit and a better one."""

    level: Level
    text: str


def critical_damping(gains: ControlGains) -> float:
    """Return the D [N s/m] with (d_bar + D)^2 = 4 m K, section III-C before (20)."""
    return 2.0 * math.sqrt(gains.m * gains.K) - gains.d_bar


def least_stiffness(gains: ControlGains) -> float:
    """Return the K [N/m] that d_bar alone damps critically: d_bar^2 / (4 m), as before (20)."""
    return gains.d_bar**2 / (4.0 * gains.m)


def alpha_bounds(m: float, velocity: float) -> tuple[float, float]:
    """Return the lower and the excluded upper bound of alpha [N s] at e = 0 (19)."""
    return 0.5 * m * abs(velocity), m * abs(velocity)


def beta(gains: ControlGains, error: float) -> float:
    """Return beta [N s] at the error [m] of a velocity zero: abs(e) d_bar / (2 c) (26)."""
    return abs(error) * gains.d_bar / (2.0 * gains.c)


def dead_zone(gains: ControlGains, F_c: float) -> float:
    """Return the error F_c / K [m] up to which an axis at rest sticks under PD, section IV-C."""
    return F_c / gains.K


def sampled_floor(gains: ControlGains, F_c: float) -> float:
    """
    Return the error [m] below which a pulse of one sample does not overcome ``F_c`` [N].

    A pulse of c_event beta / dt with c_event = 2 gives 2 F_c dt / (kappa d_bar), kappa = 2 / c.
    The feedback K abs(e), which helps the pulse, is neglected.
    """
    return gains.c * F_c * gains.time_step / gains.d_bar


def quiet_error(gains: ControlGains, F_c: float, m: float, time_constant: float = 0.0) -> float:
    """
    Return the error [m] above which an impulse releases ``m`` [kg] fast enough for the guards.

    The guards do not notice a release slower than ``velocity_deadband``. The next impulse is then
    a sticking impulse of half the area, and below 2 e_floor impulses repeat without end. An
    actuator lag of ``time_constant`` [s] reduces the pulse to its largest mean over a sample.
    """
    if time_constant > 0.0:
        gone = -math.expm1(-gains.time_step / time_constant)
        held = gone * time_constant / gains.time_step
        return 2.0 * sampled_floor(gains, F_c / max(1.0 - held, gone * held))
    unseen = min(m * gains.velocity_deadband / (F_c * gains.time_step), 1.0)
    return sampled_floor(gains, F_c) * (1.0 + unseen)


def first_zero_time(gains: ControlGains, d: float) -> float:
    """
    Return the time [s] at which an axis with damping ``d`` [N s/m], from rest, first has e = 0.

    This is the first zero of (12) from e = 1, v = -d_bar / (c m) (17)(26), or v = 0 without
    impulses; inf if there is none. By linearity, the time is the same for any initial error.
    """
    rate, stiffness, v = _start(gains, d)
    return float(first_zero(1.0, v + rate, rate, stiffness))


def peak_speed(gains: ControlGains, d: float, error: float) -> float:
    """
    Return the largest abs(v) [m/s] from rest at ``error`` [m] up to the first e = 0.

    The peak is abs(v) after the first impulse or where the acceleration vanishes. The acceleration
    obeys (12) too: its first zero follows from its initial value a = -(w^2 e + 2 g v) and the jerk
    -(w^2 v + 2 g a).
    """
    rate, stiffness, v = _start(gains, d)
    a = -(stiffness + 2.0 * rate * v)
    fastest = first_zero(-a, stiffness * v + rate * a, rate, stiffness) if a < 0.0 else 0.0
    if fastest < first_zero(1.0, v + rate, rate, stiffness):
        v = flow(1.0, v, -1.0, rate, stiffness, 0.0, fastest)[1]
    return float(abs(v * error))


def _start(gains: ControlGains, d: float) -> tuple[float, float, float]:
    """Return g, w^2 and the velocity after the first impulse at e = 1 (17)."""
    v = -2.0 * beta(gains, 1.0) / gains.m if gains.impulses else 0.0
    return (d + gains.D) / (2.0 * gains.m), gains.K / gains.m, v


def delay_margin(gains: ControlGains) -> float:
    """
    Return the delay [s] up to which the feedback is stable on an axis without damping.

    The open loop (K + D s + K_i / s) / (m s^2) has the gain 1 at the roots of
    m^2 w^6 - D^2 w^4 - (K^2 - 2 D K_i) w^2 - K_i^2 = 0. There, the phase is above -pi by the
    argument of K + j (D w - K_i / w), and a delay takes w times the delay from it. The result is
    the least over the roots, and 0 if the loop is unstable without a delay. Damping of the axis
    makes the margin larger if K_i = 0; with an integral it may make it smaller.
    """
    unit = math.sqrt(gains.K) / math.sqrt(gains.m)  # rad/s
    D, K_i = gains.D * unit / gains.K, gains.K_i / unit / gains.K
    squares = np.roots([1.0, -D * D, 2.0 * D * K_i - 1.0, -K_i * K_i])
    real = squares.real[(abs(squares.imag) <= 1e-9 * abs(squares)) & (squares.real > 0.0)]
    margins = [math.atan2(D * w - K_i / w, 1.0) / (unit * w) for w in np.sqrt(real)]
    return max(min(margins), 0.0)


def check_gains(gains: ControlGains, plant: Plant | None = None) -> list[Finding]:
    """Return the findings on ``gains``, including those with the ``plant`` if it is known."""
    found = [*_on_damping(gains), *_on_integral(gains), *_on_guards(gains)]
    if plant is not None:
        found += [
            *_on_mass(gains, plant),
            *_on_bound(gains, plant),
            *_on_friction(gains, plant),
            *_on_signals(gains, plant),
        ]
        if gains.time_step != plant.time_step:
            found.append(
                Finding(
                    level=Level.ERROR,
                    text=(
                        f'time_step = {gains.time_step:g} s of the controller is not that '
                        f'of the axis, '
                        f'{plant.time_step:g} s'
                    ),
                )
            )
    return found


def check_delay(gains: ControlGains, delay: int) -> list[Finding]:
    """
    Return the findings on ``gains`` for a loop that delays impulses by ``delay`` samples.

    An impulse at a velocity zero gives the velocity abs(e) d_bar / (c m) (26), so the axis reaches
    the set-point within the time c m / d_bar. An axis that counts as standing may move by
    velocity_deadband times the delay.
    """
    if delay < 1 or not gains.impulses:
        return []
    time = delay * gains.time_step
    behind = f'the loop delays impulses by {delay} samples, {time:g} s'
    found = [
        Finding(level=Level.WARNING, text=f'{behind}: {one}') for one in _on_delay(gains, time)
    ]
    if gains.supervision and gains.response_timeout <= 2 * delay:
        text = (
            f'{behind}: response_timeout = {gains.response_timeout} samples may count late jumps '
            f'as absent; it must be above {2 * delay}'
        )
        found.append(Finding(level=Level.WARNING, text=text))
    share = gains.d_bar * time / (gains.c * gains.m)
    if share > 1.0:
        text = (
            f'{behind}: an impulse at a velocity zero drives the axis across the set-point in '
            f'this time; d_bar * delay / (c m) = {share:.3g} must be below 1'
        )
        found.append(Finding(level=Level.WARNING, text=text))
    drift = gains.velocity_deadband * time
    if gains.position_deadband < drift:
        text = (
            f'{behind}: position_deadband = {gains.position_deadband:g} m is below {drift:g} m, '
            'which an axis within velocity_deadband may cover in this time'
        )
        found.append(Finding(level=Level.NOTE, text=text))
    if gains.effort_limit == 0.0:
        text = f'{behind}: effort_limit = 0 lets a wrong impulse act in full; set a limit'
        found.append(Finding(level=Level.NOTE, text=text))
    return found or [Finding(level=Level.NOTE, text=behind)]


def _on_delay(gains: ControlGains, time: float) -> Iterator[str]:
    """Compare a delay [s] with `delay_margin`; holding an effort is half a sample of delay."""
    held = 0.5 * gains.time_step
    most = max(delay_margin(gains) - held, 0.0)
    if time < most:
        return
    if gains.K_i > 0.0 and time < delay_margin(replace(gains, K_i=0.0)) - held:
        remedy = 'lower K_i'
    elif gains.K * (time + held) < gains.D:  # the margin tends to D / K as both are lowered
        remedy = 'lower K and D'
    else:
        remedy = 'lower K or raise D'
    yield (
        f'with K = {gains.K:g} N/m, D = {gains.D:g} N s/m and K_i = {gains.K_i:g} N/(m s), the '
        f'feedback of an axis without damping is unstable from a delay of {most:.3g} s; {remedy}'
    )


def _on_damping(gains: ControlGains) -> Iterator[Finding]:
    """Compare D with `critical_damping`."""
    right = critical_damping(gains)
    if math.isclose(gains.D, right, rel_tol=1e-6, abs_tol=1e-9):
        return
    remedy = (
        f'D = {right:g} N s/m is'
        if right >= 0
        else (
            f'no D is, for d_bar alone overdamps; K = {least_stiffness(gains):g} N/m with D = 0 is'
        )
    )
    yield Finding(
        level=Level.WARNING,
        text=(
            f'D = {gains.D:g} N s/m is not critically damped with d_bar = {gains.d_bar:g} N s/m '
            f'((d_bar + D)^2 != 4 m K): {remedy}'
        ),
    )


def _on_integral(gains: ControlGains) -> Iterator[Finding]:
    """Check K_i by Routh: m s^3 + (D + d) s^2 + K s + K_i is stable if (D + d) K > m K_i."""
    most = gains.D * gains.K / gains.m
    if gains.K_i > 0.0 and gains.K_i >= most:
        yield Finding(
            level=Level.WARNING,
            text=(
                f'K_i = {gains.K_i:g} N/(m s) is unstable on an axis of little damping: below '
                f'D K / m = {most:g} N/(m s) it is stable with any'
            ),
        )


def _on_guards(gains: ControlGains) -> Iterator[Finding]:
    """Report settings that make the jumps differ from the paper's figures."""
    if gains.impulses and gains.c == 1.0:
        yield Finding(
            level=Level.NOTE,
            text=(
                'c = 1 makes the impulse of a velocity zero twice that of (25), for c_event is 2 '
                'there (15): c = 2 gives (25), and half of it while the axis sticks'
            ),
        )
    if gains.impulses and gains.hold_off > 0:
        yield Finding(
            level=Level.NOTE,
            text=(
                f'hold_off = {gains.hold_off} samples allows one impulse for each position zero: '
                f'the '
                'axis bounces off e = 0 when it is long enough; hold_off = 0 brings it to rest '
                'there'
            ),
        )


def _on_mass(gains: ControlGains, plant: Plant) -> Iterator[Finding]:
    """Check the controller's m by (19): the ratio in effect is alpha_ratio m / (axis mass)."""
    masses = {plant.m: 'axis'}
    masses.setdefault(plant.m + plant.payload.mass, 'axis with its payload')
    for mass, of in masses.items():
        if math.isclose(gains.m, mass, rel_tol=1e-6):
            continue
        ratio = gains.alpha_ratio * gains.m / mass
        level, so = Level.NOTE, 'alpha stays within (19), but D is chosen for another mass'
        if gains.impulses and ratio >= 1.0:
            level, so = Level.ERROR, 'an impulse at e = 0 does not slow the axis down (19)'
        elif gains.impulses and ratio < 0.5:
            level, so = Level.WARNING, 'an impulse at e = 0 does not stop the axis (19)'
        elif not gains.impulses:
            so = 'D is chosen for another mass'
        yield Finding(
            level=level,
            text=(
                f'm = {gains.m:g} kg is not that of the {of}, {mass:g} kg: {so}; (19) holds for m '
                f'from {0.5 * mass / gains.alpha_ratio:g} to below {mass / gains.alpha_ratio:g} kg'
            ),
        )


def _on_bound(gains: ControlGains, plant: Plant) -> Iterator[Finding]:
    """Check that d_bar bounds the damping (1)."""
    damping = plant.damping
    greatest = damping.value if damping.kind == 'constant' else damping.upper
    if greatest > gains.d_bar:
        yield Finding(
            level=Level.WARNING,
            text=(
                f'd_bar = {gains.d_bar:g} N s/m is no bound of the damping (1), the axis may be '
                f'overdamped and not reach e = 0: d_bar = {greatest:g} N s/m is'
            ),
        )


def _on_friction(gains: ControlGains, plant: Plant) -> Iterator[Finding]:
    """Check the effect of friction at rest on the end of the motion, section IV-C."""
    name, friction = max(('F_c', plant.F_c), ('F_s', plant.stribeck.F_s), key=lambda one: one[1])
    if friction == 0.0:
        return
    if 0.0 < gains.effort_limit <= friction:
        yield Finding(
            level=Level.ERROR,
            text=(
                f'effort_limit = {gains.effort_limit:g} N does not exceed {name} = {friction:g} '
                f'N: '
                'nothing moves a standing axis'
            ),
        )
    if not gains.impulses:
        if gains.K_i == 0.0:
            yield Finding(
                level=Level.NOTE,
                text=(
                    f'impulses = false leaves the axis sticking anywhere within {name} / K = '
                    f'{dead_zone(gains, friction):g} m of x_r'
                ),
            )
        return
    if gains.supervision:
        return  # it ends impulses that do not release the axis, whatever the dead band
    quiet = quiet_error(
        gains, friction, max(plant.m, plant.m + plant.payload.mass), plant.actuator.time_constant
    )
    if _least_error(gains, plant.sensor.resolution) < quiet:
        yield Finding(
            level=Level.NOTE,
            text=(
                f'position_deadband = {gains.position_deadband:g} m is below {quiet:g} m, up to '
                f'which '
                f'an impulse may not release the axis from {name} = {friction:g} N: there it '
                f'stays, '
                f'with impulses on and on; a position_deadband above {quiet:g} m ends them'
            ),
        )


def _least_error(gains: ControlGains, resolution: float) -> float:
    """Return the smallest measurable error [m] beyond position_deadband at this encoder step."""
    if resolution == 0.0:
        return gains.position_deadband
    offset = math.remainder(gains.x_r, resolution)
    return min(
        side * offset
        + resolution * (math.floor((gains.position_deadband - side * offset) / resolution) + 1)
        for side in (-1.0, 1.0)
    )


def _on_signals(gains: ControlGains, plant: Plant) -> Iterator[Finding]:
    """Check the gains against the sensor's signals at rest and the actuator's limits."""
    if not gains.impulses:
        return
    sensor, actuator, most = plant.sensor, plant.actuator, plant.actuator.limit
    if most and not 0.0 < gains.effort_limit <= most:
        yield Finding(
            level=Level.WARNING,
            text=(
                f'effort_limit = {gains.effort_limit:g} N is above the {most:g} N of the '
                f'actuator, '
                f'which cuts impulses off: effort_limit = {most:g} N keeps their area'
            ),
        )
    step, noise = sensor.resolution, sensor.position_noise
    shown = f'one step of the encoder of {step:g} m and the position_noise of {noise:g} m'
    jump = 4.0 * math.pi * gains.velocity_bandwidth * (step + 2.0 * noise)
    estimates = gains.velocity_source == 'estimated' or sensor.velocity == 'none'
    if sensor.velocity == 'difference' and jump and not estimates:
        yield Finding(
            level=Level.WARNING,
            text=(
                f'a velocity by difference shows {shown} as {(step + noise) / plant.time_step:g} '
                f'm/s, '
                'and may have impulses go on at rest: velocity_source = estimated, with '
                f'velocity_deadband above {jump:g} m/s, ends them'
            ),
        )
    late = actuator.delay + math.ceil(3.0 * actuator.time_constant / plant.time_step)
    for name, least, unit, why in (
        (
            'position_deadband',
            1.5 * step + 4.0 * noise,
            'm',
            f'1.5 steps of the encoder of {step:g} m and four times the position_noise of '
            f'{noise:g} m',
        ),
        (
            'velocity_deadband',
            0.0 if estimates else 4.0 * sensor.velocity_noise,
            'm/s',
            f'four times the velocity_noise of {sensor.velocity_noise:g} m/s',
        ),
        (
            'velocity_deadband',
            jump if estimates else 0.0,
            'm/s',
            f'twice what {shown} make of a velocity that is estimated with '
            f'velocity_bandwidth = {gains.velocity_bandwidth:g} Hz',
        ),
        (
            'stiction_wait_samples',
            late + 1 if late else 0,
            'samples',
            f'more than the actuator takes to act, its delay of {actuator.delay} samples and '
            f'three time constants of {actuator.time_constant:g} s',
        ),
    ):
        value = getattr(gains, name)
        if value < least * (1.0 - 1e-9):
            yield Finding(
                level=Level.WARNING,
                text=(
                    f'{name} = {value:g} {unit} lets an axis at rest have impulse after impulse: '
                    f'{least:g} {unit}, {why}, ends them'
                ),
            )
