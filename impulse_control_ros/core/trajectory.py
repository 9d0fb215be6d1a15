"""
Base class of simulated runs, exact solutions and recordings: samples, table and plot.

pandas and matplotlib are imported when used.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, TYPE_CHECKING

import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.metric_catalogue import SAMPLE_COLUMNS
from impulse_control_ros.errors import MissingPackageError

UNITS = {
    **{name: SAMPLE_COLUMNS[name].unit for name in ('time', 'position', 'velocity', 'effort')},
    'set_point': SAMPLE_COLUMNS['position'].unit,
    'guard': SAMPLE_COLUMNS['guard'].unit,
}


class Trajectory:
    """Base of `Run`, `Solution` and `Recording`: n samples, each signal of shape (n,)."""

    if TYPE_CHECKING:  # fields of one subclass, properties of another

        @property
        def time(self) -> np.ndarray:
            """Time [s] since the first sample."""

        @property
        def position(self) -> np.ndarray:
            """Position x [m]."""

        @property
        def velocity(self) -> np.ndarray:
            """Velocity x' [m/s]."""

        @property
        def effort(self) -> np.ndarray:
            """Effort u [N], commanded at each sample."""

        @property
        def set_point(self) -> np.ndarray:
            """Set-point x_r [m]."""

        def impulse_samples(self) -> tuple[np.ndarray, np.ndarray]:
            """Return sample and guard (index in `GUARDS`) of each impulse, both of shape (k,)."""

    def to_pandas(self) -> Any:
        """
        Return a `pandas.DataFrame` with a row for each sample, indexed by time [s].

        Its columns are position, velocity, effort, set_point and guard ('' without an impulse);
        ``attrs['units']`` has the unit of each. Raises `MissingPackageError` without pandas.
        """
        pandas = _optional('pandas')
        guards = np.zeros(len(self.time), np.int8)
        index, guard = self.impulse_samples()
        guards[index] = guard
        columns = {name: getattr(self, name) for name in UNITS if name not in ('time', 'guard')}
        columns['guard'] = pandas.Categorical.from_codes(guards, GUARDS)
        frame = pandas.DataFrame(columns, index=pandas.Index(self.time, name='time'))
        frame.attrs['units'] = dict(UNITS)
        return frame

    def plot(self, axes: Mapping[str, Any] | None = None, label: str = '') -> dict[str, Any]:
        """
        Plot position with set-point, velocity and effort over time, and the phase portrait.

        Markers show the impulses by their guard. Returns the matplotlib axes by name: position,
        velocity, effort, phase. ``axes`` by some of these names are drawn into; ``label`` names
        the curve in the legend. Raises `MissingPackageError` without matplotlib.
        """
        return _optional('impulse_control_ros.plotting').plot(self, axes, label)


def _optional(module: str) -> Any:
    """Import a module that needs a package of the extra ``analysis``."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        package = (error.name or module).partition('.')[0]
        raise MissingPackageError(
            f"{package} is missing: pip install 'impulse_control_ros[analysis]'"
        ) from None
