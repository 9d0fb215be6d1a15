"""The checks of recorded runs: what core/check.py finds in a bag, as text, JSON or CSV."""

from collections.abc import Callable, Mapping, Sequence
import csv
from dataclasses import dataclass, fields, replace
from io import StringIO
import json
from typing import Any

import numpy as np

from impulse_control_ros.core.check import check_applied
from impulse_control_ros.core.check_guards import Commands, guard_checks
from impulse_control_ros.core.check_law import check_commands
from impulse_control_ros.core.check_motion import check_foreign_motion, check_motion, Errors
from impulse_control_ros.core.check_report import (
    bounded,
    Check,
    finite,
    line,
    LoopSamples,
    ROUNDING,
    Violation,
)
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.tick import SECOND, seconds
from impulse_control_ros.errors import BagError, ParameterError
from impulse_control_ros.files.completeness import NO_EVENT
from impulse_control_ros.files.recording import Recording
from impulse_control_ros.tools.analyze.run import Run
from impulse_control_ros.tools.resimulate import answered_states, is_free_running, pieces_of

COLUMNS = [item.name for item in fields(Check) if item.name != 'first']
FIRST = ['stamp', *Violation._fields[1:]]


@dataclass(frozen=True, kw_only=True)
class Checked:
    """The ``checks`` of a ``run``."""

    run: Run
    checks: Sequence[Check]

    @property
    def gap(self) -> str:
        """Why the control law was not checked; '' if it was."""
        if any(check.checked for check in self.checks if check.name == 'effort'):
            return ''
        notes = [check.note for check in self.checks if check.note]
        return f'the control law was not checked: {notes[-1]}'

    def stamp(self, check: Check) -> str:
        """Return the stamp [s] of the first violation, '' without one."""
        stamps = self.run.recording.states['stamp']
        return seconds(stamps[check.first.sample]) if check.first else ''


@np.errstate(all='ignore')  # recorded values may be nan, infinite or huge
def checked(run: Run, errors: Errors | None) -> Checked:
    """Check a run; ``errors`` are the largest ones of the sensor of a foreign plant."""
    recording = run.recording
    try:
        axes = plants_of(recording)
        gains, fresh = answered_pieces(recording)
    except (BagError, ParameterError) as error:
        return Checked(run=run, checks=[Check(name='parameters', note=str(error))])
    loop = samples_of(recording, gains[0].time_step, fresh)
    checks = [*motion_of(recording, loop, axes, gains, errors), commands_of(recording)]
    unknown = [text for text in recording.lacks if NO_EVENT in text]
    if unknown:
        checks.append(Check(name='effort', note=unknown[0]))
    else:
        checks += law_of(recording, loop, gains)
    return Checked(run=run, checks=checks)


def law_of(recording: Recording, loop: LoopSamples, gains: Mapping[int, Any]) -> list[Check]:
    """Check the commands; the impulses of a supervised law by what it answers once more."""
    checks = check_commands(loop, gains)
    if not any(one.supervision for one in gains.values()):
        return checks
    replayed, effort = supervised_commands(recording, loop), checks[-1]
    uses_mass = np.isnan(recording.velocity).any() or any(
        one.velocity_source == 'estimated' for one in gains.values()
    )
    return replayed if uses_mass else [*replayed[:-1], effort]


def supervised_commands(recording: Recording, loop: LoopSamples) -> list[Check]:
    """Compare the commands with those of the law on the recorded states, once it has begun."""
    states, _, expected = answered_states(recording, {})
    samples = np.searchsorted(recording.states['stamp'], states['stamp'])
    fresh, index = loop.fresh[samples], np.arange(len(samples))
    begins = fresh | (np.diff(loop.time[samples], prepend=-np.inf) > 1.5 * loop.time_step)
    values = {name: getattr(loop, name)[samples] for name in Commands._fields[1:-1]}
    commands = Commands(samples=samples, begins=begins, **values)
    known = fresh[np.maximum.accumulate(np.where(begins, index, 0))]
    known &= np.isfinite(commands.effort)
    checks = guard_checks(commands, expected['guard'], known)
    for name, unit, value, answer in (
        ('impulse area', 'N s', np.where(commands.guard, commands.area, np.nan), expected['area']),
        ('effort', 'N', commands.effort, expected['effort']),
    ):
        value, tolerance = np.where(known, value, np.nan), ROUNDING * np.abs(answer)
        checks.append(bounded(name, unit, value, (answer, answer), tolerance, samples))
    return checks


def commands_of(recording: Recording) -> Check:
    """Check that the commands are finite, and note the states that none answers."""
    stamps, commands = recording.states['stamp'], recording.commands
    check = finite('command', commands['effort'], np.searchsorted(stamps, commands['stamp']))
    unanswered = len(stamps) - int(np.isin(stamps, commands['stamp']).sum())
    note = f'{unanswered} states without a command' if unanswered > 1 else ''
    return replace(check, note=note)


def motion_of(
    recording: Recording,
    loop: LoopSamples,
    axes: Mapping[int, Plant],
    gains: Mapping[int, Any],
    errors: Errors | None,
) -> list[Check]:
    """Check the motion of the axis, by its parameters if the bag has them."""
    if axes:
        checks = check_motion(loop, axes)
        return checks if is_free_running(recording) else [*checks, check_applied(loop, axes)]
    if errors:
        return check_foreign_motion(loop, gains, errors)
    note = 'give --position-error and --velocity-error of the axis, 0 if it has none'
    return [Check(name='momentum', note=note)]


def samples_of(recording: Recording, time_step: float, fresh: Sequence[int]) -> LoopSamples:
    """Return the samples of a recording, of which a ``fresh`` controller answers some."""
    states, count = recording.states, len(recording.states)
    stamps = states['stamp']
    effort, damping, area = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)
    guard = np.zeros(count, int)
    for rows, pairs in (
        (recording.commands, [(effort, 'effort')]),
        (recording.events, [(guard, 'guard'), (area, 'area')]),
        # other recorders do not tell which sample a damping is of
        (recording.damping[: None if recording.version else 0], [(damping, 'damping')]),
    ):
        place = np.searchsorted(stamps, rows['stamp'])
        found = np.append(stamps, -1)[place] == rows['stamp']
        for values, name in pairs:
            recorded = rows[name][found]
            values[place[found]] = np.where(np.isfinite(recorded), recorded, np.nan)
    starts = [change.stamp for change in recording.plant if change.anew]
    begin = max([one for one in starts if one <= stamps[0]], default=stamps[0])
    return LoopSamples(
        time=(stamps - begin) / SECOND,
        time_step=time_step,
        position=states['position'],
        velocity=states['velocity'],
        effort=effort,
        # a state tells what acted on it, over the sample before
        applied=np.append(states['effort'][1:], np.nan),
        damping=np.append(damping[1:], np.nan),
        guard=guard,
        area=area,
        starts=states['is_reset'],
        fresh=np.isin(np.arange(count), fresh),
    )


def plants_of(recording: Recording) -> Mapping[int, Plant]:
    """Return the parameters of the plant by their first states; none of a foreign plant."""
    if not recording.plant:
        return {}
    pieces = pieces_of(recording, recording.states['stamp'], recording.states['is_reset'], {})
    return {piece.first: piece.plant for piece in pieces if piece.plant}


def answered_pieces(recording: Recording) -> tuple[Mapping[int, Any], list[int]]:
    """Return the gains by their first states, and the states that a fresh controller answers."""
    stamps = recording.states['stamp']
    answered = np.flatnonzero(np.isin(stamps, recording.commands['stamp']))
    if not len(answered):
        raise BagError('no state is answered')
    resets = np.zeros(len(answered) + 1, bool)
    resets[np.searchsorted(answered, np.flatnonzero(recording.states['is_reset']))] = True
    pieces = pieces_of(recording, stamps[answered], resets[:-1], {})
    gains = {int(answered[piece.first]) if piece.first else 0: piece.gains for piece in pieces}
    fresh = [int(answered[piece.first]) for piece in pieces if piece.afresh]
    begins = {change.stamp for change in recording.controllers if change.anew}
    if not resets[0] and stamps[answered[0]] not in begins:
        fresh = fresh[1:]  # what it remembers is not in the bag
    return gains, fresh


def as_text(every: Sequence[Checked]) -> str:
    """Return a line for each check, under the name of its run."""
    return '\n'.join(
        '\n'.join([one.run.name, *(line(check, one.stamp(check)) for check in one.checks)])
        for one in every
    )


def rows(every: Sequence[Checked]) -> list[dict[str, Any]]:
    """Return a row for each check; None for what there is not."""
    return [
        {'bag': one.run.name, 'path': str(one.run.path)}
        | {name: getattr(check, name) for name in COLUMNS}
        | {'stamp': one.stamp(check) or None}
        | {name: getattr(check.first, name, None) for name in FIRST[1:]}
        for one in every
        for check in one.checks
    ]


def as_json(every: Sequence[Checked]) -> str:
    """Return a list of objects, one a check."""
    return json.dumps(rows(every), indent=2)


def as_csv(every: Sequence[Checked]) -> str:
    """Return a header and a line for each check."""
    text = StringIO()
    writer = csv.DictWriter(text, ['bag', 'path', *COLUMNS, *FIRST], lineterminator='\n')
    writer.writeheader()
    writer.writerows(rows(every))
    return text.getvalue().rstrip('\n')


FORMATS: dict[str, Callable[[Sequence[Checked]], str]] = {
    'text': as_text,
    'json': as_json,
    'csv': as_csv,
}
