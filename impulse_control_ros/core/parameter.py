"""
Declare a parameter once: type, default, unit, bounds and description on a dataclass field.

Everything else derives from these fields: validation at birth, the ROS declaration
(nodes/parameters.py), the check of a YAML file and the table in the documentation.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, Field, field, fields, MISSING
from difflib import get_close_matches
import math
from operator import attrgetter
from typing import Any, TypeVar

FAR = 1e9  # bound of positions [m] and velocities [m/s]: far below overflow
TYPES = {
    float: 'a number',
    int: 'an integer',
    bool: 'true or false',
    str: 'a string',
    tuple: 'a list of strings',
}
# former names, which old files and command lines may have
RENAMED = {
    'lead': 'guard_lookahead',
    'managed': 'lifecycle',
    'stick_samples': 'stiction_wait_samples',
}


class ParameterError(ValueError):
    """A refused parameter; the message names it, its value and what is allowed."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """
    What is known of one parameter besides its type and default.

    ``lower`` and ``upper`` are in ``unit``; an ``open_`` bound is itself not allowed.
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
        """Say what is allowed for a parameter of type ``kind``, e.g. ``> 0`` or ``in [0, 1]``."""
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

    def contains(self, value: Any) -> bool:
        """Tell whether the bounds and choices admit ``value``."""
        if self.choices:
            return value in self.choices
        if isinstance(value, float) and not math.isfinite(value):
            return False
        if self.lower is not None and (
            value < self.lower or (self.open_lower and value == self.lower)
        ):
            return False
        return not (
            self.upper is not None
            and (value > self.upper or (self.open_upper and value == self.upper))
        )


def parameter(default: Any, unit: str, description: str, **spec: Any) -> Any:
    """Make the dataclass field of a parameter; ``spec`` as in `Spec`."""
    metadata = {'spec': Spec(unit=unit, description=description, **spec)}
    if isinstance(default, Parameters):
        return field(default_factory=lambda: default, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """
    A frozen set of parameters that refuses nonsense at birth.

    Subclasses declare their fields with `parameter`, and override `check` for the laws that
    bind several of them. An integer given for a float becomes a float.
    """

    def __post_init__(self) -> None:
        for name, default, spec in declared(type(self), nested=False):
            object.__setattr__(self, name, converted(name, getattr(self, name), default, spec))
        self.check()

    def check(self) -> None:
        """Raise `ParameterError` when the values do not fit together."""

    def flat(self) -> dict[str, Any]:
        """Return every value by its full name, e.g. ``{'m': 0.1, 'damping.kind': 'noise'}``."""
        return {name: attrgetter(name)(self) for name, _, _ in declared(type(self))}


KIND = TypeVar('KIND', bound=Parameters)


def declared(kind: type[Parameters], nested: bool = True) -> list[tuple[str, Any, Spec]]:
    """List (name, default, spec) of a class' parameters; ``nested`` ones as 'damping.kind'."""
    found = []
    for item in fields(kind):
        if item.default is not MISSING:
            found.append((item.name, item.default, item.metadata['spec']))
        elif nested:
            found += [
                (f'{item.name}.{name}', default, spec)
                for name, default, spec in declared(nested_kind(item))
            ]
    return found


def nested_kind(item: Field[Any]) -> type['Parameters']:
    """Return the class of a field that holds a parameter set."""
    assert isinstance(item.type, type)
    return item.type


def build(kind: type[KIND], values: Mapping[str, Any]) -> KIND:
    """
    Make the parameter set ``kind`` from values by full name; what is not named has its default.

    Raises `ParameterError` for an unknown name, a wrong type, a value out of its bounds, and
    values that do not fit together.
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
    """Make the error for a ``name`` that is none of the ``known``."""
    return ParameterError(
        f'invalid {name} = {value!r}: there is no such parameter' + meant(name, known)
    )


def meant(name: str, known: Iterable[str]) -> str:
    """Return a hint at the parameter that an unknown ``name`` may stand for, or nothing."""
    if name in RENAMED:
        return f'; its name is now {RENAMED[name]}'
    near = get_close_matches(name, known, 1)
    return f'; is {near[0]} meant?' if near else ''


def refusal(name: str, value: Any, allowed: str) -> ParameterError:
    """Make the one error of this module: the thing, its value, what is allowed."""
    return ParameterError(f'invalid {name} = {value!r}: must be {allowed}')


def converted(name: str, value: Any, default: Any, spec: Spec) -> Any:
    """Return ``value`` with the type of ``default``, or raise `ParameterError`."""
    kind = type(default)
    unit = f' [{spec.unit}]' if spec.unit else ''
    if kind is float and type(value) is int:
        value = float(value)
    if (
        kind is tuple
        and isinstance(value, (list, tuple))
        and all(isinstance(item, str) for item in value)
    ):
        value = tuple(value)
    if type(value) is not kind:
        raise refusal(name, value, TYPES[kind] + unit)
    if not spec.contains(value):
        raise refusal(name, value, spec.allowed(kind) + unit)
    return value
