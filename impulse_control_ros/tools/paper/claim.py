"""A claim of the paper, judged by numbers of ours."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Measured:
    """
    One number, or a few, that a claim is judged by.

    ``when`` is the condition it was found under, empty when there is but one; ``text`` has a
    place in braces for each of ``values``, whose units it names; ``holds`` follows from them.
    """

    when: str = ''
    holds: bool
    text: str
    values: tuple[float, ...] = ()

    @property
    def number(self) -> str:
        """The text with its values, rounded as it says."""
        return self.text.format(*self.values)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """
    What the paper says, where, and what we find.

    ``key`` names it for tests and captions; ``figure`` is 0 for a claim that has none.
    """

    key: str
    figure: int = 0
    where: str
    says: str
    measured: tuple[Measured, ...]

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
