"""
Check whether the guards, areas and efforts of commands obey the control law.

This second formulation of the law shares only names with the kernel. The memory of the law is
derived from the samples and the recorded impulses, so one wrong sample causes one violation.
Positions and velocities include noise and encoder steps, as the controller saw them, so the
tolerance covers rounding only.

============  ====  ========================================================================
check         unit  equation
============  ====  ========================================================================
guards        1     core/check_guards.py
impulse area  N s   J = -2 alpha sign(v) or -c_event beta sign(e): (17), (19), (26)
effort        N     u = K (x_r - x) - D v - I + J / dt, within effort_limit: (4)
============  ====  ========================================================================

Only effort_limit, K_i and an estimated velocity depend on all previous samples. Impulses under
supervision are checked against the law itself, see core/check_supervised.py.
"""

import numpy as np

from impulse_control_ros.core.check_guards import (
    Commands,
    expected_guards,
    guard_checks,
    Remembered,
)
from impulse_control_ros.core.check_report import (
    bounded,
    Check,
    Gains,
    LoopSamples,
    per_sample,
    PerSample,
    ROUNDING,
)
from impulse_control_ros.core.check_supervised import check_supervised
from impulse_control_ros.core.control_law import POSITION_ZERO, STICKING, STILL

LONG_MEMORY = ('K_i', 'effort_limit')
MEMORY = (*LONG_MEMORY, 'position_hysteresis', 'velocity_hysteresis')


def check_commands(loop: LoopSamples, gains: Gains) -> list[Check]:
    """Check each command of a controller against the state that it answers."""
    answered = np.flatnonzero(np.isfinite(loop.effort) & np.isfinite(loop.position))
    if not len(answered):
        return [Check(name='effort', note='no state is answered')]
    every, index = per_sample(gains, len(loop.time)), np.arange(len(answered))

    def of(name: str) -> np.ndarray:
        return every(name)[answered]

    gone = np.diff(loop.time[answered], prepend=-np.inf) > 1.5 * loop.time_step
    answers = {name: getattr(loop, name)[answered] for name in Commands._fields[1:-1]}
    begins = gone | answers['fresh']
    commands = Commands(samples=answered, begins=begins, **answers)
    has_long = estimates(commands, of).any() or any(of(name).any() for name in LONG_MEMORY)
    has_memory = has_long or any(of(name).any() for name in MEMORY)
    has_memory |= (of('stiction_wait_samples') > 1).any()
    start = np.maximum.accumulate(np.where(commands.begins, index, 0))
    known = commands.fresh[start]
    recent = index - start > of('hold_off').max()
    if (of('supervision') & of('impulses')).any():
        towards = velocity_zero_area(commands, of)
        checks = check_supervised(commands, of, gains, towards, known)
        if has_long:
            return checks
        return [*checks[:-1], effort_check(commands, of, plain(commands, of), known | ~known)]
    memory = remembered(commands, of) if has_long else plain(commands, of)
    expected = expected_guards(commands, of, memory)
    return [
        *guard_checks(commands, expected, known | (recent & (not has_memory))),
        area_check(commands, of, memory, known | (not has_long)),
        effort_check(commands, of, memory, known | (not has_long)),
    ]


def plain(commands: Commands, of: PerSample) -> Remembered:
    """Return the memory of a law without effort_limit, K_i and an estimated velocity."""
    none = np.zeros(len(commands.samples))
    return Remembered(commands.velocity, none, np.where(of('impulses'), commands.area, 0.0), none)


def estimates(commands: Commands, of: PerSample) -> np.ndarray:
    """Return where the law uses an estimated velocity."""
    return (of('velocity_source') == 'estimated') | np.isnan(commands.velocity)


def remembered(commands: Commands, of: PerSample) -> Remembered:
    """
    Return the memory of a law with effort_limit, K_i or an estimated velocity, by recursion.

    v = p (v + J / m) + (1 - p) dx / dt; I grows by K_i e dt, unless effort_limit clips the
    feedback and e would drive it further. Pending area is dropped where it would drive the axis
    away from x_r.
    """
    dt, limit = of('time_step'), of('effort_limit')
    columns = (
        *(commands.position, commands.velocity, commands.area),
        *(commands.position - of('x_r'), commands.begins, estimates(commands, of)),
        *(np.exp(-2 * np.pi * of('velocity_bandwidth') * dt), of('K'), of('D')),
        *(of('K_i') * dt, np.where(limit > 0, limit, np.inf), of('impulses'), of('m'), dt),
    )
    rows = np.zeros((len(commands.samples), 4))
    v = integral = waits = left = x_before = 0.0
    for k, row in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
        x, measured, area, e, begins, guessed, p, K, D, growth, most, acts, m, step = row
        if begins:
            v = integral = waits = left = 0.0
        if guessed:
            v = 0.0 if begins else p * (v + left / m) + (1 - p) * (x - x_before) / step
            v = v if abs(v) > STILL else 0.0
        else:
            v = measured
        x_before = x
        wanted = -K * e - D * v
        grown = (integral if growth else 0.0) + growth * e
        winds = abs(wanted - grown) > most and (wanted - grown) * e < 0
        integral = (integral if growth else 0.0) if winds else grown
        feedback = min(max(wanted - integral, -most), most)
        owed = area + waits
        owed = area if min(owed, e, v) > 0 or max(owed, e, v) < 0 else owed
        owed = owed if acts else 0.0
        waits = owed - (min(max(feedback + owed / step, -most), most) - feedback) * step
        waits = waits if abs(feedback + owed / step) > most else 0.0
        left = owed - waits
        rows[k] = v, integral, owed, waits
    return Remembered(*rows.T)


def velocity_zero_area(commands: Commands, of: PerSample) -> np.ndarray:
    """Return the area [N s] of an impulse at a velocity zero or, where it is one, at a stick."""
    error = commands.position - of('x_r')
    beta = np.abs(error) * of('d_bar') / (2 * of('c'))
    c_event = np.where(commands.guard == STICKING, 1.0, 2.0)
    return -c_event * beta * np.sign(error)


def area_check(commands: Commands, of: PerSample, memory: Remembered, known: np.ndarray) -> Check:
    """Check the area of each impulse for its guard."""
    alpha = of('alpha_ratio') * of('m') * np.abs(memory.velocity)
    expected = np.where(
        commands.guard == POSITION_ZERO,
        -2 * alpha * np.sign(memory.velocity),
        velocity_zero_area(commands, of),
    )
    area = np.where(known & (commands.guard != 0), commands.area, np.nan)
    tolerance = ROUNDING * np.abs(expected)
    bounds = expected, expected
    return bounded('impulse area', 'N s', area, bounds, tolerance, commands.samples)


def effort_check(
    commands: Commands, of: PerSample, memory: Remembered, known: np.ndarray
) -> Check:
    """Check each effort: the feedback (4) plus the applied part of the impulse area."""
    limit = np.where(of('effort_limit') > 0, of('effort_limit'), np.inf)
    terms = (
        -of('K') * (commands.position - of('x_r')),
        -of('D') * memory.velocity,
        -memory.integral,
        memory.owed / of('time_step'),
    )
    feedback = np.clip(sum(terms[:3]), -limit, limit)
    expected = np.clip(feedback + terms[3], -limit, limit)
    tolerance = ROUNDING * np.sum(np.abs(terms), axis=0)
    effort = np.where(known, commands.effort, np.nan)
    return bounded('effort', 'N', effort, (expected, expected), tolerance, commands.samples)
