"""The summary and the pictures: every study has them, and nothing is left out silently."""

import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.distributions import distribution_of
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.sweep_config import Extent, run_chunk, SweepConfig
from impulse_control_ros.tools.sweep_pictures import picture, save_pictures, span
from impulse_control_ros.tools.sweep_summary import quantiles, summary

DRAWN = {'x_0': {'uniform': [0.1, 0.5]}}
STUDIES = {
    'drawn': (DRAWN, 200),
    'one run': ({'x_0': {'choice': [0.5]}}, 1),
    'all diverge': ({'K': {'log_uniform': [1e9, 1e10]}, 'impulses': {'choice': [False]}}, 40),
    'some diverge': ({'K': {'choice': [10.0, 1e9]}, 'impulses': {'choice': [False]}}, 40),
    'numbers': ({'F_c': {'grid': [0.0, 2.0, 9]}, **DRAWN}, 5),
    'log numbers': ({'K': {'log_grid': [1.0, 1e9, 9]}}, 1),
    'words': ({'damping.kind': {'values': ['constant', 'noise', 'sinusoidal']}, **DRAWN}, 5),
    'switch': ({'impulses': {'values': [True, False]}}, 1),
    'map': ({'F_c': {'grid': [0.0, 2.0, 9]}, 'K': {'log_grid': [1.0, 1e9, 13]}, **DRAWN}, 3),
    'small map': ({'impulses': {'values': [True]}, 'c': {'values': [1, 2]}}, 1),
    'three axes': (
        {
            'impulses': {'values': [True, False]},
            'c': {'values': [1, 2]},
            'K': {'grid': [5.0, 15.0, 3]},
            **DRAWN,
        },
        5,
    ),
}


def run(name, duration=0.3):
    """Return a study of `STUDIES` and its columns."""
    vary, runs = STUDIES[name]
    study = SweepConfig(
        axis=Plant(damping=Damping(upper=1.5)),
        controller=ControlGains(),
        extent=Extent(runs=runs, duration=duration),
        vary={key: distribution_of(key, law) for key, law in vary.items()},
    )
    chunks = [run_chunk(study, number) for number in range(study.chunks)]
    return study, lambda column: np.concatenate([chunk[column] for chunk in chunks])


@pytest.mark.parametrize('name', STUDIES)
def test_every_study_has_a_panel_and_a_line_for_each_figure_with_its_unit(name):
    study, column = run(name)
    figure = picture(study, column, name)
    figure.draw_without_rendering()
    panels = [axes for axes in figure.axes if axes.get_label() != '<colorbar>']
    said = [axes.get_title() + axes.get_xlabel() + axes.get_ylabel() for axes in panels]
    for text in (
        'settling time to 0.01 m [s]',
        'settling time to 0.001 m [s]',
        'overshoot [m]',
        'IAE [m s]',
        'impulse area [N s]',
        'peak effort [N]',
        'peak velocity [m/s]',
        'abs(final error) [m]',
    ):
        assert sum(text in words for words in said) == 1, text
    assert len(panels) == 9
    assert name in figure.get_suptitle()
    lines = summary(study, column).splitlines()
    assert lines[0].split() == ['median', 'p5', 'p95', 'max']
    assert len(lines) == 1 + 9 + 3


def test_runs_that_diverge_or_never_settle_are_said():
    study, column = run('some diverge')
    text = summary(study, column)
    share = 100.0 * column('diverged').mean()
    assert 0.0 < share < 100.0
    assert f'diverged: {share:.3g} %' in text
    assert 'not settled to 0.01 m: 100 %' in text
    assert text.splitlines()[1].split()[-4:] == ['never'] * 4
    titles = [axes.get_title() for axes in picture(study, column, 'x').axes]
    assert '100 % of the runs never settle' in titles
    assert f'{share:.3g} % of the runs diverge' in titles


def test_a_picture_is_saved_the_same_again(tmp_path):
    study, column = run('switch')
    paths = save_pictures(study, column, tmp_path, 'switch')
    assert [path.name for path in paths] == ['figures.png', 'figures.pdf']
    first = [path.read_bytes() for path in paths]
    again = save_pictures(study, column, tmp_path, 'switch')
    assert [path.read_bytes() for path in again] == first
    assert len(list(tmp_path.iterdir())) == 2


def test_quantiles_are_values_and_nan_is_the_largest():
    values = np.array([3.0, np.nan, 1.0, 2.0])
    assert quantiles(values, (0.0, 0.25, 0.5, 0.75)).tolist() == [1.0, 1.0, 2.0, 3.0]
    assert np.isnan(quantiles(values, (0.76, 1.0))).all()
    table = np.array([[1.0, 2.0], [np.nan, np.nan]])
    assert np.array_equal(quantiles(table, (0.5,)), [[1.0, np.nan]], equal_nan=True)


def test_a_few_values_far_out_do_not_set_the_scale():
    regular = np.linspace(1.0, 2.0, 1000)
    assert span(regular) == (1.0, 2.0, False)
    assert span(np.append(regular, [1e90, 1e95])) == (1.0, 2.0, False)
    assert span(np.geomspace(1e-6, 1.0, 100)) == (1e-6, 1.0, True)
    assert span(np.zeros(3)) == (0.0, 0.0, False)


def test_a_heat_map_tells_zero_from_what_is_not_there():
    study, column = run('map')
    axes = next(
        axes
        for axes in picture(study, column, 'map').axes
        if axes.get_title().startswith('overshoot')
    )
    image = axes.images[0]
    middle = quantiles(column('overshoot').reshape(9, 13, 3), (0.5,))[0]
    assert (middle == 0.0).any()
    assert np.isnan(middle).any()
    assert np.array_equal(image.norm(image.get_array()).mask, np.isnan(middle))
