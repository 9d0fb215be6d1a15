"""Identify an axis from records of its motion: m, d, F_c, offset and d_bar, with their errors."""

from collections.abc import Sequence
from typing import Any

from impulse_control_ros.core.identification import Identification


def identify(
    records: Any | Sequence[Any],
    *,
    effort_scale: float = 1.0,
    effort_held: str = 'after',
    window: float | None = None,
) -> Identification:
    """
    Identify the axis of one record, or of several records of the same axis.

    A record is a `Record`, a `Run`, a `Recording`, or a frame or mapping with the columns (or
    index) time [s], position [m], effort [N] and, where it is measured, velocity [m/s].
    ``effort_scale`` multiplies the effort. ``effort_held`` says whether an effort acts over the
    sample ``after`` its time or ``before`` it. ``window`` [s] is T; by default the data choose it.

    Raises `ParameterError` for an argument or a record that cannot be used: too short, times that
    do not increase, values that are not finite.
    """
    raise NotImplementedError
