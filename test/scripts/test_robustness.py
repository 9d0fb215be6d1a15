"""The study of docs/concepts/robustness.md: its page, its PID, and laws that its figures keep."""

from functools import partial
from pathlib import Path
import re
import shutil

import numpy as np
import pytest
import yaml

from impulse_control_ros.command_line import exit_status, StopRequest
from impulse_control_ros.files.sweep_config_file import read_study
import scripts.robustness.__main__ as command
from scripts.robustness.comparison import compared, Comparison
from scripts.robustness.document import block
from scripts.robustness.drawing import picture
from test.conftest import CONFIG, ROOT

FOLDER = ROOT / 'scripts' / 'studies'
STUDIES = sorted(FOLDER.glob('robustness_*.yaml'))
NAMES = [path.stem for path in STUDIES]
COMPARED = [path for path in STUDIES if path.stem != command.TUNING]
PAGE = (ROOT / 'docs' / command.PAGE).read_text()
K = 10.0


def tiny(name, **vary):
    """Return the text of a study of ours with few runs and levels, and with ``vary`` besides."""
    study = yaml.safe_load((FOLDER / f'{name}.yaml').read_text())
    first = next(iter(study['vary']))
    study |= {
        'experiment': str(CONFIG / Path(study['experiment']).name),
        'runs': 3,
        'duration': 2.0,
    }
    study['vary'] |= {first: {'values': [0, 1, 50]}} | vary
    return yaml.safe_dump(study, sort_keys=False)


@pytest.fixture
def place(tmp_path):
    """Return a folder with a page and two tiny studies."""
    (tmp_path / 'studies').mkdir()
    for room in ('concepts', 'images'):
        (tmp_path / 'docs' / room).mkdir(parents=True)
    for name in ('robustness_delay', 'robustness_friction'):
        (tmp_path / 'studies' / f'{name}.yaml').write_text(tiny(name))
        with (tmp_path / 'docs' / command.PAGE).open('a') as page:
            page.write(f'# Ours\n\n<!-- {name} -->\nold\n<!-- end -->\n\nText.\n')
    return tmp_path


def renewed(place, runs='runs'):
    """Renew the page there; returns the exit status."""
    arguments = [
        str(place / 'docs'),
        '--studies',
        str(place / 'studies'),
        '--runs',
        str(place / runs),
    ]
    return exit_status('robustness', partial(command.main, StopRequest(), arguments))


def of(study, folder):
    """Run a study, whose columns come to ``folder``."""
    return command.ran(study, folder, StopRequest())


def test_the_page_has_each_study_once_and_a_picture_of_it():
    assert sorted(re.findall('<!-- (robustness_.*) -->', PAGE)) == NAMES
    pictures = {path.stem for path in (ROOT / 'docs' / command.PICTURES).glob('robustness_*.png')}
    assert pictures == {path.stem for path in COMPARED}
    assert set(re.findall(r'\]\(\.\./images/(.*)\.png\)', PAGE)) == pictures


def test_the_same_studies_give_the_same_bytes_and_the_text_stays(place):
    pages = []
    for runs in ('runs', 'again', 'again'):  # the last finds them finished
        assert renewed(place, runs) == 0
        pages.append({path.name: path.read_bytes() for path in (place / 'docs').glob('*/*')})
    assert pages[0] == pages[1] == pages[2]
    assert sorted(pages[0]) == ['robustness.md', 'robustness_delay.png', 'robustness_friction.png']
    text = pages[0]['robustness.md'].decode()
    assert text.count('# Ours') == text.count('Text.') == 2
    assert 'old' not in text
    assert '| actuator.delay [samples] | F_c [N] | PD [s] |' in text


def test_what_cannot_be_renewed_is_refused_in_one_line(place, capsys):
    def refused():
        assert renewed(place) == 2
        said = capsys.readouterr().err
        assert said.count('\n') == 1
        return said

    study = place / 'studies' / 'robustness_delay.yaml'
    study.write_text(tiny('robustness_delay', K_i={'values': [12.0]}))
    assert 'two values of F_c, controller.impulses, supervision, K_i' in refused()
    study.rename(place / 'studies' / 'robustness_new.yaml')
    study = place / 'studies' / 'robustness_new.yaml'
    study.write_text(tiny('robustness_delay'))
    shutil.rmtree(place / 'runs', ignore_errors=True)
    assert 'the page has no <!-- robustness_new -->' in refused()
    (place / 'docs' / command.PAGE).unlink()
    assert 'must be a folder with concepts/robustness.md' in refused()


def test_the_pid_of_all_studies_is_the_best_of_the_tuning(tmp_path):
    study = read_study(FOLDER / f'{command.TUNING}.yaml')
    means = command.mean_iae(study, of(study, tmp_path / 'tuning'))
    best = study.axes['K_i'][int(np.argmin(means))]
    assert 0 < np.argmin(means) < len(means) - 1
    for path in COMPARED:
        gains = read_study(path).axes['K_i']
        # poles ten times as fast: an integral gain a thousand times as large
        assert gains == [0.0, 1e3 * best if 'stiff' in path.stem else best], path.stem
    assert f'The least is at K_i = {best:g} N/(m s).' in PAGE


@pytest.mark.parametrize('damping', [{'uniform': [0.15, 1.5]}, {'choice': [3.0]}])
def test_pd_sticks_within_friction_over_gain_and_a_creeping_axis_at_the_edge(damping, tmp_path):
    levels = np.array([0.5, 1.0, 2.0])
    path = tmp_path / 'study.yaml'
    path.write_text(
        tiny(
            'robustness_friction',
            F_c={'values': levels.tolist()},
            x_0={'uniform': [0.3, 0.5]},
            **{'damping.value': damping},
        )
    )
    study = read_study(path)
    residual = compared(study, of(study, tmp_path / 'run')).figures['residual'][:, :, 0, 0]
    if 'choice' in damping:
        assert residual == pytest.approx(np.tile(levels / K, (3, 1)), abs=2e-3)
    else:
        assert (residual <= levels / K * (1.0 + 1e-9)).all()


def comparison(settling, residual):
    """Return a comparison of the four controllers, given as (levels, controllers)."""
    figures = {'settling': settling, 'residual': residual}
    figures |= {'peak': [[1.0] * 4] * 3, 'impulses': [[1.0] * 4] * 3}
    return Comparison(
        disturbance='actuator.lag',
        levels=(1.0, 2.0, 3.0),
        frictions=(),
        figures={
            name: np.array([values] * 3, float)[:, :, np.newaxis, :]
            for name, values in figures.items()
        },
    )


NEVER = float('nan')
SAME = [[0.0] * 4] * 3


def test_where_impulses_lose_is_said_level_by_level():
    lost = comparison([[1, 2, 1.5, 0], [NEVER, 2, NEVER, 0], [1, 1, 0.5, 0]], SAME)
    assert [lost.worse('settling', 0, 'impulses', other) for other in ('PD', 'PID')] == [[0], [1]]
    assert [lost.worse('residual', 0, 'impulses', other) for other in ('PD', 'PID')] == [[], []]
    assert lost.worse('settling', 0, 'supervised', 'PD') == []
    # who diverges loses, but not to one that does so too
    lost = comparison([[1.0] * 4] * 3, [[0, NEVER, NEVER, 0], [1, 0, 1, 0], [0, 0, 5e-6, 0]])
    assert [lost.worse('residual', 0, 'impulses', other) for other in ('PD', 'PID')] == [[0], [1]]


def test_a_loss_in_the_tail_alone_is_a_loss():
    lost = comparison([[1.0] * 4] * 3, SAME)
    lost.figures['settling'][2, 1, 0, 2] = NEVER
    assert lost.worse('settling', 0, 'impulses', 'PD') == [1]


def test_the_page_says_what_is_lost_and_where():
    lost = comparison([[1, 1, 2, 0], [1, 1, 2, 0], [2, 1, NEVER, 0]], SAME)
    lost = Comparison(**vars(lost) | {'disturbance': 'effort_limit'})
    lines = block('name', lost)
    assert lines[-2] == '* impulses settle later than PD at 1 to 3, than PID at 1 to 3.'
    assert lines[-1] == '* supervised impulses are at no level worse than PD or PID.'
    assert '| 3 | 2.000 | 1.000 | never | 0.000 | 0 | 0 | 0 | 0 |' in lines
    figure = picture(lost, 5.0)
    figure.draw_without_rendering()
    top = figure.axes[0].get_lines()
    assert max(line.get_ydata()[-1] for line in top if len(line.get_xdata()) == 3) == 10.0
