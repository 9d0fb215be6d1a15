"""
The YAML file of a study, and the identity of a study.

    experiment: ../config/coulomb.yaml      an experiment, beside the study or installed, or a
                                            list of files, of which later ones count
    duration: 1.0                           s, of a run; that of the experiment if not given
    seed: 1                                 of all draws
    runs: 1000                              at each point of the axes
    tolerances: [1e-2, 1e-3]                m, for settling times
    vary:                                   parameter: distribution, see core/distributions.py
      F_c: {uniform: [0.0, 1.5]}
"""

from collections.abc import Mapping
from difflib import get_close_matches
from functools import lru_cache
import hashlib
import json
from pathlib import Path
from typing import Any

from impulse_control_ros import __version__
import impulse_control_ros.core
from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.distributions import distribution_of
from impulse_control_ros.core.parameter import build, KIND, Parameters, refusal
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.sweep_config import described, Extent, SweepConfig
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.package_share import shipped_experiment
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.yaml_file import read_mapping

EXTENT = ('duration', 'seed', 'runs')
KEYS = ('experiment', *EXTENT, 'tolerances', 'vary')


def read_study(path: str | Path) -> SweepConfig:
    """
    Read a study.

    Raises `ParameterError` if the study or its experiment cannot be read or is invalid; the
    message names the file, the key, its value and what is allowed.
    """
    content = read_mapping(path, KEYS)
    try:
        for key in content:
            if key not in KEYS:
                near = get_close_matches(str(key), KEYS, 1) or [', '.join(KEYS)]
                raise ParameterError(f'{key}: a study has no such key; is {near[0]} meant?')
        experiment = load_experiment(*experiment_files(path, content.get('experiment')))
        given = {'duration': experiment.plant.duration} | {
            key: content[key] for key in EXTENT if key in content
        }
        return SweepConfig(
            axis=part(Plant, experiment.plant),
            controller=part(ControlGains, experiment.gains),
            extent=build(Extent, given),
            tolerances=tolerances_of(content.get('tolerances', [1e-2, 1e-3])),
            vary=laws_of(content.get('vary')),
        )
    except ParameterError as error:
        raise ParameterError(f'{path}: {error}') from None


def experiment_files(study: str | Path, given: Any) -> list[Path]:
    """Return the files of the experiment, given as one name or a list; or raise."""
    names = given if isinstance(given, list) and given else [given]
    if not all(type(name) is str for name in names):
        raise refusal('experiment', given, 'a parameter file, or a list of them')
    return [experiment_file(study, name) for name in names]


def experiment_file(study: str | Path, name: str) -> Path:
    """Return a parameter file: relative to the study, or a shipped one; or raise."""
    place = Path(study).parent / name
    if place.is_file():
        return place
    try:
        return shipped_experiment(name.removesuffix('.yaml'))
    except ParameterError:
        raise refusal('experiment', name, f'a parameter file; there is no {place}') from None


def part(kind: type[KIND], whole: Parameters) -> KIND:
    """Return the parameters of a node that affect its run."""
    names = kind().flat()
    return build(kind, {name: value for name, value in whole.flat().items() if name in names})


def tolerances_of(given: Any) -> tuple[float, ...]:
    """Return the tolerances, or raise."""
    if (
        not isinstance(given, list)
        or len(set(map(str, given))) < len(given)
        or not all(type(item) in (float, int) and 0.0 < item < 1e300 for item in given)
    ):
        raise refusal('tolerances', given, 'a list of different numbers > 0 [m]')
    return tuple(float(item) for item in given)


def laws_of(given: Any) -> dict[str, Any]:
    """Return the distribution of each parameter, or raise."""
    if not isinstance(given, Mapping) or not given:
        raise refusal('vary', given, 'parameters with their laws, e.g. F_c: {uniform: [0, 1.5]}')
    return {str(name): distribution_of(str(name), one) for name, one in given.items()}


@lru_cache
def code_digest() -> str:
    """Return a digest of the code that affects figures: all of core."""
    digest = hashlib.sha256()
    for path in sorted(Path(impulse_control_ros.core.__path__[0]).glob('*.py')):
        digest.update(path.name.encode() + b'\0' + path.read_bytes())
    return digest.hexdigest()[:16]


def identity(study: SweepConfig) -> str:
    """Return as JSON everything that determines the bits of a study's result."""
    made_by = {'version': __version__, 'code': code_digest()}
    return json.dumps(made_by | described(study))


def difference(one: str, other: str) -> str:
    """Name the first thing in which two identities differ."""
    left, right = json.loads(one), json.loads(other)
    for name in [*left, *right]:
        if left.get(name) != right.get(name):
            return f'{name} = {left.get(name)} there, {right.get(name)} here'
    return 'nothing'
