"""The experiment of an identified axis and its design, as a ROS parameter file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import json
from pathlib import Path
from typing import Any

from impulse_control_ros.core.design import check_gains, Finding, Level
from impulse_control_ros.core.identification import Identification, Record
from impulse_control_ros.core.parameter import declared, Parameters
from impulse_control_ros.core.promise import Promise, promise_of
from impulse_control_ros.errors import UsageError
from impulse_control_ros.files.experiment import PlantParameters
from impulse_control_ros.tools.identify.axis import plant_of, rounded
from impulse_control_ros.tools.identify.design import Design, designed
from impulse_control_ros.tools.identify.gains import damping_range, Requirement

ALWAYS = ('m', 'F_c', 'K', 'D', 'd_bar', 'c', 'time_step')
LASTS = 2.0  # settling times
LEAST = 0.5  # s that an experiment lasts


@dataclass(frozen=True, kw_only=True)
class IdentifiedExperiment:
    """
    An axis, the design of its controller, and the findings of `check_gains` on both.

    ``promise`` is of the first zero of the error.
    """

    plant: PlantParameters
    design: Design
    promise: Promise
    findings: list[Finding]


def experiment_for(
    found: Identification, records: list[Record], need: Requirement
) -> IdentifiedExperiment:
    """Return an experiment that meets a requirement; raises `UsageError` if none does."""
    plant = plant_of(found, records, need.effort_limit)
    design = designed(found, plant, need)
    duration = max(rounded(LASTS * design.settling_time, 2), LEAST)
    plant = replace(plant, x_0=need.travel, duration=duration)
    findings = check_gains(design.gains, plant)
    for finding in findings:
        if finding.level is Level.ERROR:
            raise UsageError(f'no controller is possible: {finding.text}')
    promise = promise_of(design.gains, damping_range(found), need.travel, plant.F_c)
    return IdentifiedExperiment(plant=plant, design=design, promise=promise, findings=findings)


def text_of(
    experiment: IdentifiedExperiment, found: Identification, sources: Sequence[Path]
) -> str:
    """Return the content of the parameter file."""
    low, high = found.parameters['m'].interval
    design = experiment.design
    lines = [
        f'# Identified from {", ".join(source.name for source in sources)}.',
        f'# 95 % interval of m: {low:.4g} to {high:.4g} kg; bound of the recorded damping: '
        f'{found.d_bar:.4g} N s/m.',
        f'# Predicted: within {design.band:.3g} m after {design.settling_time:.3g} s, peak effort '
        f'{design.peak_effort:.4g} N.',
    ]
    nodes: dict[str, Parameters] = {
        'plant_simulator': experiment.plant,
        'controller': design.gains,
    }
    for node, parameters in nodes.items():
        lines += [f'/**/{node}:', '  ros__parameters:', *lines_of(parameters)]
    return '\n'.join([*lines, ''])


def lines_of(parameters: Parameters) -> Iterator[str]:
    """Yield the lines of a node's parameters: the basic ones, and those that are not defaults."""
    values, group = parameters.flat(), ''
    for name, default, spec in declared(type(parameters)):
        value = values[name]
        if value == default and name not in ALWAYS:
            continue
        before, _, last = name.rpartition('.')
        if before and before != group:
            yield f'    {before}:'
        group = before
        shown = f'{"      " if before else "    "}{last}: {as_yaml(value)}'
        yield f'{shown:<34}# {spec.unit}' if spec.unit else shown


def as_yaml(value: Any) -> str:
    """Return a value as ROS reads it; a float has a point, which rcl needs before an exponent."""
    if isinstance(value, float):
        text = f'{value:.10g}'
        mantissa, exponent, power = text.partition('e')
        return (mantissa if '.' in mantissa else f'{mantissa}.0') + exponent + power
    return value if isinstance(value, str) else json.dumps(value)
