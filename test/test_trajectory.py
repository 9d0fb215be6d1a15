"""What Run, Solution and Recording share: signals of one shape, a table and a plot."""

import subprocess
import sys

import matplotlib as mpl
from matplotlib import pyplot
import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.hybrid import End, Reading, solve
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.plotting import MARKS
from test.processes import ROOT
from test.tools.bags import recorded

SIGNALS = ('position', 'velocity', 'effort', 'set_point')
PLANT, GAINS, DURATION = Plant(F_c=0.5), ControlGains(x_r=0.1), 0.6


@pytest.fixture(scope='module')
def motions(tmp_path_factory):
    """Return a simulated run, its recording and the exact solution of the same loop."""
    axis = {'F_c': 0.5, 'damping': PLANT.damping}
    bag, run = recorded(
        tmp_path_factory.mktemp('bag') / 'bag', 'underdamped', DURATION, axis, x_r=0.1
    )
    return {
        'run': run,
        'recording': read_bag(bag),
        'solution': solve(PLANT, GAINS, DURATION, reading=Reading.ONE_JUMP),
    }


@pytest.fixture
def backend():
    """Draw without a screen, and leave no figure open."""
    before = mpl.get_backend()
    mpl.use('Agg')
    yield
    pyplot.close('all')
    mpl.use(before)


@pytest.fixture(params=['run', 'recording', 'solution'])
def motion(request, motions):
    return motions[request.param]


def test_all_signals_have_the_shape_of_the_time(motion):
    assert motion.time[[0, -1]] == pytest.approx([0.0, DURATION])
    for name in SIGNALS:
        assert getattr(motion, name).shape == (6001,)
    assert motion.set_point.tolist() == [0.1] * 6001


def test_a_recording_has_the_signals_of_its_run_to_the_bit(motions):
    run, recording = motions['run'], motions['recording']
    for name in SIGNALS:
        assert np.array_equal(getattr(recording, name), getattr(run, name))
    for ours, theirs in zip(recording.impulse_samples(), run.impulse_samples(), strict=True):
        assert len(ours) == 5
        assert np.array_equal(ours, theirs)


def test_a_recorded_state_without_a_command_has_no_effort(tmp_path, motions):
    recording = motions['recording']
    cut = type(recording)(**{**vars_of(recording), 'commands': recording.commands[:-3]})
    assert np.flatnonzero(np.isnan(cut.effort)).tolist() == [5998, 5999, 6000]


def vars_of(recording):
    return {name: getattr(recording, name) for name in recording.__dataclass_fields__}


def test_a_solution_is_sampled_as_the_run_is_and_rests_until_the_duration(motions):
    exact = solve(PLANT, GAINS, 5.0)
    assert exact.end is End.ORIGIN
    run = simulate(PLANT, GAINS, 5.0)
    assert np.array_equal(exact.time, run.time)
    assert exact.position[-1] == 0.1
    assert exact.velocity[-1] == 0.0
    assert np.abs(exact.position - run.position).max() < 1e-2


def test_a_solution_that_ends_early_is_sampled_up_to_its_end():
    exact = solve(PLANT, GAINS, 5.0, event_limit=1)
    assert exact.end is End.EVENT_LIMIT
    assert exact.time[-1] == pytest.approx(exact.end_time, abs=PLANT.time_step)
    assert exact.time[-1] <= exact.end_time


def test_the_effort_of_a_solution_is_the_feedback(motions):
    exact = motions['solution']
    feedback = -GAINS.K * (exact.position - GAINS.x_r) - GAINS.D * exact.velocity
    assert np.array_equal(exact.effort, feedback)


def test_an_impulse_of_a_solution_changes_the_velocity_just_before_its_sample(motions):
    exact = motions['solution']
    index, guard = exact.impulse_samples()
    assert guard.tolist() == exact.events['guard'].tolist()
    late = exact.time[index] - exact.events['time']
    assert (late >= 0.0).all()
    assert (late <= PLANT.time_step).all()


def test_a_table_has_a_row_for_each_sample_and_the_units(motion):
    frame = motion.to_pandas()
    assert frame.index.name == 'time'
    assert np.array_equal(frame.index, motion.time)
    assert list(frame.columns) == [*SIGNALS, 'guard']
    for name in SIGNALS:
        assert np.array_equal(frame[name], getattr(motion, name))
    assert set(frame.attrs['units']) == {'time', *frame.columns}
    assert frame.attrs['units']['velocity'] == 'm/s'
    index, guard = motion.impulse_samples()
    assert list(frame['guard'].iloc[index]) == [GUARDS[one] for one in guard]
    assert (frame['guard'] != '').sum() == len(np.unique(index))


@pytest.mark.usefixtures('backend')
def test_a_plot_shows_the_signals_the_phase_portrait_and_each_impulse(motion):
    axes = motion.plot(label='with impulses')
    assert list(axes) == ['position', 'phase', 'velocity', 'effort']
    for name in ('position', 'velocity', 'effort'):
        line = axes[name].get_lines()[0]
        assert np.array_equal(line.get_xydata().T, [motion.time, getattr(motion, name)])
    guards = motion.impulse_samples()[1]
    for panel in axes.values():
        drawn = {line.get_label(): len(line.get_xdata()) for line in panel.get_lines()}
        for name, style in MARKS.items():
            count = np.count_nonzero(guards == GUARDS.index(name))
            assert drawn.get(style['label'], 0) == count
    said = [text.get_text() for text in axes['position'].get_legend().get_texts()]
    assert said[0] == 'with impulses'
    assert 'set-point' in said
    assert [axes[name].get_ylabel() for name in ('position', 'effort')] == [
        'position [m]',
        'effort [N]',
    ]
    axes['phase'].figure.canvas.draw()


@pytest.mark.usefixtures('backend')
def test_a_second_plot_is_drawn_into_the_axes_of_the_first(motions):
    axes = motions['run'].plot(label='sampled')
    assert motions['solution'].plot(axes, label='exact') == axes
    said = [text.get_text() for text in axes['position'].get_legend().get_texts()]
    assert {'sampled', 'exact'} <= set(said)
    assert len(said) == len(set(said))
    colors = {
        line.get_color()
        for line in axes['velocity'].get_lines()
        if line.get_label() in ('sampled', 'exact')
    }
    assert len(colors) == 2


@pytest.mark.parametrize(
    ('package', 'call'), [('matplotlib', 'plot()'), ('pandas', 'to_pandas()')]
)
def test_a_missing_package_is_named_with_the_extra_that_has_it(package, call):
    code = (
        f'import sys; sys.modules[{package!r}] = None\n'
        'import impulse_control_ros as ic\n'
        f'try: ic.simulate(ic.Plant(), ic.ControlGains(), 0.1).{call}\n'
        'except ic.errors.MissingPackageError as error: print(error)'
    )
    said = subprocess.run([sys.executable, '-c', code], cwd=ROOT, capture_output=True, text=True)
    assert said.stdout == (
        f"{package} is missing: pip install 'impulse_control_ros[analysis]'\n"
    ), said.stderr
