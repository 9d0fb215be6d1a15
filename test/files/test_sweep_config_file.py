"""SweepConfig files: read as they say, or refused in one line that names the thing."""

import re

import pytest
import yaml

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.distributions import Distribution, DISTRIBUTIONS
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.sweep_config_file import difference, identity, read_study
from test.conftest import CONFIG, ROOT

GOOD = f"""
experiment: {CONFIG / 'coulomb.yaml'}
duration: 0.5
seed: 4
runs: 20
tolerances: [1e-2]
vary:
  F_c: {{uniform: [0, 1.5]}}
"""
STUDIES = sorted([*ROOT.glob('studies/*.yaml'), *ROOT.glob('scripts/studies/*.yaml')])


def read(tmp_path, text=GOOD):
    path = tmp_path / 'study.yaml'
    path.write_text(text)
    return read_study(path)


@pytest.mark.parametrize('path', STUDIES, ids=lambda path: path.stem)
def test_every_study_of_ours_can_be_read(path):
    assert read_study(path).rows > 1_000


def test_a_study_is_what_its_file_says(tmp_path):
    study = read(tmp_path)
    coulomb = load_experiment(CONFIG / 'coulomb.yaml')
    assert (study.extent.duration, study.extent.seed, study.extent.runs) == (0.5, 4, 20)
    assert study.tolerances == (1e-2,)
    assert study.vary == {'F_c': Distribution(kind='uniform', arguments=(0, 1.5))}
    assert study.axis.x_0 == coulomb.plant.x_0
    assert study.axis.damping == coulomb.plant.damping
    told = coulomb.gains.flat()
    assert study.controller.flat() == {name: told[name] for name in ControlGains().flat()}


def test_the_duration_is_that_of_the_experiment_where_none_is_given(tmp_path):
    assert read(tmp_path, GOOD.replace('duration: 0.5\n', '')).extent.duration == 5.0


def test_an_experiment_is_found_beside_the_study_or_among_ours(tmp_path):
    text = GOOD.replace(str(CONFIG / 'coulomb.yaml'), 'coulomb.yaml')
    assert read(tmp_path, text).axis.x_0 == 0.15
    (tmp_path / 'coulomb.yaml').write_text((CONFIG / 'underdamped.yaml').read_text())
    assert read(tmp_path, text).axis.x_0 == 0.5
    with pytest.raises(ParameterError, match='there is no .*other.yaml'):
        read(tmp_path, text.replace('coulomb', 'other'))


def test_later_files_of_an_experiment_count(tmp_path):
    (tmp_path / 'stiff.yaml').write_text('/**/controller:\n  ros__parameters: {K: 40.0}\n')
    study = read(
        tmp_path, GOOD.replace(str(CONFIG / 'coulomb.yaml'), '[coulomb.yaml, stiff.yaml]')
    )
    assert (study.controller.K, study.axis.x_0) == (40.0, 0.15)


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('seed: 4', 'sed: 4', 'sed: a study has no such key; is seed meant?'),
        ('seed: 4', 'seed: four', "seed = 'four': must be an integer"),
        ('seed: 4', 'seed: -4', 'seed = -4: must be >= 0'),
        ('runs: 20', 'runs: 2.5', 'runs = 2.5: must be an integer'),
        ('duration: 0.5', 'duration: 0', 'duration = 0.0: must be > 0 [s]'),
        ('duration: 0.5', 'duration: .inf', 'duration = inf'),
        ('[1e-2]', '[1e-2, 1e-2]', ': must be a list of different numbers > 0 [m]'),
        ('[1e-2]', '1e-2', 'tolerances = 0.01'),
        ('[1e-2]', '[-1]', 'tolerances = [-1]'),
        ('F_c:', 'F_d:', 'F_d: no such parameter can be varied; is F_c meant?'),
        ('uniform', 'unifrom', 'F_c: unifrom: there is no such distribution; is uniform meant?'),
        ('[0, 1.5]', '[-1, 1.5]', 'F_c = -1.0: must be >= 0 [N]'),
        ('{uniform: [0, 1.5]}', '3', 'F_c = 3: must be one distribution: '),
        ('{uniform: [0, 1.5]}', '{uniform: [0, 1.5]', "expected ',' or '}'"),
        ('\n  F_c: {uniform: [0, 1.5]}', ' 3', 'vary = 3: must be parameters with'),
        ('vary:\n  F_c: {uniform: [0, 1.5]}', '', 'vary = None'),
        ('coulomb.yaml', 'coulumb.yaml', ': must be a parameter file; there is no '),
        (f'{CONFIG}/coulomb.yaml', '3', 'experiment = 3: must be a parameter file, or a list'),
        (f'{CONFIG}/coulomb.yaml', '[]', 'experiment = []: must be a parameter file, or a list'),
        (f'{CONFIG}/coulomb.yaml', '[coulomb.yaml, 3]', "experiment = ['coulomb.yaml', 3]: must"),
        ('experiment:', 'experiments:', 'is experiment meant?'),
    ],
)
def test_a_wrong_study_is_refused_in_one_line(tmp_path, old, new, said):
    assert old in GOOD
    with pytest.raises(ParameterError) as refused:
        read(tmp_path, GOOD.replace(old, new, 1))
    assert said in str(refused.value)
    assert str(tmp_path / 'study.yaml') in str(refused.value)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize('text', ['', '- 1\n', 'a\n', '\x00'])
def test_a_file_that_is_no_mapping_is_refused_in_one_line(tmp_path, text):
    with pytest.raises(ParameterError) as refused:
        read(tmp_path, text)
    assert '\n' not in str(refused.value)


def test_a_wrong_experiment_is_named(tmp_path):
    (tmp_path / 'wrong.yaml').write_text('controller:\n  ros__parameters: {K: ten}\n')
    with pytest.raises(ParameterError, match=r"wrong\.yaml: /controller: invalid K = 'ten'"):
        read(tmp_path, GOOD.replace(str(CONFIG / 'coulomb.yaml'), 'wrong.yaml'))


def test_the_documentation_shows_a_study_and_every_law():
    text = (ROOT / 'docs' / 'reference' / 'studies.md').read_text()
    shown = re.search(r'```yaml\n(.*?)```', text, re.S)[1]
    study = yaml.safe_load((ROOT / 'studies' / 'gains.yaml').read_text())
    assert yaml.safe_load(shown) == study
    assert re.findall(r'^\| `(\w+)` \|', text, re.M) == list(DISTRIBUTIONS)


def test_an_identity_tells_studies_apart_by_what_their_figures_depend_on(tmp_path):
    one = identity(read(tmp_path))
    assert one == identity(read(tmp_path, GOOD.replace('[0, 1.5]', '[0.0, 1.5]')))
    other = identity(read(tmp_path, GOOD.replace('seed: 4', 'seed: 5')))
    assert difference(one, other) == 'seed = 4 there, 5 here'
