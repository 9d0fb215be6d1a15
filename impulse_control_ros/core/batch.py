"""
Many runs at once: what `simulate` does, for every row of parameters, to the same bits.

==========  ==========  ====  =============================================================
symbol      name        unit  meaning
==========  ==========  ====  =============================================================
i           row         1     a run: the base parameters with the i-th value of each varied
n           runs        1     number of runs
==========  ==========  ====  =============================================================

The result of run i depends on its row alone: not on the number of threads, the order of the
rows or what else is in the batch. Only figures of merit are kept, so memory grows with the
runs and not with the steps; the trajectory of a chosen run is ``simulate(*row(...), duration)``.

A parameter is varied by its full name, ``F_c`` or ``damping.seed``. Where plant and controller
share a name it takes the node's: ``plant_simulator.m`` is the mass that moves, ``controller.m``
the one the impulses are computed for.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numba
import numpy as np

from impulse_control_ros.core.careful import fresh_watch, OFF as PLAIN_LAW, packed_care
from impulse_control_ros.core.damping import packed_damping
from impulse_control_ros.core.impulse import ANSWER, ControlGains, fresh_memory, packed_gains
from impulse_control_ros.core.lanes import LANES, loaded, run_blocks
from impulse_control_ros.core.metrics import conclude, COUNTS, figures_dtype, Sums
from impulse_control_ros.core.nonidealities import (
    at_rest,
    LEAST_STEP,
    OFF as IDEAL_AXIS,
    packed_hardware,
)
from impulse_control_ros.core.parameter import build, converted, declared, meant, refusal, Spec
from impulse_control_ros.core.plant import AXIS, Plant, STATE
from impulse_control_ros.core.rows import LEFT, run_rows
from impulse_control_ros.core.simulate import steps_of
from impulse_control_ros.errors import ParameterError

SIDES: dict[str, type[Plant] | type[ControlGains]] = {
    'plant_simulator': Plant,
    'controller': ControlGains,
}
ARRAY_KINDS = {float: 'fiu', int: 'iu', bool: 'b', str: 'U'}
MEASURES = [name for name in figures_dtype(1).names or () if name not in (*COUNTS, 'diverged')]
TASK = 256  # runs that a thread takes at a time: milliseconds, so that Ctrl-C is heard


def damping_seeds(seed: int, runs: int) -> np.ndarray:
    """
    Return seeds for ``damping.seed``, shape (runs,), all drawn from one ``seed``.

    numpy's SeedSequence spreads it; the first seeds of a longer batch are those of a shorter.
    The sign bit is left out, as a ROS parameter is a signed integer.
    """
    return np.random.SeedSequence(seed).generate_state(runs, np.uint64) >> np.uint64(1)


def simulate_batch(
    axis: Plant,
    controller: ControlGains,
    duration: float,
    varied: Mapping[str, Any],
    tolerances: Sequence[float] = (1e-2, 1e-3),
) -> np.ndarray:
    """
    Run the closed loop for ``duration`` seconds with every row of the ``varied`` parameters.

    ``varied`` maps full names to arrays of one shape (runs,), in the unit of the parameter; all
    else is as in ``axis`` and ``controller``. Returns the figures of merit, shape (runs,), dtype
    `figures_dtype`, with the settling times to ``tolerances`` [m]. Uses as many threads as
    numba does (``numba.set_num_threads``). Raises `ParameterError` as `simulate` does, and for
    names and values of ``varied`` that are not allowed, before anything runs.
    """
    steps = steps_of(axis, controller, duration)
    plant, law = columns(varied)
    runs = len(next(iter((plant | law).values())))
    wanted = np.asarray(tolerances, float)
    rows = packed_rows(axis, controller, plant, law, runs)
    figures = np.zeros(runs, figures_dtype(len(wanted)))

    def task(first: int) -> None:
        part = slice(first, first + TASK)
        figures[part] = figures_of([row[part] for row in rows], steps, wanted)

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        list(pool.map(task, range(0, runs, TASK)))
    return figures


def figures_of(rows: Sequence[np.ndarray], steps: int, tolerances: np.ndarray) -> np.ndarray:
    """Run the packed rows, see `packed_rows`, and return their figures of merit."""
    axis, _, _, gains, *real = rows
    now, outside = (ran_really if real else ran_ideally)(rows, steps, tolerances)
    sums = now['sums']
    diverged = now['bounded'] == 0.0
    last = np.where(diverged, np.nan, now['position'] - gains['x_r'])
    figures = conclude(
        {name: sums[name] for name in Sums._fields},
        outside,
        now['first_error'],
        last,
        steps,
        axis[0]['time_step'],
    )
    figures['diverged'] = diverged
    for name in MEASURES:
        figures[name][diverged] = np.nan
    return figures


def ran_ideally(
    rows: Sequence[np.ndarray],
    steps: int,
    tolerances: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what n runs leave, dtype LEFT, and the last ticks outside, (n, tolerances)."""
    runs = len(rows[0])
    blocks = loaded(*rows)
    outside = np.full((len(blocks), len(tolerances), LANES), -1.0)
    run_blocks(blocks, steps, tolerances, outside)
    left = np.zeros(runs, LEFT)
    for name in ('position', 'first_error', 'bounded'):
        left[name] = blocks['now'][name].ravel()[:runs]
    for name in Sums._fields:
        left['sums'][name] = blocks['sums'][name].ravel()[:runs]
    return left, outside.transpose(0, 2, 1).reshape(-1, len(tolerances))[:runs]


def ran_really(
    rows: Sequence[np.ndarray],
    steps: int,
    tolerances: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Do `ran_ideally` with the hardware and the care of each row."""
    axis, start, profile, gains, hardware, care = rows
    left, states = np.zeros(len(axis), LEFT), np.zeros(len(axis), STATE)
    states['position'], states['velocity'] = start.T
    outside = np.full((len(axis), len(tolerances)), -1.0)
    run_rows(
        axis,
        profile,
        hardware,
        states,
        gains,
        care,
        at_rest(),
        fresh_memory(),
        fresh_watch(),
        np.zeros(1, ANSWER),
        steps,
        tolerances,
        outside,
        left,
    )
    return left, outside


def row(
    axis: Plant,
    controller: ControlGains,
    varied: Mapping[str, Any],
    i: int,
) -> tuple[Plant, ControlGains]:
    """Return the parameters of run ``i`` of a batch, as `simulate` takes them."""
    plant, law = (
        {name: value.item() for name, value in side.items()}
        for side in columns({name: np.asarray(values)[[i]] for name, values in varied.items()})
    )
    return build(type(axis), axis.flat() | plant), replace(controller, **law)


def packed_rows(
    axis: Plant,
    controller: ControlGains,
    plant: dict[str, np.ndarray],
    law: dict[str, np.ndarray],
    runs: int,
) -> tuple[np.ndarray, ...]:
    """
    Return the kernels' view of ``runs`` rows: AXIS, start (runs, 2), DAMPING, GAINS.

    Where one is not ideal, HARDWARE and CARE come besides.
    """
    values = axis.flat() | plant
    if np.any(np.asarray(values['damping.lower']) > values['damping.upper']):
        bounds = np.broadcast_arrays(values['damping.lower'], values['damping.upper'])
        i = int(np.flatnonzero(np.ravel(bounds[0] > bounds[1]))[0])
        lower, upper = (float(np.ravel(bound)[i]) for bound in bounds)
        raise refusal(f'damping.lower[{i}]', lower, f'<= damping.upper = {upper:g} [N s/m]')
    axes, start = np.zeros(runs, AXIS), np.zeros((runs, 2))
    for name in AXIS.names or ():
        axes[name] = values[name]
    start[:, 0], start[:, 1] = values['x_0'], values['v_0']
    profile = {name.removeprefix('damping.'): value for name, value in values.items()}
    return (
        axes,
        start,
        packed_damping(profile, axis.time_step, runs),
        packed_gains(controller.flat() | law, runs),
        *real_rows(axis, controller.flat() | law, values, runs),
    )


def real_rows(
    axis: Plant,
    gains: Mapping[str, Any],
    values: Mapping[str, Any],
    runs: int,
) -> tuple[np.ndarray, ...]:
    """Return the kernels' view of what is not ideal: HARDWARE, CARE; () where all rows are."""
    refuse_misfits(axis, values, runs)
    if all(
        np.all(np.asarray(given[name]) == off)
        for given, nothing in ((values, IDEAL_AXIS), (gains, PLAIN_LAW))
        for name, off in nothing.items()
    ):
        return ()
    return packed_hardware(values, axis.time_step, runs), packed_care(gains, runs)


def refuse_misfits(axis: Plant, values: Mapping[str, Any], runs: int) -> None:
    """Refuse the first row whose values do not fit together, as `Plant` does."""
    m, F_c, F_s, start, end, step = (
        np.asarray(values[name])
        for name in (
            'm',
            'F_c',
            'stribeck.F_s',
            'disturbance.start',
            'disturbance.end',
            'sensor.resolution',
        )
    )
    wrong = (
        (m + values['payload.mass'] <= 0.0)
        | ((F_s > 0.0) & (F_s < F_c))
        | ((end > 0.0) & (end <= start))
        | ((step > 0.0) & (step < LEAST_STEP))
    )
    if wrong.any():
        i = int(np.argmax(np.broadcast_to(wrong, runs)))
        build(
            type(axis),
            {name: np.broadcast_to(value, runs)[i].item() for name, value in values.items()},
        )  # raises


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
    if array.dtype.kind not in ARRAY_KINDS[type(default)]:
        wrong = 0
    else:
        array = array.astype(float) if type(default) is float else array
        admitted = np.isin(array, spec.choices) if spec.choices else np.ones(len(array), bool)
        if array.dtype.kind == 'f':
            admitted &= np.isfinite(array)
        if spec.lower is not None:
            admitted &= array > spec.lower if spec.open_lower else array >= spec.lower
        if spec.upper is not None:
            admitted &= array < spec.upper if spec.open_upper else array <= spec.upper
        if admitted.all():
            return array
        wrong = int(np.argmin(admitted))
    value = array[wrong].item() if array.dtype.kind != 'O' else array[wrong]
    converted(f'{name}[{wrong}]', value, default, spec)  # raises, in the words of one value
    raise refusal(f'{name}[{wrong}]', value, spec.allowed(type(default)))
