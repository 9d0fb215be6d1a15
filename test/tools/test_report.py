"""The report in a real browser: headless Chromium, driven by selenium."""

from pathlib import Path
import subprocess

import numpy as np
import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.cdr import JointStateLayout
from impulse_control_ros.tools.analyze.packing import on_grid
from test.chromium import needs_chromium
from test.command_lines import status_of
from test.conftest import BIN
from test.tools.bags import (
    begun,
    CONTROLLER,
    entries,
    experiment,
    finished,
    recorded,
    recorded_elsewhere,
    sent,
    STATES,
    told,
)
from test.tools.chromium import Page, PATIENCE

RUNS = ('pd_only_lower', 'underdamped', 'time_varying', 'coulomb')

pytestmark = needs_chromium


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Return the bags by name, and what was simulated."""
    folder = tmp_path_factory.mktemp('bags')
    return {name: recorded(folder / name, name) for name in RUNS}


@pytest.fixture(scope='module')
def page(tmp_path_factory, bags):
    path = tmp_path_factory.mktemp('page') / 'report.html'
    assert status_of('analyze', *(bag for bag, _ in bags.values()), '--report', path) == 0
    return path


@pytest.fixture
def opened(browser, page):
    browser.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})
    return Page(browser, page)


def test_it_loads_offline_without_a_request_or_an_error(opened, page):
    asked = [
        url
        for url in opened.requests()  # chrome: is what the browser shows before
        if not url.startswith(('data:', 'blob:', 'chrome:'))
    ]
    assert asked == [page.as_uri()]
    assert opened.browser.get_log('browser') == []
    assert 'http' not in opened.run(
        'return [...document.querySelectorAll("[src], [href]")].map('
        '(one) => one.getAttribute("src") ?? one.getAttribute("href")).join(" ")'
    )


def test_every_plot_has_every_run_and_its_impulses(opened, bags):
    for key in ('position', 'velocity', 'feedback', 'impulse'):
        assert [
            one['name'] for one in opened.traces('time', meta=key) if one['name'] in RUNS
        ] == list(RUNS)
    assert [one['name'] for one in opened.traces('time', meta='damping') if one['x']] == [
        'time_varying'
    ]
    for plot in ('phase', 'near'):
        names = [one['name'] for one in opened.traces(plot)]
        assert [name for name in names if name in RUNS] == list(RUNS)
        assert names.count('position_zero') == 2
        assert names.count('velocity_zero') == 3
    for _, run in bags.values():
        fired = run.events['tick']
        assert set(
            opened.run(
                'return runs.map((run) => Object.values(run.fired).reduce('
                '(sum, one) => sum + one.length, 0))'
            )
        ) >= {len(fired)}


def test_every_peak_is_drawn_however_far_out(opened, bags):
    for name, (_, run) in bags.items():
        for key, values in (('position', run.position), ('velocity', run.velocity)):
            (drawn,) = opened.traces('time', meta=key, name=name)
            assert max(drawn['y']) == pytest.approx(values.max(), rel=1e-6)
            assert min(drawn['y']) == pytest.approx(values.min(), rel=1e-6)
    # each impulse of a cascade of single samples stands out of the thinned line, or is in the
    # same pixel as a larger one
    width = opened.run('return bins("time")')
    (drawn,) = opened.traces('time', meta='impulse', name='underdamped')
    run = bags['underdamped'][1]
    span = opened.run('return document.getElementById("time").layout.xaxis.range')
    pixel = (span[1] - span[0]) / width
    for tick, area in zip(run.events['tick'], run.events['area'], strict=True):
        near = [
            abs(y)
            for x, y in zip(drawn['x'], drawn['y'], strict=True)
            if abs(x - run.time[tick]) <= pixel
        ]
        assert max(near) >= 0.99 * abs(area) / 1e-4


def test_every_impulse_is_marked_in_the_phase_plane(opened, bags):
    width, height = opened.run(
        'return [bins("phase"), document.getElementById("phase").clientHeight - TOP - BOTTOM]'
    )
    x_range, y_range = opened.run(
        'const {xaxis, yaxis} = document.getElementById("phase").layout;'
        'return [xaxis.range, yaxis.range]'
    )
    pixel = (x_range[1] - x_range[0]) / width, (y_range[1] - y_range[0]) / height
    for name, guard in (('underdamped', 1), ('time_varying', 1), ('coulomb', 2)):
        events = bags[name][1].events
        marks = [
            (x, y)
            for one in opened.traces('phase', name=GUARDS[guard])
            for x, y in zip(one['x'][::3], one['y'][::3], strict=True)
        ]
        for event in events[events['guard'] == guard][:500]:
            assert (
                min(
                    max(
                        abs(x - event['position']) / pixel[0],
                        abs(y - event['velocity']) / pixel[1],
                    )
                    for x, y in marks
                )
                < 1.01
            )


def test_zooming_in_shows_the_raw_samples(opened, bags):
    run = bags['underdamped'][1]
    assert 'least and the largest' in opened.run(
        'return document.getElementById("shown").textContent'
    )
    opened.zoom('time', xaxis_range=[0.12, 0.13])
    assert 'All' in opened.run('return document.getElementById("shown").textContent')
    inside = np.flatnonzero((run.time >= 0.12) & (run.time <= 0.13))
    for key, values in (('position', run.position), ('velocity', run.velocity)):
        (drawn,) = opened.traces('time', meta=key, name='underdamped')
        got = [(x, y) for x, y in zip(drawn['x'], drawn['y'], strict=True) if 0.12 <= x <= 0.13]
        assert len(got) == len(inside) == 101
        assert [x for x, _ in got] == pytest.approx(run.time[inside], abs=1e-12)
        assert [y for _, y in got] == pytest.approx(values[inside], rel=1e-6, abs=1e-30)
        assert drawn['mode'] == 'lines+markers'
    (drawn,) = opened.traces('time', meta='impulse', name='underdamped')
    fired = run.events['tick'][run.events['tick'] >= 1200]
    efforts = dict(zip(drawn['x'], drawn['y'], strict=True))
    assert np.count_nonzero(drawn['y']) == len(fired) == 10
    assert min(map(abs, filter(None, efforts.values()))) == pytest.approx(
        np.abs(run.events['area'][1:]).min() / 1e-4, rel=1e-5
    )


def test_a_phase_plane_zoomed_in_shows_the_raw_samples(opened, bags):
    run = bags['underdamped'][1]
    box = [-2e-4, 1e-4], [-4.0, 1.0]
    opened.zoom('near', xaxis_range=box[0], yaxis_range=box[1])
    (drawn,) = opened.traces('near', name='underdamped')
    inside = [
        (x, y)
        for x, y in zip(run.position, run.velocity, strict=True)
        if box[0][0] <= x <= box[0][1] and box[1][0] <= y <= box[1][1]
    ]
    points = [(x, y) for x, y in zip(drawn['x'], drawn['y'], strict=True) if x is not None]
    for x, y in inside:
        assert min(max(abs(a - x) / 3e-4, abs(b - y) / 5.0) for a, b in points) < 1 / 300
    assert len(points) < len(run.time) / 10


def test_a_drag_zooms_and_a_double_click_shows_all_again(opened):
    layer = opened.browser.find_element(By.CSS_SELECTOR, '#time .nsewdrag')
    before = opened.run('return document.getElementById("time").layout.xaxis.range')
    ActionChains(opened.browser).move_to_element_with_offset(
        layer, -100, 0
    ).click_and_hold().move_by_offset(150, 0).release().perform()
    opened.until(
        'const [a, b] = document.getElementById("time").layout.xaxis.range; '
        'return b - a < 0.5 * (arguments[0][1] - arguments[0][0])',
        before,
    )
    drawn = opened.traces('time', meta='position', name='underdamped')[0]['x']
    low, high = opened.run('return document.getElementById("time").layout.xaxis.range')
    assert max(np.diff(drawn)) < 2.5 * (high - low) / opened.run('return bins("time")')

    def shows_all(browser):
        # clicks more than 0.3 s apart, on a busy machine, are no double click
        ActionChains(browser).move_to_element(layer).double_click().perform()
        return opened.run('return document.getElementById("time").layout.xaxis.range') == before

    WebDriverWait(opened.browser, PATIENCE).until(shows_all)


def test_impulses_that_failed_and_suspensions_are_marked_and_can_be_hidden(browser, tmp_path):
    bag, run = recorded(tmp_path / 'light', 'underdamped', 1.5, {'m': 0.048}, learn_mass=False)
    assert status_of('analyze', bag, '--report', tmp_path / 'page.html') == 0
    opened = Page(browser, tmp_path / 'page.html')
    (crosses,) = opened.traces('time', name='failed', meta='position')
    fired, judged = run.time[run.events['tick']], run.time[run.verdicts['tick']]
    assert crosses['x'] == pytest.approx([fired[fired < one][-1] for one in judged])
    shapes = 'return document.getElementById("time").layout.shapes.map((one) => [one.x0, one.x1])'
    (first, *_) = opened.run(shapes)
    assert first == pytest.approx([judged[1], judged[1] + 1.0])
    opened.click('failed')
    opened.click('suspended')
    assert opened.traces('time', name='failed') == opened.run(shapes) == []


def test_the_legend_hides_a_run_and_a_guard_in_every_plot(opened):
    opened.click('underdamped')
    opened.click('velocity_zero')
    for plot in ('time', 'phase', 'near'):
        names = {one['name'] for one in opened.traces(plot)}
        assert names.isdisjoint({'underdamped', 'velocity_zero'})
        assert names >= {'pd_only_lower', 'position_zero'}
    pressed = 'return document.querySelector(\'[data-name="underdamped"]\').ariaPressed'
    assert opened.run(pressed) == 'false'
    opened.click('underdamped')
    assert opened.run(pressed) == 'true'
    assert opened.traces('phase', name='underdamped')


@pytest.mark.parametrize('width', [390, 1280])
def test_nothing_is_wider_than_the_window(opened, width):
    opened.browser.execute_cdp_cmd(
        'Emulation.setDeviceMetricsOverride',
        {'width': width, 'height': 844, 'deviceScaleFactor': 1, 'mobile': width < 600},
    )
    opened.until(
        'return innerWidth === arguments[0] && ["time", "phase", "near"].every((id) => '
        'document.querySelector(`#${id} .main-svg`).clientWidth '
        '<= document.getElementById(id).clientWidth)',
        width,
    )
    assert opened.run('return document.documentElement.scrollWidth') <= width
    tops = opened.run(
        'return [...document.querySelectorAll("h2, .plot, table")].map('
        '(one) => [one.getBoundingClientRect().top, one.offsetHeight])'
    )
    assert all(height > 10 for _, height in tops)
    cells = (
        'const row = [...document.querySelector("#parameters .differs").cells].map('
        '(one) => one.getBoundingClientRect());'
    )
    assert opened.run(f'{cells} return row[2].right') <= width
    assert opened.run(
        'document.querySelector("#parameters").parentElement.scrollLeft = 1000;'
        f'{cells} return row[0].left >= 0 && row.at(-1).right <= innerWidth'
    )


def test_the_tables_hold_the_figures_the_parameters_and_where_they_are_from(opened):
    text = {
        name: opened.run('return document.getElementById(arguments[0]).innerText', name)
        for name in ('figures', 'parameters', 'provenance')
    }
    assert '0.1186' in text['figures']
    assert 'never' in text['figures'] or '1.7893' in text['figures']
    for name in ('alpha_ratio', '/controller', '/plant_simulator', 'damping.kind'):
        assert name in text['parameters']
    assert 'impulse_control_ros 0.1.0' in text['provenance']
    differs = opened.run(
        'return [...document.querySelectorAll("#parameters .differs")].map('
        '(row) => row.cells[0].textContent)'
    )
    assert 'impulses' in differs
    assert 'K' not in differs


def test_no_button_sends_the_data_anywhere(opened):
    titles = opened.run(
        'return [...document.querySelectorAll(".modebar-btn")].map((one) => one.dataset.title)'
    )
    assert len(titles) == 3 * 6
    assert not [title for title in titles if 'loud' in title or 'hart' in title]


def test_a_set_point_change_and_a_strange_name_are_shown_as_they_are(browser, tmp_path):
    made = experiment('underdamped')
    run = simulate(made.plant, made.gains, 0.2)
    writer = begun(tmp_path / '<b>&run', made)
    writer.write(entries(run))
    writer.write([told(CONTROLLER, {**made.gains.flat(), 'x_r': 0.25}, ['x_r'], 1000)])
    finished(writer)
    path = tmp_path / 'report.html'
    assert status_of('analyze', tmp_path / '<b>&run', '--report', path) == 0
    opened = Page(browser, path)
    assert browser.find_element(By.CSS_SELECTOR, '#legend button').text == '<b>&run'
    (line,) = opened.traces('time', meta='setpoint')
    steps = dict(zip(line['x'], line['y'], strict=True))
    assert steps[0.1] == 0.25
    assert opened.run('return runs[0].error[1000]') == pytest.approx(
        run.position[1000] - 0.25, rel=1e-6
    )
    assert 'from 0.1 s on' in opened.run('return document.getElementById("parameters").innerText')


def test_a_bag_without_velocities_shows_none(browser, tmp_path):
    layout = JointStateLayout('axis', 'base', ('position',))
    bag = recorded_elsewhere(
        tmp_path / 'bag',
        sent((0, STATES, layout.encode(1, k * 10**6, 0.5 - 0.005 * k)) for k in range(100)),
    )
    path = tmp_path / 'report.html'
    assert status_of('analyze', bag, '--report', path) == 0
    opened = Page(browser, path)
    drawn = {one['meta'] for one in opened.traces('time')}
    assert drawn == {'position', 'setpoint', 'impulse'}
    assert opened.run('return document.querySelectorAll(".phase").length') == 0
    opened.click('bag')
    assert opened.browser.get_log('browser') == []


def test_a_minute_at_10_khz_stays_below_10_mb_even_as_noise(browser, tmp_path):
    made = experiment('time_varying')
    run = simulate(made.plant, made.gains, 60.0)
    noise = np.random.default_rng(1).normal(size=(2, len(run.time)))
    gains, is_impulse = made.gains, np.zeros(len(run.time), bool)
    is_impulse[run.events['tick']] = True
    impulse = np.where(is_impulse, run.effort + gains.K * run.position + gains.D * run.velocity, 0)
    for name, values in (('position', 1e-3 * noise[0]), ('velocity', 1e-2 * noise[1])):
        getattr(run, name)[:] += values
    run.effort[:] = -gains.K * run.position - gains.D * run.velocity + impulse
    writer = begun(tmp_path / 'minute', made)
    writer.write(entries(run))
    finished(writer)
    path = tmp_path / 'report.html'
    assert status_of('analyze', tmp_path / 'minute', '--report', path) == 0
    assert path.stat().st_size < 10e6
    opened = Page(browser, path)
    assert opened.run('return runs[0].count') == 600_001
    opened.zoom('time', xaxis_range=[30.0, 30.01])
    (drawn,) = opened.traces('time', meta='position', name='minute')
    inside = [y for x, y in zip(drawn['x'], drawn['y'], strict=True) if 30.0 <= x <= 30.01]
    assert inside == pytest.approx(run.position[300_000:300_101], rel=1e-6, abs=1e-9)


def test_times_are_packed_to_the_nanosecond_where_they_fit():
    even = np.arange(1000) * 100_000
    assert (on_grid(even)[0][-1], on_grid(even)[1]) == (999, 100_000)
    odd = np.array([0, 7, 4_000_000_000])
    assert (on_grid(odd)[0].tolist(), on_grid(odd)[1]) == (odd.tolist(), 1)
    long = np.array([0, 7, 600_000_000_000])
    ticks, unit = on_grid(long)
    assert ticks.max() < 2**32
    assert np.abs(ticks * unit - long).max() < unit < 200


def test_the_same_bags_give_the_same_report(page, bags, tmp_path):
    again = tmp_path / 'again.html'
    subprocess.run(
        [BIN / 'analyze', *(bag for bag, _ in bags.values()), '--report', again],
        check=True,
        capture_output=True,
    )
    assert again.read_bytes() == Path(page).read_bytes()
