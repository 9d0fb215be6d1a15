"""A claim of the paper, judged by numbers of ours."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
import re
from typing import ParamSpec

P = ParamSpec('P')


@dataclass(frozen=True)
class Measured:
    """
    One number, or a few, that a claim is judged by: it ``holds`` or does not.

    ``text`` has a place in braces for each of ``values``, whose units it names; ``when`` is the
    condition, empty when there is but one.
    """

    holds: bool
    text: str
    values: tuple[float, ...] = ()
    when: str = ''

    @property
    def number(self) -> str:
        """The text with its values, rounded as it says."""
        return self.text.format(*self.values)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """What the paper says, where, and what we find; tests name it by its ``key``."""

    key: str
    where: str
    says: str
    measured: tuple[Measured, ...]

    @property
    def figure(self) -> int:
        """The number of the figure that it is about, or 0."""
        found = re.match(r'Fig\. (\d)', self.where)
        return int(found[1]) if found else 0

    @property
    def verdict(self) -> str:
        """Whether it holds: in all we find, in nothing, or under a condition that is named."""
        held = [one.holds for one in self.measured]
        return 'yes' if all(held) else 'with a condition' if any(held) else 'no'

    @property
    def numbers(self) -> str:
        """All measured in one line; where they disagree, each says whether the claim holds."""
        mixed = self.verdict == 'with a condition'
        return '; '.join(
            (f'{one.when}: ' if one.when else '')
            + (('yes, ' if one.holds else 'no, ') if mixed else '')
            + one.number
            for one in self.measured
        )


def claim(
    where: str, says: str
) -> Callable[[Callable[P, Iterator[Measured]]], Callable[P, Claim]]:
    """Make a claim of a function that yields what is measured; its name is the key."""

    def decorate(measure: Callable[P, Iterator[Measured]]) -> Callable[P, Claim]:
        @wraps(measure)
        def judged(*runs: P.args, **options: P.kwargs) -> Claim:
            key = measure.__name__.replace('_', ' ')
            measured = tuple(measure(*runs, **options))
            return Claim(key=key, where=where, says=says, measured=measured)

        return judged

    return decorate
