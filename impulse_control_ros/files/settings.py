"""The controller settings of a recording; x_r(t) comes only from here."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.errors import DivergedError
from impulse_control_ros.files.run_parameters import Change

NO_GAINS = {'x_r': 0.0, 'K': 0.0, 'D': 0.0, 'effort_limit': 0.0}


class Setting(NamedTuple):
    """Controller parameters, named as in `NO_GAINS`, that apply from the state ``first`` on."""

    first: int
    values: Mapping[str, float]


def settings_of(stamps: np.ndarray, controllers: Sequence[Change]) -> list[Setting]:
    """
    Return the settings of the ``controllers`` at the states of ``stamps`` [ns].

    Empty where none of them tells a set-point; the first one has had it all along, unless it has
    just been changed: nobody tells the one before, and 0 is taken. What is no number below
    `DivergedError.bound` is not told.
    """
    told = [change for change in controllers if is_number(change.values.get('x_r'))]
    firsts = np.searchsorted(stamps, [change.stamp for change in told])
    before = [Setting(0, NO_GAINS)] if told and 'x_r' in told[0].changed and firsts[0] else []
    firsts[: 1 - len(before)] = 0
    return before + [
        Setting(
            first,
            {
                name: change.values[name] if is_number(change.values.get(name)) else value
                for name, value in NO_GAINS.items()
            },
        )
        for first, change in zip(firsts.tolist(), told, strict=True)
    ]


def is_number(value: Any) -> bool:
    """Tell whether a recorded parameter is a number that can be calculated with."""
    return isinstance(value, int | float) and abs(value) < DivergedError.bound


def spans(settings: Sequence[Setting], count: int) -> Iterator[tuple[slice, Mapping[str, float]]]:
    """Yield each setting with its span of ``count`` states."""
    ends = [*(setting.first for setting in settings[1:]), count]
    for setting, end in zip(settings, ends, strict=False):  # without settings there are no spans
        yield slice(setting.first, end), setting.values
