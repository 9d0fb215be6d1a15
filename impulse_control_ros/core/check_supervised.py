"""
Check the impulses of a supervised controller against the law itself.

The time and the area of such an impulse depend on the mass, the delay and the noise that the
supervision has learnt from all previous samples. A second formulation would repeat the whole
supervision. Instead, the kernel answers the same measured samples, and its impulses are compared.
These checks do not find an error of the kernel. The bounds of the area are independent of it:

=======================  ====  =====================================================
guard                    unit  bounds of the area J
=======================  ====  =====================================================
position zero            N s   against the motion, up to 2 alpha r
velocity zero, sticking  N s   towards the set-point, c_event beta (TRIAL to sqrt(r))
=======================  ====  =====================================================

r is the upper one of mass_ratio_limits, or 1 without learn_mass; TRIAL is the share of the area
after a suspension. The motion is that of the measured velocity or of the difference of positions;
the law uses one of them. After the first impulse that differs, the memory of the law is not that
of the controller: later impulses are not checked until the controller starts again.
"""

from collections.abc import Mapping

import numpy as np

from impulse_control_ros.core.check_guards import before, Commands, guard_checks, note_of, since
from impulse_control_ros.core.check_report import bounded, Check, Gains, PerSample, ROUNDING
from impulse_control_ros.core.control_law import COMMAND, POSITION_ZERO
from impulse_control_ros.core.replay import answered, Piece
from impulse_control_ros.core.supervision import TRIAL

HOW = 'against the law itself'


def check_supervised(
    commands: Commands, of: PerSample, gains: Gains, towards: np.ndarray, known: np.ndarray
) -> list[Check]:
    """
    Check guards, areas and efforts, where the memory of the law is ``known``: shape (n,).

    ``towards`` [N s] is the area of the paper's law at a velocity zero or a stick, shape (n,).
    """
    law = answers_of_law(commands, gains, known)
    tolerance = ROUNDING * np.abs(law['area'])
    alike = (commands.guard == law['guard']) & (np.abs(commands.area - law['area']) <= tolerance)
    first = before(known & ~alike, commands.begins, False).astype(bool)
    known = known & (since(first, commands.begins) > len(first))
    note = note_of(known, HOW)
    both = known & (commands.guard != 0) & (commands.guard == law['guard'])
    area, effort = (
        np.where(both, commands.area, np.nan),
        np.where(alike & known, commands.effort, np.nan),
    )
    terms = np.abs(of('K') * (commands.position - of('x_r'))) + np.abs(of('D') * law['velocity'])
    terms += np.abs(law['area']) / of('time_step') + np.abs(law['effort'])
    at = commands.samples
    return [
        *guard_checks(commands, law['guard'], known, HOW),
        bounded('impulse area', 'N s', area, (law['area'],) * 2, tolerance, at, note),
        bounds_check(commands, of, towards),
        bounded('effort', 'N', effort, (law['effort'],) * 2, ROUNDING * terms, at, note),
    ]


def answers_of_law(commands: Commands, gains: Gains, known: np.ndarray) -> np.ndarray:
    """Return the answers of the kernel to the samples with a ``known`` past: dtype COMMAND."""
    law, at = np.zeros(len(known), COMMAND), np.flatnonzero(known)
    sets = gains if isinstance(gains, Mapping) else {0: gains}
    places: list[int] = np.searchsorted(commands.samples[at], [*sets]).tolist()
    changes = dict(zip(places, sets.values(), strict=True))
    begins = set(np.flatnonzero(commands.begins[at]).tolist())
    present, pieces = changes[0], []
    for place in sorted(changes.keys() | begins):
        present = changes.get(place, present)
        pieces.append(Piece(place, None, present, place in begins, None))
    law[at] = answered(commands.position[at], commands.velocity[at], pieces)
    return law


def bounds_check(commands: Commands, of: PerSample, towards: np.ndarray) -> Check:
    """Check that the direction and the size of each impulse are within the bounds of the law."""
    most = np.where(of('learn_mass'), of('mass_ratio_limits.upper'), 1.0)
    x, v = (
        commands.position,
        np.where(of('velocity_source') == 'estimated', np.nan, commands.velocity),
    )
    mean = (x - before(x, commands.begins, np.nan)) / of('time_step')
    speeds = v, np.where(commands.fresh, v, mean), np.zeros(len(v))
    gain = 2 * of('alpha_ratio') * of('m') * most
    against = -gain * np.maximum.reduce(speeds), -gain * np.minimum.reduce(speeds)
    ends = np.sort((TRIAL * towards, towards * np.sqrt(most)), axis=0)
    lower, upper = (
        np.where(commands.guard == POSITION_ZERO, *pair)
        for pair in zip(against, ends, strict=True)
    )
    area = np.where(commands.guard != 0, commands.area, np.nan)
    tolerance = ROUNDING * np.maximum(np.abs(lower), np.abs(upper))
    return bounded('impulse area bounds', 'N s', area, (lower, upper), tolerance, commands.samples)
