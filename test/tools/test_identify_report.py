"""The page of an identified axis in a real browser."""

import json

import numpy as np
import pyarrow as pa
from pyarrow import parquet
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.excitation import Limits
from impulse_control_ros.core.nonidealities import Sensor
from impulse_control_ros.core.plant import Plant
from test.chromium import needs_chromium
from test.command_lines import status_of
from test.excited import excited
from test.tools.chromium import Page

pytestmark = needs_chromium
AXIS = Plant(m=0.5, F_c=0.8, x_0=0.0, damping=Damping(value=2.0), sensor=Sensor(resolution=2e-5))


@pytest.fixture(scope='module')
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp('moved') / 'moved.parquet'
    moved = excited(AXIS, ControlGains(K=100.0, D=6.0), Limits(low=-0.2, high=0.2, speed=0.6))
    parquet.write_table(pa.table(moved.columns), path)
    return path


@pytest.fixture(scope='module')
def opened(browser, record):
    browser.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})
    path = record.with_name('axis.html')
    assert status_of('identify', record, '--report', path) == 0
    return Page(browser, path)


def test_the_page_loads_offline_without_a_request_or_an_error(opened, record):
    asked = [url for url in opened.requests() if not url.startswith(('data:', 'blob:', 'chrome:'))]
    assert asked == [record.with_name('axis.html').as_uri()]
    assert opened.browser.get_log('browser') == []


def test_the_last_third_is_shown_measured_and_simulated_with_the_residual(opened, record):
    table = parquet.read_table(record)
    time, position = table['time'].to_numpy(), table['position'].to_numpy()
    measured, simulated = opened.traces('validation')
    (residual,) = opened.traces('residual')
    assert [measured['name'], simulated['name']] == ['measured', 'simulated']
    for trace in (measured, simulated, residual):
        assert trace['x'][0] == pytest.approx(2 / 3 * time[-1], abs=0.01)
        assert trace['x'][-1] == pytest.approx(time[-1], abs=0.01)
    last = position[time >= 2 / 3 * time[-1]]
    assert max(measured['y']) == pytest.approx(last.max(), rel=1e-6)
    assert np.abs(residual['y']).max() < 0.02 * np.ptp(last)
    assert 'which the fit has not seen' in opened.run(
        'return document.getElementById("shown").textContent'
    )


def test_the_friction_d_and_the_sweep_are_drawn_with_what_was_found(opened, record, capsys):
    assert status_of('identify', record, '--format', 'json') == 0
    found = json.loads(capsys.readouterr().out)
    force, d = (found['parameters'][name]['value'] for name in ('F_c', 'd'))
    points, *lines = opened.traces('friction')
    assert len(points['x']) > 50
    for side, line in zip((1.0, -1.0), lines, strict=True):
        (_, speed), ends = line['x'], line['y']
        assert ends == pytest.approx([side * force, side * force + d * speed])
    (blocks,) = opened.traces('damping')
    assert blocks['y'] == pytest.approx(found['d_blocks']['d'], rel=1e-6)
    assert (
        opened.run('return document.getElementById("damping").layout.shapes[0].y0')
        == (found['d_bar'])
    )
    assert [one['name'] for one in opened.traces('sweep')] == ['m', 'd', 'F_c', 'offset']
    rows = opened.run(
        'return [...document.querySelectorAll("#figures tr")].map((row) => row.innerText)'
    )
    assert [row.split()[0] for row in rows] == ['parameter', 'm', 'd', 'F_c', 'offset']


def test_a_record_whose_first_part_does_not_identify_it_says_that_the_fit_has_seen_the_rest(
    browser, record
):
    table = parquet.read_table(record)
    time = table['time'].to_numpy()
    columns = {name: table[name].to_numpy().copy() for name in table.column_names}
    late = time < 2 / 3 * time[-1]
    columns['position'][late] = columns['position'][np.argmin(late)]  # at rest until then
    columns['velocity'][late] = columns['effort'][late] = 0.0
    parquet.write_table(pa.table(columns), record.with_name('late.parquet'))
    path = record.with_name('late.html')
    assert status_of('identify', record.with_name('late.parquet'), '--report', path) in (0, 1)
    page = Page(browser, path)
    assert 'which the fit has seen' in page.run(
        'return document.getElementById("shown").textContent'
    )
