"""The study of random axes: where its laws are, and its table."""

import numpy as np

from impulse_control_ros.core.sweep_config import varied
from impulse_control_ros.files.sweep_config_file import read_study
from scripts.supervised_axes import LAWS, STUDY, table, worst
from test.conftest import ROOT

SWITCHES = ('controller.impulses', 'supervision', 'learn_mass')


def test_each_law_is_where_the_study_runs_it():
    study = read_study(ROOT / STUDY)
    runs = study.extent.runs
    values = varied(study, range(8 * runs))
    told = {
        law: [bool(values[name][place * runs]) for name in SWITCHES] for law, place in LAWS.items()
    }
    assert told['PD'][0] is False
    assert told['impulses'][:2] == [True, False]
    assert told['supervised, mass not learnt'] == [True, True, False]
    assert told['supervised'] == [True, True, True]


def test_the_table_has_the_range_of_the_seeds_and_the_worst_come_first():
    shape = (8, 4)
    one = {
        'settling': np.tile([1.0, 2.0, 3.0, np.nan], (8, 1)),
        'overshoot': np.tile([0.0, 0.4, 0.1, 0.2], (8, 1)),
        'at rest': np.ones(shape),
        'diverged': np.zeros(shape, bool),
    }
    other = one | {'settling': np.tile([1.0, 1.5, 3.0, 4.0], (8, 1))}
    assert table([one, other])[2] == '| PD | 0 to 25 | 1.5 to 2 | 0.4 | 0.4 | 1 | 0 |'
    lines = worst(one)
    assert [int(line.split(':')[0]) for line in lines] == [3, 2, 1, 0, 1, 3, 2, 0]
