"""The dashboard in a real browser, beside real nodes."""

from functools import partial
from http.client import HTTPConnection
import itertools
import json
import re
import socket
import sys
import time
from types import SimpleNamespace
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import build_opener, ProxyHandler, Request

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from sensor_msgs.msg import JointState

from impulse_control_ros.command_line import exit_status
from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.files.parameter_file import load_experiment
from impulse_control_ros.files.recording import read_bag
from impulse_control_ros.nodes.dashboard.command import main
from test.chromium import needs_chromium, open_chromium
from test.client import Client
from test.nodes.dashboard_page import Page, start_dashboard
from test.nodes.runs import UNDERDAMPED
from test.processes import Graph, wait_for

pytestmark = needs_chromium
PACED = {'duration': 0.0, 'real_time_factor': 0.05, 'wait_for_recorder': False}
DIRECT = build_opener(ProxyHandler({}))
LEARNT_MASS = re.compile(r'learnt mass(\S+) kg')
SHARED = re.compile(r'open http://(\S+):(\d+)/\?token=(\S+)')
PAUSED = re.compile(r'paused at (\d+\.\d+) s')


@pytest.fixture(scope='module')
def graph(tmp_path_factory):
    made = Graph(tmp_path_factory.mktemp('graph'))
    yield made
    made.close()


@pytest.fixture(scope='module')
def plant(graph):
    return graph.start('plant_simulator', config=UNDERDAMPED, **PACED)


@pytest.fixture(scope='module')
def controllers(graph, plant):
    """Return the controllers started, the present one last."""
    return [graph.start('controller', config=UNDERDAMPED)]


@pytest.fixture(scope='module')
def browser(tmp_path_factory):
    driver = open_chromium(tmp_path_factory.mktemp('profile'))
    yield driver
    driver.quit()


@pytest.fixture(scope='module')
def dashboard(graph, controllers):
    """Return the process of the dashboard in a list, its address and its port."""
    process, found = start_dashboard(graph, 7401 + 250 * graph.domain)  # free for a restart
    return [process], found[1], int(found[2])


@pytest.fixture(scope='module')
def page(browser, dashboard):
    made = Page(browser, dashboard[1])
    made.field('controller.K', '10')
    return made


def test_the_curves_move(page):
    began = page.time
    page.until('return Number(document.body.dataset.time) > arguments[0]', 'time', began + 0.05)
    assert len(set(page.column('samples', 'position'))) > 1
    page.until(
        "const {feedback} = Bokeh.documents[0].get_model_by_name('samples').data;"
        'return Number.isFinite(feedback.at(-1))',
        'the effort of the law',
    )


def test_a_refused_value_shows_the_reason_of_the_node(page):
    page.enter('controller.K', '-3')
    refused = page.until(
        "return document.getElementById('controller.K.refused').textContent", 'a refusal'
    )
    assert refused == 'invalid K = -3.0: must be > 0 [N/m]'
    page.enter('controller.K', '11')
    page.until(
        "return document.getElementById('controller.K.refused').textContent === ''", 'no refusal'
    )
    page.undo('K = 10.0')
    page.field('controller.K', '10')


def test_a_finding_on_the_gains_follows_the_values(page):
    page.enter('controller.D', '0.1')
    page.until(
        "return document.getElementById('findings').textContent.includes('D = 0.1 N s/m is not')",
        'a finding',
    )
    page.enter('controller.D', '0.5')
    page.until(
        "return !document.getElementById('findings').textContent.includes('D = 0.1')",
        'no such finding',
    )


def test_pause_step_and_reset_act(page):
    at = float(PAUSED.match(page.press('pause'))[1])
    page.until('return Number(document.body.dataset.time) >= arguments[0]', 'its last state', at)
    assert page.press('step').startswith('1 sample at ')
    page.until('return Number(document.body.dataset.time) > arguments[0]', 'one more', at)
    assert page.time == pytest.approx(at + 1e-4, abs=1e-9)
    assert 'x_0 = 0.5 m' in page.press('reset')
    page.press('step')
    page.until(
        "return Bokeh.documents[0].get_model_by_name('samples').data.position.slice(-2)"
        '.includes(0.5)',
        'the state after the reset',
    )
    assert page.press('resume').startswith('running at ')


def test_suspended_impulses_are_shown_with_the_reason_and_what_is_learnt(page):
    page.run("document.getElementById('controller.learn_mass').click()")
    page.enter('controller.m', '0.3')
    page.press('reset')
    page.until(
        "return [...document.querySelectorAll('#figures .warning td')].some((one) =>"
        "one.textContent.startsWith('answering, impulses suspended: jumps are '))",
        'a suspension',
    )
    told = LEARNT_MASS.search(page.text('figures'))
    assert float(told[1]) == pytest.approx(0.1, rel=0.01)
    assert {*page.run('return lastFrame.fired')} <= {*GUARDS[1:]}  # verdicts are no impulses
    page.undo('m = 0.1')
    page.field('controller.m', '0.1')
    page.undo('learn_mass = True')
    page.until(
        "return document.getElementById('controller.learn_mass').checked", 'the switch set back'
    )


def test_a_slider_changes_a_gain_in_the_recording_at_a_sample(graph, page, dashboard):
    page.browser.find_element(By.ID, 'record').click()
    page.until(
        "const told = document.getElementById('reports').textContent;"
        "return told.includes('recorders1') && told.includes('recorder /dashboard_recorder')",
        'a recorder',
    )
    slider = page.slider('controller.K')
    slider.send_keys(Keys.ARROW_RIGHT)
    page.until("return document.getElementById('controller.K').value !== '10'", 'another K')
    gain = float(page.value('controller.K'))
    assert gain > 10.0
    began = page.time
    page.until('return Number(document.body.dataset.time) > arguments[0]', 'time', began + 0.05)
    page.undo('K = 10.0')
    page.field('controller.K', '10')
    began = page.time
    page.until('return Number(document.body.dataset.time) > arguments[0]', 'time', began + 0.01)
    page.browser.find_element(By.ID, 'record').click()
    link = page.until("return document.querySelector('#recording a')?.href", 'a report')
    with DIRECT.open(link) as report:
        assert report.read().endswith(b'</html>\n')
    (bag,) = (graph.folder / 'runs').glob('dashboard_*[0-9]')
    run = read_bag(bag)
    changes = [one for one in run.changes if 'K' in one.changed]
    assert [one.changed['K'] for one in changes] == [gain, 10.0]
    stamps = set(run.states['stamp'].tolist())
    assert all(one.stamp in stamps for one in changes)


def test_the_running_values_are_saved_as_an_experiment_that_simulates(graph, page):
    page.run("document.getElementById('file').value = 'tuned.yaml'")
    page.run("document.getElementById('said').textContent = ''")
    page.browser.find_element(By.CSS_SELECTOR, '#save button').click()
    said = page.until("return document.getElementById('said').textContent", 'the answer')
    assert said == f'saved plant_simulator and controller to {graph.folder / "tuned.yaml"}'
    saved = load_experiment(graph.folder / 'tuned.yaml')
    assert (saved.gains.K, saved.plant.F_c, saved.plant.real_time_factor) == (10.0, 0.0, 0.05)
    for name, reason in (
        ('tuned.yaml', f'{graph.folder / "tuned.yaml"} exists: choose another name'),
        ('../x.yaml', "invalid file '../x.yaml': must be a NAME.yaml, without a folder"),
    ):
        page.run("document.getElementById('file').value = arguments[0]", name)
        page.browser.find_element(By.CSS_SELECTOR, '#save button').click()
        page.until(
            "return document.getElementById('said').textContent === arguments[0]", name, reason
        )


def test_a_killed_and_restarted_controller_is_there_again(graph, page, controllers):
    controllers[-1].kill()
    controllers.append(graph.start('controller', config=UNDERDAMPED, K=7.0))
    page.field('controller.K', '7')
    began = page.time
    page.until('return Number(document.body.dataset.time) > arguments[0]', 'time', began + 0.01)
    page.enter('controller.K', '10')
    page.field('controller.K', '10')


def test_the_page_fits_a_phone_and_is_reached_by_the_keyboard(page):
    page.browser.execute_cdp_cmd(
        'Emulation.setDeviceMetricsOverride',
        {'width': 390, 'height': 844, 'deviceScaleFactor': 1, 'mobile': True},
    )
    page.until('return document.documentElement.scrollWidth === 390', 'no scrolling sideways')
    page.browser.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})
    page.run("const h1 = document.querySelector('h1'); h1.tabIndex = -1; h1.focus()")
    reached = []
    for _ in range(8):
        ActionChains(page.browser).send_keys(Keys.TAB).perform()
        reached.append(
            page.run(
                'const one = document.activeElement, {name} = one.parentElement.dataset;'
                'return one.dataset.do || one.id || `${name} ${one.type}`'
            )
        )
    assert {'pause', 'step', 'controller.x_r', 'controller.x_r range'} <= {*reached}


def test_a_restarted_dashboard_is_connected_again_without_a_reload(graph, page, dashboard):
    processes, _, port = dashboard
    page.run("window.kept = 'yes'")
    assert processes[-1].interrupt() == 0
    page.until("return document.getElementById('connection').className === 'lost'", 'the loss')
    taken = graph.start('dashboard', '--no-browser', '--port', port)
    taken.says('open http')
    processes.append(taken)
    page.until("return document.getElementById('connection').textContent === 'connected'", 'it')
    began = page.time
    page.until('return Number(document.body.dataset.time) > arguments[0]', 'time', began)
    assert page.run('return window.kept') == 'yes'


@pytest.fixture(scope='module')
def others(graph, dashboard):
    """Return a dashboard on the port of the first, and one on all addresses."""
    return [
        graph.start('dashboard', '--no-browser', *options)
        for options in (('--port', dashboard[2]), ('--port', 0, '--host', '0.0.0.0'))
    ]


def test_a_port_in_use_is_refused_in_one_line(dashboard, others):
    assert others[0].wait() == 2
    assert others[0].output == (
        f'dashboard: --host 127.0.0.1 --port {dashboard[2]}: Address already in use\n'
    )


def test_a_missing_bokeh_is_named_with_the_command_that_installs_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'bokeh', None)
    assert exit_status('dashboard', partial(main, SimpleNamespace(requested=False))) == 1
    assert capsys.readouterr().err == (
        "dashboard: bokeh is missing: pip install 'impulse_control_ros[dashboard]', "
        'or pip install bokeh\n'
    )


def test_another_page_and_a_stranger_reach_nothing(dashboard, others):
    def status(address, **headers):
        request = Request(address, headers=headers)
        try:
            with DIRECT.open(request) as answer:
                return answer.status
        except HTTPError as error:
            return error.code

    _, address, port = dashboard
    assert status(address) == 200
    assert status(address, Host=f'evil.example:{port}') == 404
    upgrade = {
        'Connection': 'Upgrade',
        'Upgrade': 'websocket',
        'Sec-WebSocket-Version': '13',
        'Sec-WebSocket-Key': 'AAAAAAAAAAAAAAAAAAAAAA==',
    }
    for origin, expected in (('http://evil.example', 403), (address[:-1], 101)):
        connection = HTTPConnection('127.0.0.1', port)
        connection.request('GET', '/socket', headers=upgrade | {'Origin': origin})
        assert connection.getresponse().status == expected
        connection.close()
    assert status(f'{address}reports/dashboard_..%2f..%2fsecret.html') == 404
    others[1].says('?token=')
    host, at, token = SHARED.search(others[1].output).groups()
    assert host == socket.gethostname()
    address = f'http://127.0.0.1:{at}/'
    assert status(address) == 403
    assert status(f'{address}?token=wrong') == 403
    assert status(f'{address}socket') == 403
    assert status(f'{address}?token={token}') == 200
    assert status(f'{address}page.js', Cookie=f'dashboard_token={token}') == 200


def test_a_foreign_plant_and_controller_are_shown(graph, page, plant, controllers):
    for ours in (controllers[-1], plant):
        assert ours.interrupt() == 0
    client = Client(graph)
    states, commands = (
        client.node.create_publisher(JointState, topic, 10)
        for topic in ('joint_states', 'joint_commands')
    )
    ticks = itertools.count(1)

    def publish():
        message = JointState(name=['other', 'axis'], position=[9.0, 0.125], effort=[0.0, 2.5])
        message.header.stamp.sec = next(ticks)
        states.publish(message)
        commands.publish(message)
        time.sleep(0.02)

    try:
        wait_for(
            lambda: page.run(
                "const {position, effort} = Bokeh.documents[0].get_model_by_name('samples').data;"
                'return position.at(-1) === 0.125 && effort.at(-1) === 2.5'
                "&& document.getElementById('effort').textContent === 'Applied effort'"
            ),
            'the state of the axis',
            publish,
        )
    finally:
        client.close()
    assert 'learnt' not in page.text('figures')


def test_the_console_has_no_error_and_no_other_host_is_asked(page, dashboard):
    errors = [
        entry['message']
        for entry in page.browser.get_log('browser')
        if entry['level'] == 'SEVERE' and 'ERR_CONNECTION_REFUSED' not in entry['message']
    ]
    assert errors == []
    messages = [
        json.loads(entry['message'])['message'] for entry in page.browser.get_log('performance')
    ]
    asked = {
        urlsplit(message['params']['request']['url'])[:2]
        for message in messages
        if message['method'] == 'Network.requestWillBeSent'
    }
    assert {place for scheme, place in asked if scheme not in ('data', 'chrome')} == {
        f'127.0.0.1:{dashboard[2]}'
    }
