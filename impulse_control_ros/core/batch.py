"""
Batch simulation: many runs at once, bit-for-bit identical to `simulate`.

==========  ==========  ====  =============================================================
symbol      name        unit  meaning
==========  ==========  ====  =============================================================
i           row         1     a run: the base parameters with the i-th value of each varied
n           runs        1     number of runs
j           lane        1     place of a run among the LANES that step together
k           tick        1     sample
==========  ==========  ====  =============================================================

The result of run i depends only on its row, not on the number of threads, the order of the rows or
the other runs. Only figures of merit are kept, so memory grows with the number of runs, not with
the number of steps. To get the trajectory of a run, call ``simulate(*row(...), duration)``.

Ideal runs step side by side in lanes (core/batch_lanes.py). Runs with hardware, or with options of
the law other than its supervision, are computed one after another, a tenth as fast.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
import math
from typing import Any

import numba
import numpy as np

from impulse_control_ros.core.batch_lanes import (
    add_lanes,
    answer_lanes,
    LANES,
    loaded,
    places,
    set_damping,
    step_lanes,
    SUMS,
)
from impulse_control_ros.core.closed_loop import close_loop, empty_trace
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import (
    FRESH,
    gains_of,
    options_of,
)
from impulse_control_ros.core.damping import (
    NOISE,
    SINUSOIDAL,
)
from impulse_control_ros.core.jit import compiled, sign
from impulse_control_ros.core.metrics import (
    added,
    conclude,
    COUNTS,
    figures_dtype,
    NOTHING,
    outside_since,
    Sums,
)
from impulse_control_ros.core.nonidealities import begin, HARDWARE_STATE
from impulse_control_ros.core.parameter import refusal
from impulse_control_ros.core.plant import DIVERGED, Plant
from impulse_control_ros.core.plant_step import PlantState
from impulse_control_ros.core.simulate import steps_of
from impulse_control_ros.core.supervised_lanes import answer_supervised
from impulse_control_ros.core.supervision import SUPERVISION
from impulse_control_ros.core.varied import columns, packed_rows, Rows

TASK = 256  # runs per task of a thread: milliseconds, so that Ctrl-C takes effect
SAMPLES = 256  # of a run with hardware, between updates of its figures
MEASURES = [name for name in figures_dtype(1).names or () if name not in (*COUNTS, 'diverged')]


def damping_seeds(seed: int, runs: int) -> np.ndarray:
    """
    Return seeds for ``damping.seed``, shape (runs,), derived from one ``seed``.

    numpy's SeedSequence generates them; a longer batch begins with the same seeds as a shorter
    one. The sign bit is 0 because a ROS integer parameter is signed.
    """
    return np.random.SeedSequence(seed).generate_state(runs, np.uint64) >> np.uint64(1)


def simulate_batch(
    plant: Plant,
    gains: ControlGains,
    duration: float,
    varied: Mapping[str, Any],
    tolerances: Sequence[float] = (1e-2, 1e-3),
) -> np.ndarray:
    """
    Run the closed loop for ``duration`` seconds with every row of the ``varied`` parameters.

    ``varied`` maps full names to arrays of shape (runs,), in the unit of the parameter; ``plant``
    and ``gains`` supply all other values. Returns the figures of merit, shape (runs,), dtype
    `figures_dtype`, with the settling times to ``tolerances`` [m]. Uses as many threads as numba
    (``numba.set_num_threads``). Before the first run, raises `ParameterError` as `simulate` does
    and for invalid names or values in ``varied``.
    """
    steps = steps_of(plant, gains, duration)
    require_tolerances(tolerances)
    sides = columns(varied)
    runs = len(next(iter((sides[0] | sides[1]).values())))
    wanted = np.asarray(tolerances, float)
    rows = packed_rows(plant, gains, *sides, runs)
    figures = np.zeros(runs, figures_dtype(len(wanted)))

    def task(first: int) -> None:
        part = slice(first, first + TASK)
        figures[part] = figures_of(rows.part(part), steps, wanted)

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        list(pool.map(task, range(0, runs, TASK)))
    return figures


def require_tolerances(tolerances: Sequence[float]) -> None:
    """Raise `ParameterError` unless there are tolerances [m], all positive and finite."""
    if not len(tolerances) or any(not 0.0 < item < math.inf for item in tolerances):
        raise refusal('tolerances', list(tolerances), 'a list of numbers > 0 [m]')


def figures_of(rows: Rows, steps: int, tolerances: np.ndarray) -> np.ndarray:
    """Run the packed rows and return their figures of merit."""
    runs = len(rows.plant)
    x_r = rows.law['x_r']
    if rows.hardware is None:
        blocks, laws, memories = loaded(rows), None, None
        if rows.law['supervision'].any():
            laws = rows.law.view(float).reshape(runs, -1)[places(runs)]
            memories = np.zeros(laws.shape[:2], SUPERVISION)
        outside = np.full((len(blocks), len(tolerances), LANES), -1.0)
        run_blocks(blocks, laws, memories, steps, tolerances, outside)
        sums = blocks['sums'].transpose(1, 0, 2).reshape(SUMS, -1)[:, :runs]
        outside = outside.transpose(0, 2, 1).reshape(-1, len(tolerances))[:runs]
        last, bounded = (blocks[name].ravel()[:runs] for name in ('position', 'bounded'))
    else:
        sums, last, bounded = np.zeros((SUMS, runs)), np.zeros(runs), np.zeros(runs)
        outside = np.full((runs, len(tolerances)), -1.0)
        law = rows.law.view(float).reshape(runs, -1)
        scratch = empty_trace(min(SAMPLES, steps + 1)), np.zeros(1, HARDWARE_STATE)
        run_rows(
            rows.plant,
            rows.hardware,
            law,
            rows.start,
            *scratch,
            np.zeros(runs, SUPERVISION),
            steps,
            tolerances,
            outside,
            sums,
            last,
            bounded,
        )
    diverged = bounded == 0.0
    figures = conclude(
        dict(zip(Sums._fields, sums, strict=True)),
        outside,
        rows.start[:, 0] - x_r,
        np.where(diverged, np.nan, last - x_r),
        steps,
        rows.plant[0]['time_step'],
    )
    figures['diverged'] = diverged
    for name in MEASURES:
        figures[name][diverged] = np.nan
    return figures


@compiled
def run_blocks(blocks, laws, memories, steps, tolerances, outside):
    """
    Run every block for ``steps`` steps.

    ``laws`` are None, or those of the supervised lanes, shape (blocks, LANES, fields of LAW);
    ``memories`` has shape (blocks, LANES), dtype SUPERVISION. Fills ``outside``, shape (blocks,
    tolerances, LANES), with the last tick outside each tolerance.
    """
    for i in range(len(blocks)):
        block = blocks[i]
        noisy, wavy = False, False
        for j in range(LANES):
            noisy |= block.kind[j] == NOISE
            wavy |= block.kind[j] == SINUSOIDAL
        for tick in range(steps + 1):
            if laws is None:
                answer_lanes(block)
            else:
                answer_supervised(block, laws[i], memories[i], tick)
            add_lanes(block, outside[i], tolerances, float(tick))
            if tick < steps:
                set_damping(block, tick, noisy, wavy)
                step_lanes(block)


@compiled
def run_rows(
    plants,
    hardware,
    laws,
    starts,
    trace,
    memory,
    law_memories,
    steps,
    tolerances,
    outside,
    sums,
    last,
    bounded,
):
    """
    Run n rows one after another.

    Fills ``sums`` (fields, n), the ``last`` position (n,), ``bounded`` (n,) and the last tick
    ``outside`` each tolerance (n, tolerances).
    """
    samples = len(trace.position)
    for i in range(len(plants)):
        one, x_r = slice(i, i + 1), gains_of(laws[i]).x_r
        state = PlantState(0, starts[i, 0], starts[i, 1], 0.0, 0.0, 0.0)
        begin(hardware[i], state, memory[0], 1.0 / plants[i].time_step)
        law_state, total, within = FRESH, NOTHING, True
        law_memory = law_memories[i : i + 1]
        for tick in range(steps + 1):
            k = tick % samples
            if k == 0:
                state, law_state = close_loop(
                    plants[one],
                    hardware[one],
                    state,
                    memory,
                    gains_of(laws[i]),
                    options_of(laws[i]),
                    law_state,
                    law_memory,
                    trace,
                    samples,
                )
            x, v = trace.position[k], trace.velocity[k]
            total = added(
                total,
                sign(starts[i, 0] - x_r),
                x - x_r,
                v,
                trace.effort[k],
                trace.area[k],
                trace.guard[k],
            )
            for j in range(len(tolerances)):
                outside[i, j] = outside_since(outside[i, j], float(tick), x - x_r, tolerances[j])
            within = within and abs(x) < DIVERGED and abs(v) < DIVERGED
            last[i] = x
        bounded[i] = 1.0 if within else 0.0
        for j in range(SUMS):
            sums[j, i] = total[j]
