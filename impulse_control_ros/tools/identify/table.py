"""An identified axis as text or JSON."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
import json
import math
from typing import Any

import numpy as np

from impulse_control_ros.core.identification import Estimate, Identification
from impulse_control_ros.files.export import finite
from impulse_control_ros.tools.identify.experiment import IdentifiedExperiment

HEADS = ('parameter', 'value', 'unit', '95 % interval', 'share', 'verdict')


def as_text(found: Identification, made: IdentifiedExperiment | None) -> str:
    """Return a table of the parameters, then d(t) and the experiment ``made``, if any."""
    rows = [HEADS, *rows_of(found)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        '  '.join(f'{cell:<{width}}' for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    lines += ['', *facts_of(found)]
    if made:
        lines += ['', *facts_of_experiment(made)]
    return '\n'.join(lines)


def rows_of(found: Identification) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the parameters, with those by direction if these differ."""
    yield from map(row_of, found.parameters.values())
    if is_asymmetric(found):
        yield from (row_of(one) for name, one in found.asymmetric.items() if name != 'm')


def is_asymmetric(found: Identification) -> bool:
    """Return whether friction or damping clearly depends on the direction."""
    return abs(found.asymmetry_z) > 2.0  # false for nan


def row_of(one: Estimate) -> tuple[str, ...]:
    """Return the cells of a parameter."""
    low, high = one.interval
    return (
        one.name,
        shown(f'{one.value:.6g}', one.value),
        one.unit,
        shown(f'{low:.6g} to {high:.6g}', low),
        shown(f'{100.0 * one.share:.3g} %', one.share),
        one.verdict,
    )


def shown(text: str, value: float) -> str:
    """Return ``text`` about a value, or a dash if the value is not known."""
    return text if math.isfinite(value) else '-'


def facts_of(found: Identification) -> Iterator[str]:
    """Yield the lines below the table."""
    blocks = len(found.d_blocks.d)
    if blocks:
        low, high = found.d_range
        yield (
            f'd by blocks of {found.d_blocks.duration:g} s: {low:.4g} to {high:.4g} N s/m in '
            f'{blocks} blocks'
        )
    if math.isfinite(found.d_bar):
        yield (
            f'd_bar = {found.d_bar:.4g} N s/m bounds the recorded damping with 95 % confidence, '
            f'{found.d_bar_margin:.3g} N s/m above the largest block'
        )
    else:
        yield f'd_bar: {found.d_bar_verdict}'
    if math.isfinite(found.asymmetry_z):
        differ = 'differ' if is_asymmetric(found) else 'do not differ'
        yield f'the two directions {differ} (z = {found.asymmetry_z:.3g})'
    yield (
        f'residual {100.0 * found.residual:.3g} % of the effort, windows of {found.window:.3g} s, '
        f'condition {found.condition:.3g}'
    )
    sensor = [
        f'{what} {value:.4g} {unit}'
        for what, value, unit in (
            ('encoder step', found.encoder_step, 'm'),
            ('position noise', found.position_noise, 'm'),
            ('velocity noise', found.velocity_noise, 'm/s'),
            ('delay of the effort', found.effort_delay, 's'),
        )
        if math.isfinite(value)
    ]
    yield ', '.join(sensor)


def facts_of_experiment(made: IdentifiedExperiment) -> Iterator[str]:
    """Yield the lines of an experiment: its gains and the predicted response."""
    design, gains, promise = made.design, made.design.gains, made.promise
    yield (
        f'K = {gains.K:.5g} N/m, D = {gains.D:.5g} N s/m, d_bar = {gains.d_bar:.5g} N s/m, '
        f'alpha_ratio = {gains.alpha_ratio:g}'
    )
    yield (
        f'predicted: within {design.band:.3g} m of the set-point after at most '
        f'{design.settling_time:.3g} s, peak effort {design.peak_effort:.4g} N, '
        f'{design.impulses} impulses, {design.impulses_at_rest:.3g} impulses/s at rest'
    )
    (low, high), (first, last) = promise.damping_range, promise.first_zero_sampled
    kind = 'guaranteed' if promise.is_guaranteed else 'predicted'
    yield (
        f'{kind} for any d(t) from {low:.4g} to {high:.4g} N s/m: first zero of the error between '
        f'{first:.3g} and {last:.3g} s'
    )
    yield from (f'  {reason}' for reason in promise.predicted)


def as_json(found: Identification, made: IdentifiedExperiment | None) -> str:
    """Return a JSON object; unknown values are null."""
    content = asdict(found) | {'is_identified': found.is_identified}
    for name in ('friction', 'sweep'):  # of the report
        del content[name]
    if made:
        content |= {'design': asdict(made.design), 'promise': asdict(made.promise)}
    return json.dumps(finite(listed(content)), indent=2, allow_nan=False)


def listed(value: Any) -> Any:
    """Return a value with lists in place of arrays."""
    if isinstance(value, dict):
        return {name: listed(item) for name, item in value.items()}
    return value.tolist() if isinstance(value, np.ndarray) else value


FORMATS: dict[str, Callable[[Identification, IdentifiedExperiment | None], str]] = {
    'text': as_text,
    'json': as_json,
}
