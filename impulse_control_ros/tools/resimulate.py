"""What a bag's own parameters make of it: its pieces, and the run or the commands anew."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from impulse_control_ros.core.control_gains import OFF
from impulse_control_ros.core.parameter import build, Parameters
from impulse_control_ros.core.replay import answered, Piece, run_again
from impulse_control_ros.core.tick import nanoseconds, seconds
from impulse_control_ros.errors import BagError, ParameterError
from impulse_control_ros.files.experiment import (
    ControllerParameters,
    is_foreign,
    PlantParameters,
    require_agreement,
)
from impulse_control_ros.files.joint_state_arrays import COMMAND, DAMPING, EVENT, SAMPLE
from impulse_control_ros.files.recording import Recording

WORDS: dict[type[Parameters], str] = {PlantParameters: 'plant', ControllerParameters: 'controller'}


@dataclass(frozen=True, kw_only=True)
class Resimulation:
    """
    A bag's messages beside those of the run anew.

    ``pairs`` of (recorded, replayed) rows by topic; ``changes`` counts what changed on the way.
    """

    pairs: Mapping[str, tuple[np.ndarray, np.ndarray]]
    changes: int


def is_free_running(recording: Recording) -> bool:
    """Tell whether the plant does not wait for commands, as one that is none of ours."""
    return not recording.plant or not recording.plant[0].values.get('lockstep')


def histories(
    recording: Recording, kind: type[Parameters], overrides: Mapping[str, Any]
) -> Iterator[tuple[int, bool, Any]]:
    """
    Yield (stamp, anew, parameters of ``kind``) for each time that they change.

    ``overrides`` hold from the start to the end; where they are all, no node needs to tell any.
    Raises `ParameterError` for a wrong one, and `BagError` where no node of the run has such
    parameters.
    """
    changes = recording.plant if kind is PlantParameters else recording.controllers
    if not changes and kind is ControllerParameters and overrides.keys() >= kind().flat().keys():
        yield 0, True, build(kind, overrides)
        return
    if not changes:
        raise BagError(
            f'no node of it has the parameters of a {WORDS[kind]}; '
            f'its nodes: {", ".join(recording.parameters) or "none"}'
            + '; replay --controller --params FILE takes them from a file'
            * (kind is ControllerParameters)
        )
    # an option that the node does not tell is newer than the node
    unknown = OFF if kind is ControllerParameters else {}
    for change in changes:
        ours = {name: value for name, value in change.values.items() if not is_foreign(name)}
        yield change.stamp, change.anew, build(kind, {**unknown, **ours, **overrides})


def states_of(recording: Recording) -> np.ndarray:
    """Return the states, of which there is one at least; raises `BagError`."""
    if not len(recording.states):
        raise BagError('there are no states in it')
    return recording.states


def pieces_of(
    recording: Recording, stamps: np.ndarray, is_reset: np.ndarray, overrides: Mapping[str, Any]
) -> list[Piece]:
    """Return the pieces of a run with samples at ``stamps``, of which some are a start."""
    axes, first = {}, None
    if recording.plant:
        axes = {at: axis for at, _, axis in located(stamps, recording, PlantParameters, {})}
        first = axis_at_start(recording)
    anew = {0, *np.flatnonzero(is_reset).tolist()}
    behind = np.searchsorted(stamps, recording.withdrawn, 'right')
    anew |= set(behind[behind < len(stamps)].tolist())
    # who tells its parameters late has had them from the start
    controllers = {0: next(histories(recording, ControllerParameters, overrides))[2]}
    for at, fresh, controller in located(stamps, recording, ControllerParameters, overrides):
        controllers[at] = controller
        anew |= {at} if fresh else set()
    require_agreement('the bag', first.flat() if first else {}, controllers[0].flat())
    axis, controller, pieces = first, controllers[0], []
    for at in sorted({*axes, *controllers, *anew}):
        before, axis = axis, axes.get(at, axis)
        controller = controllers.get(at, controller)
        pieces.append(Piece(at, axis, controller, at in anew, before if is_reset[at] else None))
    return pieces


def axis_at_start(recording: Recording) -> PlantParameters:
    """Return the plant as the first state has it: a change at its stamp acts behind it."""
    start = recording.states['stamp'][0]
    before = [
        axis
        for stamp, anew, axis in histories(recording, PlantParameters, {})
        if stamp < start or (anew and stamp == start)
    ]
    return before[-1] if before else next(histories(recording, PlantParameters, {}))[2]


def located(
    stamps: np.ndarray, recording: Recording, kind: type[Parameters], overrides: Mapping[str, Any]
) -> Iterator[tuple[int, bool, Any]]:
    """Yield `histories` with the sample that each acts at in place of its stamp."""
    for stamp, anew, values in histories(recording, kind, overrides):
        at = int(np.searchsorted(stamps, stamp))
        if at < len(stamps):
            yield at, anew, values


def open_loop(recording: Recording, overrides: Mapping[str, Any]) -> Resimulation:
    """
    Answer the recorded states.

    Raises `ParameterError` for a wrong override, `BagError` without parameters.
    """
    states, pieces, answers = answered_states(recording, overrides)
    return Resimulation(pairs=answers_beside(recording, states, answers), changes=len(pieces) - 1)


def missing_memory(recording: Recording) -> str:
    """Return that the controller began before the first answered state, or '' if it did not."""
    began = next((change.stamp for change in recording.controllers), 0)  # 0: before the bag
    stamps = recording.states['stamp']
    first = int(stamps[np.isin(stamps, recording.commands['stamp'])][0])
    if not 0 < began < first:
        return ''
    return (
        f'the recording begins {seconds(first - began)} s after the controller, '
        'whose memory at that time is unknown'
    )


def answered_states(
    recording: Recording,
    overrides: Mapping[str, Any],
) -> tuple[np.ndarray, list[Piece], np.ndarray]:
    """
    Return the states that the controller has answered, the pieces, and the answers anew.

    Where the run was free, it has seen the states that it answered, and maybe no other.
    """
    states = states_of(recording)
    # an answered state has a velocity, or an empty field that reads as nan
    seen = np.isfinite(states['position']) & (
        np.isfinite(states['velocity'])
        | (np.isnan(states['velocity']) & np.isin(states['stamp'], recording.commands['stamp']))
    )
    if is_free_running(recording):
        seen &= np.isin(states['stamp'], recording.commands['stamp'])
    states = states[seen]
    if not len(states):
        raise BagError('no command in it answers one of its states')
    pieces = pieces_of(recording, states['stamp'], states['is_reset'], overrides)
    return states, pieces, answered(states['position'], states['velocity'], pieces)


def with_velocities(recording: Recording) -> np.ndarray:
    """
    Return the states; a velocity that was not measured is the one that the controller estimated.

    It stays nan where the bag does not tell the parameters of our nodes.
    """
    states = recording.states
    if not np.isnan(states['velocity']).any():
        return states
    try:
        seen, _, answers = answered_states(recording, {})
    except (BagError, ParameterError):
        return states
    states, at = states.copy(), np.searchsorted(states['stamp'], seen['stamp'])
    states['velocity'][at] = answers['velocity']
    return states


def closed_loop(recording: Recording) -> Resimulation:
    """
    Run the whole experiment again, from the parameters in the bag.

    Raises `BagError` for a run that is not a function of them: a free one, or one whose start
    is not in the bag.
    """
    first = next(histories(recording, PlantParameters, {}))[2]
    step, recorded = nanoseconds(first.time_step, 'time_step'), states_of(recording)
    if not first.lockstep:
        raise BagError('the run was free (lockstep: false): it depended on the wall clock')
    if recorded['stamp'][0] not in {change.stamp for change in recording.plant if change.anew}:
        raise BagError(f'the bag begins in mid-run, at {seconds(recorded["stamp"][0])} s')
    ticks = (recorded['stamp'] - recorded['stamp'][0]) // step
    stamps = recorded['stamp'][0] + step * np.arange(ticks[-1] + 1)
    is_reset = np.zeros(len(stamps), bool)
    is_reset[ticks] = recorded['is_reset']
    pieces = pieces_of(recording, stamps, is_reset, {})
    made, answers = run_again(len(stamps), pieces)
    states, damping = np.zeros(len(stamps), SAMPLE), np.zeros(len(stamps), DAMPING)
    states['stamp'], states['is_reset'], damping['stamp'] = stamps, is_reset, stamps
    damping['damping'] = made['damping']
    for name in ('position', 'velocity', 'effort'):
        states[name] = made[name]
    told = np.isin(stamps, recording.damping['stamp'])  # not every sample's is published
    return Resimulation(
        changes=len(pieces) - 1,
        pairs={
            'joint_states': (recorded, states),
            **answers_beside(recording, states, answers),
            'damping': (recording.damping, damping[told]),
        },
    )


def answers_beside(
    recording: Recording, states: np.ndarray, answers: np.ndarray
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the pairs of commands and events, of those since the first of the ``states``."""
    commands = np.zeros(len(answers), COMMAND)
    told = (answers['guard'] > 0) | (answers['verdict'] > 0)
    commands['stamp'], commands['effort'] = states['stamp'], answers['effort']
    events = np.zeros(np.count_nonzero(told), EVENT)
    for name in ('stamp', 'position'):
        events[name] = states[name][told]
    for name in ('guard', 'verdict', 'area', 'velocity'):
        events[name] = answers[name][told]
    return {
        topic: (rows[rows['stamp'] >= states['stamp'][0]], replayed)
        for topic, rows, replayed in (
            ('joint_commands', recording.commands, commands),
            ('impulse_events', recording.events, events),
        )
    }
