"""
Check whether a simulated or recorded trajectory solves (3) under the control law.

Each part of the hybrid system is checked sample by sample, from the samples alone:

====================  =============================  ===========================================
part                  check                          file
====================  =============================  ===========================================
flow map (3), (9)     position step, momentum        core/check_motion.py
damping (1)           damping                        core/check_motion.py
actuator              applied effort                 core/check.py
jump set              missed and unexplained guards  core/check_law.py
jump map (17), law    impulse area, effort           core/check_law.py
====================  =============================  ===========================================

The checks formulate (3), (4) and (17) a second time, in numpy, and share no code with the kernels,
with one exception: impulses under supervision are checked against the kernel itself and by bounds,
see core/check_supervised.py.
"""

from dataclasses import replace

import numpy as np

from impulse_control_ros.core.check_law import check_commands
from impulse_control_ros.core.check_motion import check_motion, Errors
from impulse_control_ros.core.check_report import (
    bounded,
    Check,
    finite,
    LoopSamples,
    per_sample,
    Plants,
    Report,
    ROUNDING,
)
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import Run


def check_run(run: Run, plant: Plant, gains: ControlGains) -> Report:
    """Check a run of `simulate`: the true motion and the answers to the measured states."""
    count = len(run.time)
    signals = [
        finite(name, getattr(run, name)) for name in ('position', 'velocity', 'effort', 'applied')
    ]
    if any(check.violations for check in signals):
        return Report(checks=signals, time=run.time)
    guard, area, first = np.zeros(count, int), np.zeros(count), np.zeros(count, bool)
    guard[run.events['tick']], area[run.events['tick']] = run.events['guard'], run.events['area']
    first[0] = True
    measured = LoopSamples(
        time=run.time,
        time_step=plant.time_step,
        position=run.measured_position,
        velocity=run.measured_velocity,
        effort=run.effort,
        applied=np.append(run.applied, np.nan),
        damping=np.append(run.damping, np.nan),
        guard=guard,
        area=area,
        starts=first,
        fresh=first,
    )
    true = replace(measured, position=run.position, velocity=run.velocity)
    checks = [
        *check_motion(true, plant, Errors()),
        check_applied(true, plant),
        *check_commands(measured, gains),
    ]
    return Report(checks=checks, time=run.time)


def check_applied(loop: LoopSamples, plant: Plants) -> Check:
    """
    Check that the applied effort is the command after delay, limit and lag.

    With a lag, the command c determines the mean effort u of a sample and the actuator's output a:
    u = c + (a - c) share, a+ = c + (a - c) pole. Valid for plants that wait for each command.
    """
    count = len(loop.time)
    of, index = per_sample(plant, count), np.arange(count)
    breaks = loop.breaks | (index == 0)
    start = np.maximum.accumulate(np.where(breaks, index, 0))
    sent = index - of('actuator.delay')
    rest = np.where(loop.starts[start], 0.0, np.nan)  # before the first known sample
    limit = np.where(of('actuator.limit') > 0, of('actuator.limit'), np.inf)
    command = np.where(sent >= start, loop.effort[np.maximum(sent, 0)], rest)
    command = np.clip(command, -limit, limit)
    lag = of('actuator.time_constant') / loop.time_step
    with np.errstate(divide='ignore'):
        pole = np.exp(-1 / lag)
    share = lag * (1 - pole)
    ratio = np.divide(pole, share, out=np.zeros(count), where=share > 0)
    output = command + (loop.applied - command) * ratio
    size = np.abs(command) + (np.abs(loop.applied) + np.abs(command)) * ratio
    output, size = (
        np.where(breaks, rest, np.append(np.nan, values[:-1])) for values in (output, size)
    )
    expected = command + np.where(lag > 0, (output - command) * share, 0.0)
    scale = np.abs(command) + np.where(lag > 0, size * share, 0.0)
    applied = np.where(np.append(breaks[1:], False), np.nan, loop.applied)
    return bounded('applied effort', 'N', applied, (expected, expected), ROUNDING * scale)
