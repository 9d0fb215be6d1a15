"""
The flow (9) of the closed loop in one direction of motion, and its zeros, in closed form (12).

    m e'' + (d + D) e' + K e = -F_c s

========  ==============  =======  ============================================================
symbol    name            unit     equation
========  ==============  =======  ============================================================
e, v      error, velo...  m, m/s   state of (8); e = x - x_r
s         direction       1        sign of the motion, +-1
g         rate            1/s      (d + D) / (2 m), minus the real double pole of (20)
w^2       stiffness       1/s^2    K / m, from A of (11)
f         friction        m/s^2    F_c / m (section IV-C)
r^2       curvature       1/s^2    w^2 - g^2: > 0 underdamped, 0 critically damped (20)
========  ==============  =======  ============================================================

With E = exp(-g t), C = cos(r t), h = E sin(r t) / r and H the integral of h from 0, (12) reads

    e(t) = e (E C + g h) + v h - f s H,    v(t) = v E C - (w^2 e + f s + g v) h;

if overdamped, cos and sin become cosh and sinh of abs(r). The code avoids cancellation and
overflow near critical damping, far from it, and for short times. The velocity zero has a closed
form; so has the position zero without friction, which starts Newton's method with friction.
"""

import math

from impulse_control_ros.core.jit import kernel


@kernel()
def series(rate, stiffness, t):
    """Return E C, h and H for a short time, where their closed forms cancel."""
    turn, pull = -2.0 * rate * t, -stiffness * t * t
    slope, first, second = 1.0, 1.0, 0.5
    before, term = 0.0, 1.0
    for n in range(1, 11):  # constant bounds: the compiler precomputes the reciprocals
        before, term = (
            term,
            (term * (turn * (1.0 / (n + 1))) + before * (pull * (1.0 / (n * (n + 1))))),
        )
        slope += (n + 1) * term
        first += term
        second += term * (1.0 / (n + 2))
    return slope + rate * t * first, t * first, t * t * second


@kernel()
def response(rate, stiffness, t):
    """Return E C, h and H of (12) at ``t`` [s], accurate on both sides of critical damping."""
    if max(rate * rate, stiffness) * t * t < 1e-2:
        return series(rate, stiffness, t)
    curvature = stiffness - rate * rate
    if curvature > 0.0:
        root, decay = math.sqrt(curvature), math.exp(-rate * t)
        half, h = math.sin(0.5 * root * t), decay * math.sin(root * t) / root
        fall = -math.expm1(-rate * t) + 2.0 * decay * half * half - rate * h
        return decay * math.cos(root * t), h, fall / stiffness
    root = math.sqrt(-curvature)
    fast = rate + root
    slow = stiffness / fast  # rate - root would cancel
    decay = math.exp(-slow * t)
    h = decay * (-math.expm1(-2.0 * root * t) / (2.0 * root) if root > 0.0 else t)
    return decay - root * h, h, -math.expm1(-slow * t) / stiffness - h / fast


@kernel()
def flow(error, velocity, direction, rate, stiffness, friction, t):
    """Return error [m] and velocity [m/s] after ``t`` [s] of motion in one direction (9)(12)."""
    cosine, h, integral = response(rate, stiffness, t)
    push = friction * direction
    return (
        error * (cosine + rate * h) + velocity * h - push * integral,
        velocity * cosine - (stiffness * error + push + rate * velocity) * h,
    )


@kernel()
def first_zero(value, slope, rate, stiffness):
    """
    Return the first t > 0 with ``value`` C + ``slope`` sin(r t) / r = 0, or inf.

    ``value`` must be >= 0; ``slope`` is the derivative plus ``rate`` times ``value``. A start at
    zero returns to zero after half a period.
    """
    curvature = stiffness - rate * rate
    if abs(curvature) * value * value < 1e-3 * slope * slope and slope < 0.0:
        # For short times, one series serves arctan and artanh at half the cost of the code below.
        q = curvature * (value / slope) ** 2
        return (
            -value / slope * (1.0 - q * (1 / 3 - q * (1 / 5 - q * (1 / 7 - q * (1 / 9 - q / 11)))))
        )
    if curvature > 0.0:
        root = math.sqrt(curvature)
        return math.atan2(value * root, -slope) / root
    root = math.sqrt(-curvature)
    margin = -slope - root * value
    if not margin > 0.0:
        return math.inf
    return math.log1p(2.0 * root * value / margin) / (2.0 * root) if root > 0.0 else value / margin


@kernel()
def crossing(error, velocity, direction, rate, stiffness, friction, upper):
    """Return the time [s] of e = 0, which the motion must cross within (0, ``upper``]."""
    lower = 0.0
    t = min(first_zero(abs(error), -direction * (velocity + rate * error), rate, stiffness), upper)
    for _ in range(100):
        e, v = flow(error, velocity, direction, rate, stiffness, friction, t)
        if direction * e < 0.0:
            lower = t
        else:
            upper = t
        closer = t - e / v if v != 0.0 else upper
        if abs(closer - t) <= 2e-16 * t:
            break
        # Bisect if friction takes Newton's step out of the bracket.
        t = closer if lower < closer < upper else 0.5 * (lower + upper)
    return t
