"""What the controller of a recording was set to: the one place that x_r(t) comes from."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from impulse_control_ros.files.run_parameters import Change

NO_GAINS = {'x_r': 0.0, 'K': 0.0, 'D': 0.0, 'effort_limit': 0.0}


class Setting(NamedTuple):
    """Parameters of the controller, those of `NO_GAINS`, that act from the state ``first`` on."""

    first: int
    values: Mapping[str, float]


def settings_of(stamps: np.ndarray, controllers: Sequence[Change]) -> list[Setting]:
    """
    Return what the ``controllers`` were set to at the states of ``stamps`` [ns].

    Empty where none of them tells a set-point; the first one has had it all along.
    """
    told = [change for change in controllers if 'x_r' in change.values]
    firsts = np.searchsorted(stamps, [change.stamp for change in told])
    firsts[:1] = 0
    return [
        Setting(first, {name: change.values.get(name, value) for name, value in NO_GAINS.items()})
        for first, change in zip(firsts.tolist(), told, strict=True)
    ]


def spans(settings: Sequence[Setting], count: int) -> Iterator[tuple[slice, Mapping[str, float]]]:
    """Yield each setting with its span of ``count`` states."""
    ends = [*(setting.first for setting in settings[1:]), count]
    for setting, end in zip(settings, ends, strict=False):  # no setting has no span
        yield slice(setting.first, end), setting.values
