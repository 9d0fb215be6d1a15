"""
Declare a parameter once: type, default, unit, bounds and description on a dataclass field.

Everything else derives from these fields: validation at construction, the ROS declaration
(nodes/parameters.py), the check of a YAML file and the table in the documentation.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, Field, field, fields, MISSING
from difflib import get_close_matches
from functools import cache
from operator import attrgetter
import re
from typing import Any, cast, ClassVar, NamedTuple, TypeVar

import numpy as np

from impulse_control_ros.errors import ParameterError

FAR = 1e9  # bound of positions [m] and velocities [m/s]: far below overflow
TYPES = {
    float: 'a number',
    int: 'an integer',
    bool: 'true or false',
    str: 'a string',
    tuple: 'a list of strings',
}
# a number that YAML 1.1, and so the command line of ros2, takes for a string: 1e-6
EXPONENTIAL = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+')
# former names, which old files and command lines may have
RENAMED = {
    'lead': 'guard_lookahead',
    'managed': 'lifecycle',
    'stick_samples': 'stiction_wait_samples',
}


F = TypeVar('F', bound=Callable[..., Any])


def once(function: F) -> F:
    """Return the cached function; mypy does not know that classes are hashable."""
    return cast(F, cache(function))


@dataclass(frozen=True, kw_only=True)
class Spec:
    """
    Properties of a parameter besides its type and default.

    ``lower`` and ``upper`` are in ``unit``; an ``open_`` bound excludes its value.
    """

    unit: str
    description: str
    lower: float | None = None
    upper: float | None = None
    open_lower: bool = False
    open_upper: bool = False
    choices: tuple[Any, ...] = ()
    read_only: bool = False
    reference: str = ''

    def allowed(self, kind: type = float) -> str:
        """Describe the allowed values for the type ``kind``, e.g. ``> 0`` or ``in [0, 1]``."""
        if self.choices:
            text = 'one of ' + ', '.join(str(choice) for choice in self.choices)
        elif self.lower is not None and self.upper is not None:
            text = (
                f'in {"(" if self.open_lower else "["}{self.lower:g}, '
                f'{self.upper:g}{")" if self.open_upper else "]"}'
            )
        elif self.lower is not None:
            text = f'{">" if self.open_lower else ">="} {self.lower:g}'
        elif self.upper is not None:
            text = f'{"<" if self.open_upper else "<="} {self.upper:g}'
        else:
            text = 'finite' if kind is float else TYPES[kind]
        return text + (f', {self.reference}' if self.reference else '')

    def contains(self, values: Any) -> np.ndarray:
        """Return whether bounds and choices admit a value, or each of an array: bools."""
        values = np.asarray(values)
        if self.choices:
            return np.isin(values, self.choices)
        admitted = np.isfinite(values) if values.dtype.kind == 'f' else np.array(True)
        if self.lower is not None:
            above = values > self.lower if self.open_lower else values >= self.lower
            admitted = admitted & above
        if self.upper is not None:
            below = values < self.upper if self.open_upper else values <= self.upper
            admitted = admitted & below
        return admitted


def parameter(default: Any, unit: str, description: str, **spec: Any) -> Any:
    """Return the dataclass field of a parameter; ``spec`` sets the fields of `Spec`."""
    metadata = {'spec': Spec(unit=unit, description=description, **spec)}
    if isinstance(default, Parameters):
        return field(default_factory=lambda: default, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """
    A frozen set of parameters, validated at construction.

    Subclasses declare their fields with `parameter`, declare the rules between them as `RULES`,
    and override `check` for other conditions. The full name of a parameter of a nested set starts
    with the ``prefix`` of its class. An integer, or a string such as '1e-6', given for a float
    becomes a float.
    """

    prefix: ClassVar[str] = ''
    RULES: ClassVar[tuple['Rule', ...]] = ()

    def __new__(cls, **values: Any) -> 'Parameters':
        """Raise `ParameterError` for an unknown name."""
        known = [item.name for item in fields(cls)]
        for name, value in values.items():
            if name not in known:
                raise unknown(name, value, known)
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for name, default, spec in declared(type(self), nested=False):
            object.__setattr__(self, name, converted(name, getattr(self, name), default, spec))
        for item in fields(self):
            value = getattr(self, item.name)
            if item.default is MISSING and not isinstance(value, nested_kind(item)):
                raise refusal(item.name, value, f'of class {nested_kind(item).__name__}')
        if self.RULES:
            require_rules(type(self), self.flat(), nested=False)
        self.check()

    def check(self) -> None:
        """Raise `ParameterError` if the values contradict each other."""

    def flat(self) -> dict[str, Any]:
        """Return every value by its full name, e.g. ``{'m': 0.1, 'damping.kind': 'noise'}``."""
        return {name: value_of(self) for name, value_of in _getters(type(self))}


class Rule(NamedTuple):
    """
    A rule between parameters of a class.

    ``name`` is the parameter that an error names, and ``allowed`` a format string for what it must
    be. ``hardest`` lists the parameters that ``holds`` takes, in order, each with the extreme (min
    or max) at which the rule is hardest to meet. ``holds`` takes scalars, or arrays of shape (n,)
    elementwise.
    """

    name: str
    allowed: str
    hardest: Mapping[str, Callable[..., Any]]
    holds: Callable[..., Any]


def rules(kind: type['Parameters'], nested: bool = True) -> Iterator[tuple[str, Rule]]:
    """Yield the rules of a class, each with the prefix of its names."""
    yield from (('', rule) for rule in kind.RULES)
    for item in fields(kind) if nested else ():
        if item.default is MISSING:
            inner = nested_kind(item)
            yield from ((inner.prefix, rule) for rule in inner.RULES)


def require_rules(
    kind: type['Parameters'], values: Mapping[str, Any], nested: bool = True
) -> None:
    """
    Raise `ParameterError` for the first rule of a class that ``values``, by full name, break.

    Arrays of shape (n,) are checked row by row; the error names the first row that fails.
    """
    for prefix, rule in rules(kind, nested):
        bound = {name: values[prefix + name] for name in rule.hardest}
        holds = np.atleast_1d(rule.holds(*(np.asarray(value) for value in bound.values())))
        if holds.all():
            continue
        at = int(np.argmin(holds))
        varied = any(np.ndim(value) for value in bound.values())
        bound = {
            name: np.asarray(value).ravel()[min(at, np.size(value) - 1)].item()
            for name, value in bound.items()
        }
        name = (prefix or kind.prefix) + rule.name + (f'[{at}]' if varied else '')
        raise refusal(name, bound[rule.name], rule.allowed.format_map(bound))


KIND = TypeVar('KIND', bound=Parameters)


@once
def declared(kind: type[Parameters], nested: bool = True) -> tuple[tuple[str, Any, Spec], ...]:
    """Return (name, default, spec) of each parameter; ``nested`` ones are named 'damping.kind'."""
    found: list[tuple[str, Any, Spec]] = []
    for item in fields(kind):
        if item.default is not MISSING:
            found.append((item.name, item.default, item.metadata['spec']))
        elif nested:
            found += [
                (f'{item.name}.{name}', default, spec)
                for name, default, spec in declared(nested_kind(item))
            ]
    return tuple(found)


@once
def _getters(kind: type[Parameters]) -> list[tuple[str, Callable[[Any], Any]]]:
    return [(name, attrgetter(name)) for name, _, _ in declared(kind)]


def nested_kind(item: Field[Any]) -> type['Parameters']:
    """Return the class of a field that holds a parameter set."""
    assert isinstance(item.type, type)
    return item.type


def build(kind: type[KIND], values: Mapping[str, Any]) -> KIND:
    """
    Return the parameter set ``kind`` from values by full name; other parameters are defaults.

    Raises `ParameterError` for an unknown name, a wrong type, a value out of bounds, and values
    that break a rule.
    """
    known = {name: (default, spec) for name, default, spec in declared(kind)}
    for name, value in values.items():
        if name not in known:
            raise unknown(name, value, known)
    right = {name: converted(name, value, *known[name]) for name, value in values.items()}
    inner = {}
    for item in fields(kind):
        if item.default is MISSING:
            prefix = f'{item.name}.'
            inner[item.name] = build(
                nested_kind(item),
                {
                    name.removeprefix(prefix): right.pop(name)
                    for name in list(right)
                    if name.startswith(prefix)
                },
            )
    return kind(**right, **inner)


def unknown(name: str, value: Any, known: Iterable[str]) -> ParameterError:
    """Return the error for a ``name`` that is not among the ``known``."""
    return ParameterError(
        f'invalid {name} = {value!r}: there is no such parameter' + meant(name, known)
    )


def meant(name: str, known: Iterable[str]) -> str:
    """Return a hint at the parameter that an unknown ``name`` may mean, or ''."""
    if name in RENAMED:
        return f'; its name is now {RENAMED[name]}'
    near = get_close_matches(name, known, 1)
    return f'; is {near[0]} meant?' if near else ''


def refusal(name: str, value: Any, allowed: str) -> ParameterError:
    """Return an error that states a name, its value and what is allowed."""
    return ParameterError(f'invalid {name} = {value!r}: must be {allowed}')


def converted(name: str, value: Any, default: Any, spec: Spec) -> Any:
    """Return ``value`` with the type of ``default``, or raise `ParameterError`."""
    kind = type(default)
    value = value.item() if isinstance(value, np.generic) else value
    unit = f' [{spec.unit}]' if spec.unit else ''
    if kind is float and (
        type(value) is int or (type(value) is str and EXPONENTIAL.fullmatch(value))
    ):
        value = float(value)
    if (
        kind is tuple
        and isinstance(value, (list, tuple))
        and all(isinstance(item, str) for item in value)
    ):
        value = tuple(value)
    if type(value) is not kind:
        raise refusal(name, value, TYPES[kind] + unit)
    if not spec.contains(value).all():
        raise refusal(name, value, spec.allowed(kind) + unit)
    return value
