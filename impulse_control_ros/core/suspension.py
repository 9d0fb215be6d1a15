"""
The suspension of impulses that do not work.

Impulses are suspended when

* two impulses in a row are absent, reversed or out of band,
* abs(e) exceeds 1.1 times its last turning point while impulses act (growing), or
* eight impulses in a row hardly move a resting axis towards the set-point (stalled).

The suspension lasts 1 s, then 2, 4, ... 64 s. Afterwards impulses have a share of their area,
core/supervision.py TRIAL, until one is confirmed. They have the whole area if friction may have
held the axis.
"""

from impulse_control_ros.core.impulse_verdicts import ABSENT, CONFIRMED, GROWING, STALLED
from impulse_control_ros.core.jit import compiled, record

SUSPENSION = record(
    [
        (name, 'f8')
        for name in (
            'strikes',
            'left',  # [samples]
            'back_off',  # [samples] of the last suspension
            'trial',  # whether impulses have a part of their area, until one is confirmed
            'acted',  # impulses since the last turning point
            'bound',  # [m] error at the last turning point, at least
            'floor',  # [m]
            'hops',  # impulses at rest in a row, since
            'hop_error',  # [m] this error, and
            'hop_age',  # [samples] so long ago
            'hop_last',  # [m] error at the last of them
        )
    ]
)


@compiled
def begin_response(suspension, error):
    """Begin the envelope of a response with its first ``error`` [m]."""
    suspension.bound, suspension.floor = abs(error), 0.1 * abs(error)
    begin_hops(suspension, error)
    suspension.acted = 0.0


@compiled
def begin_hops(suspension, error):
    """Count the impulses at rest from this ``error`` [m] on."""
    suspension.hops, suspension.hop_error, suspension.hop_age = 0.0, abs(error), 0.0


@compiled
def judge_error(memory, gains, size):
    """Judge abs(e) = ``size`` [m] by its envelope and by the impulses at rest."""
    suspension = memory.suspension
    suspension.hop_age += 1.0
    if suspension.left > 0.0:
        suspension.left -= 1.0
        if suspension.left == 0.0:
            suspension.bound, suspension.acted = max(size, suspension.floor), 0.0
            begin_hops(suspension, size)
    if size > 1.1 * suspension.bound:
        if suspension.acted > 0.0 and suspension.left == 0.0:
            memory.verdict, suspension.strikes = GROWING, 1.0
        suspension.bound = size
    if suspension.hops >= 8.0:
        passed = suspension.hop_age * gains.time_step
        if suspension.hop_last > suspension.hop_error * (1.0 - min(0.2 * passed, 0.1)):
            memory.verdict, suspension.strikes = STALLED, 1.0
        begin_hops(suspension, suspension.hop_last)


@compiled
def judge(memory, gains):
    """Count strikes, and suspend impulses if the verdict requires it."""
    suspension = memory.suspension
    if memory.verdict == CONFIRMED:
        suspension.strikes = suspension.back_off = suspension.trial = 0.0
        return
    suspension.strikes += 1.0
    if suspension.strikes >= 2.0 and suspension.left == 0.0:
        longer = max(2.0 * suspension.back_off, gains.sample_rate)
        suspension.back_off = min(longer, 64.0 * gains.sample_rate)
        suspension.left = suspension.back_off
        held = memory.verdict == STALLED or memory.verdict == ABSENT
        suspension.trial = 0.0 if held and memory.flight.at_rest != 0.0 else 1.0
        suspension.strikes = suspension.acted = 0.0


@compiled
def note_turn(suspension, error, fired):
    """Note a turning point of the motion at ``error`` [m]."""
    suspension.bound = max(abs(error), suspension.floor)
    suspension.acted = 1.0 if fired else 0.0
