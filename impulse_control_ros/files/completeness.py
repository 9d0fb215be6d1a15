"""What is missing from a bag of any recorder, determined from its messages."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.impulse_verdicts import VERDICTS
from impulse_control_ros.core.protocol import FOREIGN
from impulse_control_ros.core.tick import SECOND, seconds
from impulse_control_ros.files.joint_state_arrays import Messages, Origin
from impulse_control_ros.files.run_choice import OneRun
from impulse_control_ros.files.run_parameters import acting, Change

MOVING = 0.1  # part of the peak speed below which an axis counts as standing
NO_EVENT = 'commands name a guard or a verdict whose event is missing'


def lacking(run: OneRun, changes: Sequence[Change]) -> list[str]:
    """Return sentences on what a run with these parameter ``changes`` lacks."""
    if not len(run.series.states.rows):
        return []
    return [
        *of_others(run),
        *of_states(run, changes),
        *of_commands(run, changes),
        *of_parameters(run, changes),
    ]


def of_others(run: OneRun) -> Iterator[str]:
    """Report the messages that were left out."""
    for name, count in run.others.items():
        yield f'{name} is left out ({count} messages)'


def of_states(run: OneRun, changes: Sequence[Change]) -> Iterator[str]:
    """Report a start in mid-run and missing states of our plants, one per time step."""
    states = run.series.states.rows
    if is_mid_run(states, run.source.run):
        yield f'the bag begins in mid-run, at {seconds(states["stamp"][0])} s; ' + (
            'the controller may already have been active'
            if run.source.run
            else 'the axis is already moving'
        )
    if not run.source.run:
        return
    step = next(filter(None, (change.values.get('time_step') for change in changes)), 0.0)
    if isinstance(step, float) and step * SECOND >= 1.0:
        steps = np.rint(np.diff(states['stamp']) / (step * SECOND))
        if missing := int(np.maximum(steps - 1, 0).sum()):
            yield f'{missing} states are missing'


def is_mid_run(states: np.ndarray, run: str) -> bool:
    """
    Tell whether a run began before its first state; the first state of our runs is a reset.

    A run of a foreign plant (``run`` '') is assumed to start at rest.
    """
    if run:
        return not states['is_reset'][0]
    speed = np.abs(states['velocity'])
    return bool(speed[0] > MOVING * np.nanmax(speed[np.isfinite(speed)], initial=0.0) > 0.0)


def of_commands(run: OneRun, changes: Sequence[Change]) -> Iterator[str]:
    """Report states (except the last) without a command, and commands without their event."""
    states, commands, events = run.series
    plant = next((change for change in changes if change.is_plant), None)
    if not len(commands.rows):
        yield 'there are no commands'
    elif run.source.run and plant and plant.values.get('lockstep'):
        answered = is_in(states.stamps[:-1], commands.stamps)
        if missing := int(np.count_nonzero(~answered)):
            yield f'{missing} states have no command'
    elif not run.source.run or states.rows['is_reset'][0]:
        began = [
            change for change in acting(changes, commands) if change.anew and not change.is_plant
        ]
        for change in began:
            if change.stamp not in commands.stamps:
                yield (
                    f'the first commands of {change.node} are missing; it started at '
                    f'{seconds(change.stamp)} s'
                )
    announced = commands.stamps[commands.per_message(announces) > 0]
    if missing := int(np.count_nonzero(~is_in(announced, events.stamps))):
        yield f'{missing} {NO_EVENT}'


def announces(origin: Origin) -> bool:
    """Tell whether commands of an origin announce an event."""
    return origin.guard in GUARDS[1:] or origin.verdict in VERDICTS[1:]


def of_parameters(run: OneRun, changes: Sequence[Change]) -> Iterator[str]:
    """Report the nodes whose parameters are missing, and a set-point before the first known."""
    if run.source.run and not any(change.is_plant for change in changes):
        yield 'the parameters of the plant are missing'
    told = next((change for change in changes if 'x_r' in change.values), None)
    if told and 'x_r' in told.changed and told.stamp > run.series.states.stamps[0]:
        yield f'the set-point before its change at {seconds(told.stamp)} s is missing'
    known = {change.node_id for change in changes if not change.is_plant}
    for name in authors(run.series.commands):
        if name == FOREIGN and run.source.run:
            yield 'the parameters of a foreign controller are missing'
        elif name == FOREIGN and not known:
            yield 'the parameters of the controller are missing'
        elif name != FOREIGN and name not in known:
            yield f'the parameters of {name} are missing'


def authors(commands: Messages) -> list[str]:
    """Return the authors of commands."""
    numbers = np.unique(commands.origin).tolist()
    return sorted({commands.origins[number].node_id for number in numbers})


def is_in(stamps: np.ndarray, among: np.ndarray) -> Any:
    """Return which ``stamps`` occur in ``among``; both are sorted."""
    if np.array_equal(among[: len(stamps)], stamps):
        return np.ones(len(stamps), bool)
    return np.append(among, 0)[np.searchsorted(among, stamps)] == stamps
