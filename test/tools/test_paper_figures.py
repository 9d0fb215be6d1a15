"""``paper_figures``: the files it writes, what it prints, and what it refuses."""

from importlib import import_module
import re
import struct
import subprocess
import sys

from matplotlib import rc_context
import numpy as np
import pytest

from impulse_control_ros.tools.figures import STYLE
from impulse_control_ros.tools.paper import command
from impulse_control_ros.tools.paper.document import caption, renewed, TITLES
from impulse_control_ros.tools.paper.drawing import draw, DRAWN
from test.command_lines import status_of
from test.conftest import BIN, ROOT

PAGE = (ROOT / 'docs' / command.PAGE).read_text()


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    """Return a folder with the figures, made by the installed command."""
    made = tmp_path_factory.mktemp('out') / 'new' / 'figures'
    said = subprocess.run(
        [str(BIN / 'paper_figures'), '--out', str(made)],
        check=True,
        capture_output=True,
        text=True,
    )
    (made / 'said').write_text(said.stdout)
    return made


def refused(capsys, *arguments):
    """Return the one line that the command refuses with."""
    assert status_of('paper_figures', *arguments) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert said.err.count('\n') == 1
    return said.err


def size_of(png):
    """Return width and height of a PNG."""
    assert png[:8] == b'\x89PNG\r\n\x1a\n'
    return struct.unpack('>II', png[16:24])


@pytest.mark.parametrize('figure', TITLES)
def test_each_figure_is_a_picture_and_a_page(folder, figure):
    width, height = size_of((folder / f'fig{figure}.png').read_bytes())
    assert width == 1800
    assert 500 < height < 1500
    page = (folder / f'fig{figure}.pdf').read_bytes()
    assert page.startswith(b'%PDF-')
    assert page.rstrip().endswith(b'%%EOF')
    assert 5_000 < len(page) < 500_000


def test_the_same_runs_give_the_same_bytes(folder, runs, claims, tmp_path):
    command.write_figures(tmp_path, runs, list(claims.values()))
    for made in tmp_path.iterdir():
        assert made.read_bytes() == (folder / made.name).read_bytes(), made.name
    assert len(list(tmp_path.iterdir())) == 10


def test_every_claim_is_printed_with_its_number(folder, claims):
    said = ' '.join((folder / 'said').read_text().split())
    for claim in claims.values():
        assert f'{claim.verdict} {claim.where}: {claim.says} {claim.numbers}' in said


@pytest.mark.parametrize('figure', TITLES)
def test_a_caption_states_each_claim_on_its_figure_with_our_number(runs, claims, figure):
    stated = [claim for claim in claims.values() if claim.figure == figure]
    text = caption(figure, list(claims.values()))
    assert stated
    for claim in stated:
        for part in (
            claim.says,
            f'Holds: {claim.verdict}',
            *(one.number for one in claim.measured),
        ):
            assert part in text
    with rc_context(STYLE):
        drawn = draw(figure, runs, text).texts[0].get_text()
    assert drawn.replace('\xa0', ' ').split() == text.split()


@pytest.mark.parametrize('figure', DRAWN)
def test_a_caption_stays_below_its_figure_and_within_its_width(runs, claims, figure):
    with rc_context(STYLE):
        drawn = draw(figure, runs, caption(figure, list(claims.values())))
        drawn.draw_without_rendering()
        box = drawn.texts[0].get_window_extent()
        lowest = min(axes.get_tightbbox().y0 for axes in drawn.axes)
    assert box.y0 >= 0.0
    assert box.x1 <= drawn.bbox.x1
    assert box.y1 <= lowest


def shown(runs, figure):
    """Return, for each axes of a figure with its insets, the lines as arrays of points."""
    with rc_context(STYLE):
        drawn = draw(figure, runs).axes
    return [
        [line.get_xydata() for line in axes.get_lines()]
        for axes in drawn + [inset for axes in drawn for inset in axes.child_axes]
    ]


def test_the_figures_show_what_was_run(runs):
    time, position, velocity = 'time', 'position', 'velocity'
    for figure, at, names, case in (
        (1, 0, (time, position), runs.pd_upper),
        (1, 1, (position, velocity), runs.pd_upper),
        (1, 0, (time, position), runs.pd_lower),
        (1, 1, (position, velocity), runs.pd_lower),
        (2, 0, (time, position), runs.pd_lower),
        (2, 2, (time, velocity), runs.pd_lower),
        (2, 0, (time, position), runs.impulses),
        (2, 2, (time, velocity), runs.impulses),
        (4, 0, (position, velocity), runs.varying),
        (4, 2, (time, position), runs.varying),
        (4, 1, (position, velocity), runs.pd_varying),
        (5, 0, (position, velocity), runs.coulomb),
        (5, 2, (position, velocity), runs.coulomb),
        (5, 0, (position, velocity), runs.pd_coulomb),
    ):
        points = np.column_stack([getattr(case.run, name) for name in names])
        assert any(np.array_equal(line, points) for line in shown(runs, figure)[at]), (figure, at)


def test_fig_3_shows_the_damping_and_its_bounds(runs):
    damping, upper, lower = shown(runs, 3)[0]
    assert np.array_equal(damping[:, 1], runs.varying.run.damping)
    assert (set(upper[:, 1]), set(lower[:, 1])) == ({1.5}, {0.15})


def test_fig_5_shows_the_dead_zone_and_falls_to_a_floor_at_each_time_step(runs):
    plane, error, _ = shown(runs, 5)
    assert plane[0].tolist() == [[-0.1, 0.0], [0.1, 0.0]]
    ends = sorted(line[-1, 1] for line in error)
    assert ends[:4] == pytest.approx([1.0e-6, 1.34e-5, 1.34e-4, 1.34e-3], rel=0.04)


def test_the_page_on_the_paper_is_up_to_date(claims):
    assert renewed(PAGE, list(claims.values())) == PAGE, 'run: paper_figures --docs docs'


def test_the_page_is_renewed_below_its_marker_alone(runs, claims, tmp_path):
    claims = list(claims.values())
    for room in ('concepts', 'images'):
        (tmp_path / room).mkdir()
    (tmp_path / command.PAGE).write_text('By hand.\n\n' + PAGE[PAGE.index('<!--') :] + 'stale\n')
    command.write_docs(tmp_path, runs, claims)
    assert (tmp_path / command.PAGE).read_text() == 'By hand.\n\n' + PAGE[PAGE.index('<!--') :]
    assert {path.name for path in tmp_path.glob('images/*.png')} == {f'fig{n}.png' for n in TITLES}


@pytest.mark.parametrize('figure', TITLES)
def test_the_page_shows_each_figure_in_a_small_picture(figure):
    assert f'](../images/fig{figure}.png)' in PAGE
    picture = (ROOT / 'docs' / command.PICTURES / f'fig{figure}.png').read_bytes()
    assert size_of(picture)[0] == 1080
    assert len(picture) < 150_000


def test_every_equation_has_a_function_and_a_test_that_exist():
    rows = re.findall(r'^\| .+ \| `([\w.]+)` \| `([\w/]+\.py)::(\w+)` \|$', PAGE, re.M)
    table = PAGE.partition('| equation |')[2].partition('\n\n')[0]
    assert len(rows) == table.count('\n') - 1 > 10
    for function, path, test in rows:
        module, _, name = function.rpartition('.')
        assert callable(getattr(import_module(f'impulse_control_ros.{module}'), name))
        assert f'\ndef {test}(' in (ROOT / 'test' / path).read_text(), test


def test_a_wrong_option_is_refused_in_one_line(capsys):
    assert '--bold' in refused(capsys, '--bold')
    assert 'not allowed with' in refused(capsys, '--out', 'a', '--docs', 'b')


def test_a_folder_that_cannot_be_made_is_refused_by_name(capsys, tmp_path):
    (tmp_path / 'taken').touch()
    for folder in ('taken', 'taken/below'):
        assert f'--out {tmp_path / folder}: ' in refused(capsys, '--out', tmp_path / folder)


def test_a_file_that_cannot_be_written_is_refused_by_name(monkeypatch, capsys, tmp_path, runs):
    (tmp_path / 'fig1.png').mkdir()
    monkeypatch.setattr('impulse_control_ros.tools.paper.runs.paper_runs', lambda: runs)
    assert status_of('paper_figures', '--out', tmp_path) == 2
    assert capsys.readouterr().err == f'paper_figures: {tmp_path / "fig1.png"}: Is a directory\n'


def test_a_folder_without_the_page_is_refused_by_name(capsys, tmp_path):
    assert f'{tmp_path}: there is no concepts/paper.md' in refused(capsys, '--docs', tmp_path)


def test_without_matplotlib_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setattr(command, 'find_spec', lambda name: None)
    assert "pip install 'impulse_control_ros[analysis]'" in refused(capsys)


def test_ctrl_c_is_answered_in_one_line(tmp_path):
    code = """
import signal, sys
from impulse_control_ros.command_line import paper_figures
from impulse_control_ros.tools.paper import runs
runs.paper_runs = lambda: signal.raise_signal(signal.SIGINT)
sys.exit(paper_figures())
"""
    said = subprocess.run(
        [sys.executable, '-c', code, '--out', str(tmp_path)],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (said.returncode, said.stdout) == (1, '')
    assert said.stderr == 'interrupted\n'
    assert list(tmp_path.iterdir()) == []
