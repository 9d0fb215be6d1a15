"""
Check the varied parameters of a batch, and pack them for the kernels.

A varied parameter is given by its full name, such as ``F_c`` or ``damping.seed``. If plant and
controller share the name, the node precedes it: ``plant_simulator.m`` is the moving mass,
``controller.m`` the mass for which impulses are computed.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from impulse_control_ros.core.control_gains import (
    ControlGains,
    OFF as PLAIN_LAW,
    packed_law,
)
from impulse_control_ros.core.nonidealities import OFF as IDEAL_PLANT, packed_hardware
from impulse_control_ros.core.parameter import (
    build,
    converted,
    declared,
    meant,
    refusal,
    require_rules,
    Spec,
)
from impulse_control_ros.core.plant import packed_plant, Plant
from impulse_control_ros.errors import ParameterError

SIDES: dict[str, type[Plant] | type[ControlGains]] = {
    'plant_simulator': Plant,
    'controller': ControlGains,
}
ARRAY_KINDS = {float: 'fiu', int: 'iu', bool: 'b', str: 'U'}


class Rows(NamedTuple):
    """
    The packed parameters of n runs: ``start`` (n, 2) in m and m/s, all others (n,).

    Their dtypes are PLANT, LAW and HARDWARE; ``hardware`` is None if all plants are ideal and no
    law has options.
    """

    plant: np.ndarray
    start: np.ndarray
    law: np.ndarray
    hardware: np.ndarray | None

    def part(self, which: slice) -> 'Rows':
        """Return a slice of the rows."""
        hardware = None if self.hardware is None else self.hardware[which]
        return Rows(self.plant[which], self.start[which], self.law[which], hardware)


def row(
    plant: Plant, gains: ControlGains, varied: Mapping[str, Any], i: int
) -> tuple[Plant, ControlGains]:
    """Return the parameters of run ``i`` of a batch, as `simulate` takes them."""
    of_plant, of_law = (
        {name: value.item() for name, value in side.items()}
        for side in columns({name: np.asarray(values)[[i]] for name, values in varied.items()})
    )
    return build(type(plant), plant.flat() | of_plant), replace(gains, **of_law)


def packed_rows(
    plant: Plant,
    gains: ControlGains,
    of_plant: Mapping[str, np.ndarray],
    of_law: Mapping[str, np.ndarray],
    runs: int,
) -> Rows:
    """Return ``runs`` rows; raise `ParameterError` for the first that breaks a rule."""
    values, law = plant.flat() | dict(of_plant), gains.flat() | dict(of_law)
    require_rules(type(plant), values)
    start = np.zeros((runs, 2))
    start[:, 0], start[:, 1] = values['x_0'], values['v_0']
    ideal = all(
        np.all(np.asarray(given[name]) == off)
        for given, nothing in ((values, IDEAL_PLANT), (law, PLAIN_LAW))
        for name, off in nothing.items()
        if name != 'supervision'  # the lanes of a batch have it too
    )
    return Rows(
        packed_plant(values, runs),
        start,
        packed_law(law, runs),
        None if ideal else packed_hardware(values, runs),
    )


def columns(varied: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """
    Return the arrays of the plant's and of the controller's varied parameters, by full name.

    Raises `ParameterError` for a name, a shape or a value that is not allowed.
    """
    sides: dict[str, dict[str, np.ndarray]] = {side: {} for side in SIDES}
    runs = None
    for name, values in varied.items():
        side, inner, default, spec = found(name)
        array = np.asarray(values)
        if array.ndim != 1 or not array.size or runs not in (None, len(array)):
            raise ParameterError(
                f'invalid {name} of shape {array.shape}: must be '
                + (f'({runs},), as the others' if runs else '(runs,)')
            )
        runs = len(array)
        sides[side][inner] = checked(name, array, default, spec)
    if runs is None:
        raise ParameterError('no parameter is varied: at least one is needed')
    return sides['plant_simulator'], sides['controller']


def found(name: str) -> tuple[str, str, Any, Spec]:
    """Return (side, name there, default, spec) of a varied parameter, or raise."""
    known = {
        f'{side}.{inner}': (side, inner, default, spec)
        for side, kind in SIDES.items()
        for inner, default, spec in declared(kind)
        if not spec.read_only
    }
    same = [full for full in known if full == name or full.split('.', 1)[1] == name]
    if len(same) == 1:
        return known[same[0]]
    raise ParameterError(
        f'{name}: no such parameter can be varied'
        + (
            f'; is {" or ".join(same)} meant?'
            if same
            else meant(name, [*known, *(full.split('.', 1)[1] for full in known)])
        )
    )


def checked(name: str, array: np.ndarray, default: Any, spec: Spec) -> np.ndarray:
    """Return ``array`` with the type of ``default``; refuse its first wrong value by its row."""
    wrong = 0
    if array.dtype.kind in ARRAY_KINDS[type(default)]:
        array = array.astype(float) if type(default) is float else array
        admitted = spec.contains(array)
        if admitted.all():
            return array
        wrong = int(np.argmin(admitted))
    value = array[wrong].item() if array.dtype.kind != 'O' else array[wrong]
    converted(f'{name}[{wrong}]', value, default, spec)  # raises the error of a single value
    raise refusal(f'{name}[{wrong}]', value, spec.allowed(type(default)))
