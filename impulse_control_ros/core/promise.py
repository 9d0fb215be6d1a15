"""
The settling time that the law guarantees for any damping d(t) within bounds, and gains for it.

============  ==========================  =======  ============================================
symbol        name                        unit     equation
============  ==========================  =======  ============================================
d_lo, d_hi    damping_range               N s/m    d_lo <= d(t) <= d_hi < d_bar, any course
r             -                           1/s      -v / e, the speed in errors per second
t_1           `first_zero_time`           s        first e = 0 with constant damping
k_1           `first_zero_sample`         1        first sample with e <= 0
============  ==========================  =======  ============================================

From rest, with the first impulse (25) and without Coulomb friction, r(0+) = d_bar / (2 m) for
c = 2 and

    r' = r^2 - ((d(t) + D) / m) r + K / m

until r is infinite, which is e = 0. At r = 0, r' = K / m > 0, so r stays positive; and for r > 0
the right side falls with d. By comparison, r lies between the courses for d_hi and d_lo, and so
the first position zero between t_1(d_lo) and t_1(d_hi), for every measurable d(t). Read strictly,
the axis is at rest in the origin there.

The sampled loop has the same order. Within a sample the effort -(K - D r_k) e_k is constant, and v
and e are linear in their values at its start:

    r_{k+1} = (r_k (E - D g / m) + K g / m) / (1 - r_k (g - D G / m) - K G / m)

with E = exp(-d dt / m) and its first and second integrals g and G. While E > D g / m, r_{k+1}
rises with r_k and falls with d, also if d varies within the sample. So the first sample with
e <= 0 lies between k_1(d_lo) and k_1(d_hi). docs/concepts/settling-time.md has the whole argument.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
import math

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.design import first_zero_time, peak_speed
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.plant import shapes

MOST_SAMPLES = 10_000_000
MOST_D_BAR = math.log(100.0)  # of d_bar / d_hi
MOST_K = math.log(1e4)  # of K / least stiffness


@dataclass(frozen=True, kw_only=True)
class Promise:
    """
    What holds for every d(t) within ``damping_range`` [N s/m], from rest at ``error`` [m].

    ``first_zero`` [s] is the window of the first position zero of the ideal loop, and
    ``first_zero_sampled`` [s] that of the first sample at or beyond it. ``peak_speed`` [m/s] and
    ``peak_effort`` [N] are the largest up to the impulse that stops the axis there, of the ideal
    loop. ``predicted`` says what makes it a prediction; it is empty for a guarantee.
    """

    damping_range: tuple[float, float]
    error: float
    first_zero: tuple[float, float]
    first_zero_sampled: tuple[float, float]
    peak_speed: float
    peak_effort: float
    predicted: tuple[str, ...]

    @property
    def is_guaranteed(self) -> bool:
        """Whether the windows hold for every d(t)."""
        return not self.predicted


def promise_of(
    gains: ControlGains, damping_range: tuple[float, float], error: float, F_c: float = 0.0
) -> Promise:
    """
    Return the promise of ``gains`` for an axis of their mass, with Coulomb friction ``F_c`` [N].

    A window that does not end is inf, as with d_hi >= d_bar. Raises `ParameterError` unless
    0 < d_lo <= d_hi and the error is not 0.
    """
    low, high = damping_range
    if not 0.0 < low <= high < math.inf:
        raise refusal('damping_range', damping_range, '0 < d_lo <= d_hi [N s/m]')
    if not 0.0 < abs(error) < math.inf:
        raise refusal('error', error, 'not 0 and finite [m]')
    effort = peak_effort(gains, low, error)
    return Promise(
        damping_range=damping_range,
        error=error,
        first_zero=(first_zero_time(gains, low), first_zero_time(gains, high)),
        first_zero_sampled=(
            first_zero_sample(gains, low) * gains.time_step,
            first_zero_sample(gains, high) * gains.time_step,
        ),
        peak_speed=peak_speed(gains, low, error),
        peak_effort=effort,
        predicted=tuple(_predicted(gains, high, error, effort, F_c)),
    )


def _predicted(
    gains: ControlGains, high: float, error: float, effort: float, F_c: float
) -> Iterator[str]:
    """Yield what the argument does not cover."""
    if F_c > 0.0:
        yield (
            f'the prediction ignores the Coulomb friction of {F_c:g} N, which delays the first '
            f'zero, or stops the axis up to {F_c / gains.K:.3g} m short of the set-point'
        )
    if 0.0 < gains.effort_limit < effort:
        yield (
            f'effort_limit = {gains.effort_limit:g} N is below the peak effort of {effort:g} N: '
            'impulses are spread, and the first zero comes later'
        )
    if high >= gains.d_bar and gains.impulses:
        yield f'd_bar = {gains.d_bar:g} N s/m does not exceed the damping, up to {high:g} N s/m'
    if not _keeps_order(gains, high):
        yield (
            f'time_step = {gains.time_step:g} s is too long for D = {gains.D:g} N s/m: the '
            'sampled loop may turn before the zero'
        )
    if gains.K_i > 0.0:
        yield f'the prediction ignores K_i = {gains.K_i:g} N/(m s)'
    if abs(error) <= gains.position_deadband:
        yield f'the error is within position_deadband = {gains.position_deadband:g} m'


def _keeps_order(gains: ControlGains, d: float) -> bool:
    """Return whether E > D g / m."""
    z = d * gains.time_step / gains.m
    return math.exp(-z) > gains.D * gains.time_step * shapes(z)[0] / gains.m


def first_zero_sample(gains: ControlGains, d: float) -> float:
    """
    Return the first sample k_1 with e <= 0 of the sampled loop with damping ``d``, or inf.

    The loop starts at rest, without friction and effort_limit; impulses act as in `simulate`.
    """
    if not math.isfinite(first_zero_time(gains, d)):
        return math.inf
    dt, m = gains.time_step, gains.m
    z = d * dt / m
    phi1, phi2 = shapes(z)
    decay, g, g2 = math.exp(-z), dt * phi1, dt * dt * phi2 / m
    e, v = 1.0, 0.0
    effort = -gains.K - (gains.d_bar / (gains.c * dt) if gains.impulses else 0.0)
    for k in range(1, MOST_SAMPLES):
        e, v = e + v * g + effort * g2, v * decay + effort * g / m
        if e <= 0.0:
            return k
        effort = -gains.K * e - gains.D * v
    return math.inf


def peak_effort(gains: ControlGains, d: float, error: float) -> float:
    """
    Return the largest abs(u) [N] of the ideal loop in pulses of one sample, with damping ``d``.

    These are the first impulse with the feedback, and the impulse at e = 0 from at most the peak
    speed. Both fall with d, so d_lo gives a bound for any d(t).
    """
    if not gains.impulses:
        return gains.K * abs(error)
    first = abs(error) * (gains.d_bar / (gains.c * gains.time_step) + gains.K)
    area = 2.0 * gains.alpha_ratio * gains.m * peak_speed(gains, d, error)
    return max(first, area / gains.time_step)


def gains_for(
    settling_time: float,
    damping_range: tuple[float, float],
    error: float,
    known: ControlGains,
) -> ControlGains:
    """
    Return ``known`` with the K, D and d_bar that promise the first zero within ``settling_time``.

    Of all pairs of K and d_bar with D critical (before (20)) whose sampled window ends by then, it
    is the one with the least peak effort from ``error`` [m]. ``known`` has m, c, alpha_ratio and
    time_step. Raises `ParameterError` if the time step is too long for that.
    """
    low, high = damping_range
    promise_of(known, damping_range, error)  # checks the arguments
    if not 0.0 < settling_time < math.inf:
        raise refusal('settling_time', settling_time, '> 0 and finite [s]')
    target = settling_time
    while target > 0.0:
        best = _least_effort(known, target, damping_range, error)
        if best is None or not _keeps_order(best, high):
            break
        late = first_zero_sample(best, high) * best.time_step - settling_time
        if late <= 1e-9:
            return best
        target -= max(late, 0.5 * known.time_step)
    raise refusal(
        'settling_time',
        settling_time,
        f'longer: no gains promise it with time_step = {known.time_step:g} s [s]',
    )


def _least_effort(
    known: ControlGains, time: float, damping_range: tuple[float, float], error: float
) -> ControlGains | None:
    """
    Return the gains with the least peak effort that reach e = 0 in ``time`` [s] at d_hi.

    A grid over d_bar / d_hi and K / `least_stiffness`, both by their logarithm, is narrowed around
    its best point. More K is not always faster, for D grows with it.
    """
    low, high = damping_range

    def rated(point: tuple[float, float]) -> tuple[float, ControlGains | None]:
        d_bar = high * math.exp(point[0])
        K = d_bar**2 / (4.0 * known.m) * math.exp(point[1])
        gains = replace(known, K=K, D=max(2.0 * math.sqrt(known.m * K) - d_bar, 0.0), d_bar=d_bar)
        if first_zero_time(gains, high) > time:
            return math.inf, None
        return peak_effort(gains, low, error), gains

    center, half, count = (0.5 * MOST_D_BAR, 0.5 * MOST_K), (0.5 * MOST_D_BAR, 0.5 * MOST_K), 30
    best: tuple[float, ControlGains | None] = (math.inf, None)
    while half[0] > 1e-7:
        steps = [2.0 * k / count - 1.0 for k in range(count + 1)]
        for a, b in product(steps, steps):
            point = center[0] + a * half[0], max(center[1] + b * half[1], 0.0)
            if point[0] > 0.0 and (found := rated(point))[0] < best[0]:
                best, at = found, point
        if best[1] is None:
            return None
        center, half, count = at, (4.0 * half[0] / count, 4.0 * half[1] / count), 8
    return best[1]
