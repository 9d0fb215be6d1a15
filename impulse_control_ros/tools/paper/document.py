"""The claims in words: figure captions, a table for a terminal, docs/concepts/paper.md."""

from collections.abc import Sequence
import textwrap

from impulse_control_ros.tools.paper.claim import Claim

TITLES = {
    1: 'PD alone from x = 0.5 m at rest, with the damping at either of its bounds.',
    2: 'Position and velocity from x = 0.5 m at rest with and without impulses, d = 0.15 N s/m.',
    3: 'The varying damping of Fig. 4.',
    4: 'The axis of Fig. 2 under the damping of Fig. 3, with and without impulses.',
    5: 'The axis with Coulomb friction F_c = 1 N from x = 0.15 m at rest, d = 0.15 N s/m, with '
    'and without impulses.',
}
MARKER = '<!-- Generated from here on by: paper_figures --docs docs -->'


def caption(figure: int, claims: Sequence[Claim]) -> str:
    """Return the caption of a figure: a line on what it shows, and one for each claim on it."""
    lines = [
        f'The paper: {claim.says}. Holds: {claim.verdict}. Ours: {claim.numbers}.'
        for claim in claims
        if claim.figure == figure
    ]
    return '\n'.join([f'Fig. {figure}. {TITLES[figure]}', *lines])


def plain(claims: Sequence[Claim]) -> str:
    """Return the claims for a terminal."""
    lines, indent = [], ' ' * 17
    for claim in claims:
        lines.append(f'{claim.verdict:<17}{claim.where}: {claim.says}')
        lines += textwrap.wrap(claim.numbers, 99, initial_indent=indent, subsequent_indent=indent)
    return '\n'.join(lines)


def section(claims: Sequence[Claim]) -> str:
    """Return what docs/concepts/paper.md holds below its hand-written part, the marker first."""
    parts = [
        MARKER,
        '',
        '## Claims',
        '',
        '| claim | where | holds? | number |',
        '|---|---|---|---|',
    ]
    for claim in claims:
        cells = ' | '.join(
            cell.replace('|', '\\|')
            for cell in (claim.says, claim.where, claim.verdict, claim.numbers)
        )
        parts.append(f'| {cells} |')
    parts += ['', '## Figures']
    for figure in TITLES:
        first, *others = caption(figure, claims).splitlines()
        parts += ['', f'![Fig. {figure}](../images/fig{figure}.png)', '', f'**{first}**', '']
        parts += [f'* {line}' for line in others]
    return '\n'.join(parts) + '\n'


def renewed(document: str, claims: Sequence[Claim]) -> str:
    """Return the text of docs/concepts/paper.md with its lower part made anew."""
    return document.partition(MARKER)[0] + section(claims)
