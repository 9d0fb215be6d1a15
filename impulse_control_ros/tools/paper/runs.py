"""
The runs behind the figures and claims: Table I, from the experiments that come with the package.

Each case is run as the sampled loop (`simulate`), which any ROS run repeats to the last bit, and
where the paper can be read in two ways it is solved exactly in both (`solve`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.hybrid import Reading, Solution, solve
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import Run, simulate
from impulse_control_ros.files.package_share import shipped_experiment
from impulse_control_ros.files.parameter_file import load_experiment

SECONDS = 2.0  # as long as the paper's figures need
FRICTION_SECONDS = 3.0  # until Fig. 5 shows the sampled floor
SEEDS = range(101, 141)  # of damping profiles that a claim on Fig. 4 is judged by, too
STEPS = (1e-3, 1e-4, 1e-5)  # time steps [s] that show the sampled floor of Fig. 5


@dataclass(frozen=True, kw_only=True)
class Case:
    """One experiment in three ways: sampled, read strictly, and with one jump a crossing."""

    axis: Plant
    gains: ControlGains
    run: Run
    strict: Solution
    one_jump: Solution


@dataclass(frozen=True, kw_only=True)
class Runs:
    """
    All runs; ``pd_...`` are without impulses.

    ``seeds`` are pairs of Fig. 4, without and with impulses, one for each seed; ``steps`` are
    runs of Fig. 5 by their time step [s].
    """

    pd_upper: Case
    pd_lower: Case
    impulses: Case
    pd_varying: Case
    varying: Case
    pd_coulomb: Case
    coulomb: Case
    seeds: tuple[tuple[Run, Run], ...]
    steps: Mapping[float, Run]


def case(axis: Plant, gains: ControlGains, seconds: float = SECONDS) -> Case:
    """Run and solve one case; the exact solution has the damping of the sampled one."""
    run = simulate(axis, gains, seconds)
    varies = axis.damping.kind != 'constant'
    breaks = run.time[1:-1] if varies else ()
    dampings = run.damping if varies else None
    strict, one_jump = (
        solve(axis, gains, seconds, reading=reading, breaks=breaks, dampings=dampings)
        for reading in (Reading.STRICT, Reading.ONE_JUMP)
    )
    return Case(axis=axis, gains=gains, run=run, strict=strict, one_jump=one_jump)


def paper_runs() -> Runs:
    """Make all runs."""
    cases = {}
    for name in ('pd_only_upper', 'pd_only_lower', 'underdamped', 'time_varying', 'coulomb'):
        made = load_experiment(shipped_experiment(name))
        seconds = FRICTION_SECONDS if name == 'coulomb' else SECONDS
        # the paper's law: supervision ends the hammering at the friction floor
        cases[name] = case(made.plant, replace(made.gains, supervision=False), seconds)
    varying, coulomb = cases['time_varying'], cases['coulomb']
    return Runs(
        pd_upper=cases['pd_only_upper'],
        pd_lower=cases['pd_only_lower'],
        impulses=cases['underdamped'],
        varying=varying,
        coulomb=coulomb,
        pd_varying=case(varying.axis, replace(varying.gains, impulses=False)),
        pd_coulomb=case(coulomb.axis, replace(coulomb.gains, impulses=False), FRICTION_SECONDS),
        seeds=tuple(_pair(varying, seed) for seed in SEEDS),
        steps={step: _with_step(coulomb, step) for step in STEPS},
    )


def _pair(varying: Case, seed: int) -> tuple[Run, Run]:
    axis = replace(varying.axis, damping=replace(varying.axis.damping, seed=seed))
    without, with_impulses = (
        simulate(axis, replace(varying.gains, impulses=impulses), SECONDS)
        for impulses in (False, True)
    )
    return without, with_impulses


def _with_step(coulomb: Case, step: float) -> Run:
    axis = replace(coulomb.axis, time_step=step)
    return simulate(axis, replace(coulomb.gains, time_step=step), 5.0)
