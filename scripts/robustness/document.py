"""The generated parts of docs/concepts/robustness.md: between the markers of each study."""

from collections.abc import Sequence
import math
import re

from impulse_control_ros.errors import ParameterError
from impulse_control_ros.tools.sweep_pictures import axis_label
from scripts.robustness.comparison import (
    Comparison,
    CONTROLLERS,
    MEDIAN,
    runs_of,
)

LEVELS = 6  # in a table
IMPULSES = {'impulses': 'impulses', 'supervised': 'supervised impulses'}
FIGURES = {'settling': 'settle later', 'residual': 'leave a larger error'}


def renewed(page: str, name: str, lines: Sequence[str]) -> str:
    """Return the page with ``lines`` between the markers of the study ``name``."""
    block = re.compile(f'(<!-- {name} -->\n).*?(<!-- end -->)', re.DOTALL)
    if not block.search(page):
        raise ParameterError(f'{name}: the page has no <!-- {name} --> for it')
    body = '\n'.join(['', *lines, '', ''])
    return block.sub(lambda found: found[1] + body + found[2], page)


def block(name: str, comparison: Comparison) -> list[str]:
    """Return the lines of a study: its picture, its table and where impulses lose."""
    return [
        f'![{comparison.disturbance}](../images/{name}.png)',
        '',
        *table(comparison),
        '',
        *losses(comparison),
    ]


def table(comparison: Comparison) -> list[str]:
    """Return a table of medians at some levels."""
    frictions = ['F_c [N]'] if comparison.frictions else []
    heads = [
        axis_label(comparison.disturbance),
        *frictions,
        *(f'{controller} [s]' for controller in CONTROLLERS),
        *(f'{controller} [mm]' for controller in CONTROLLERS),
    ]
    lines = ['| ' + ' | '.join(heads) + ' |', '|---' * len(heads) + '|']
    for friction in range(len(comparison.frictions) or 1):
        for place in some(len(comparison.levels)):
            cells = [f'{comparison.levels[place]:.3g}']
            cells += [f'{value:g}' for value in comparison.frictions[friction : friction + 1]]
            cells += [
                seconds(value) for value in comparison.figures['settling'][MEDIAN, place, friction]
            ]
            cells += [
                millimetres(value)
                for value in comparison.figures['residual'][MEDIAN, place, friction]
            ]
            lines.append('| ' + ' | '.join(cells) + ' |')
    return lines


def some(count: int) -> list[int]:
    """Return at most `LEVELS` of ``count`` places, evenly spread, the ends among them."""
    most = min(LEVELS, count)
    return sorted({round(i * (count - 1) / max(most - 1, 1)) for i in range(most)})


def seconds(value: float) -> str:
    """Return a settling time as a cell."""
    return 'never' if math.isnan(value) else f'{value:.3f}'


def millimetres(value: float) -> str:
    """Return an error in m as a cell; below a micrometre it is none."""
    if math.isnan(value):
        return 'diverges'
    return '0' if value < 1e-6 else f'{1e3 * value:.3g}'


def losses(comparison: Comparison) -> list[str]:
    """Return a line for each friction and kind of impulses: at which levels they are worse."""
    return [
        f'* {where(comparison, friction)}{words} ' + loss(comparison, friction, name) + '.'
        for friction in range(len(comparison.frictions) or 1)
        for name, words in IMPULSES.items()
    ]


def where(comparison: Comparison, friction: int) -> str:
    """Return the friction as the beginning of a line, '' where it is the disturbance."""
    return ''.join(
        f'F_c = {value:g} N: ' for value in comparison.frictions[friction : friction + 1]
    )


def loss(comparison: Comparison, friction: int, name: str) -> str:
    """Return at which levels one is worse than PD or PID."""
    said = [
        f'{words} ' + ', '.join(lost)
        for figure, words in FIGURES.items()
        if (
            lost := [
                f'than {other} at '
                + ' and '.join(stretch(comparison, *ends) for ends in runs_of(places))
                for other in ('PD', 'PID')
                if (places := comparison.worse(figure, friction, name, other))
            ]
        )
    ]
    return '; '.join(said) if said else 'are at no level worse than PD or PID'


def stretch(comparison: Comparison, first: int, last: int) -> str:
    """Return the levels from ``first`` to ``last`` in words."""
    low, high = (f'{comparison.levels[place]:.3g}' for place in (first, last))
    return low if first == last else f'{low} to {high}'
