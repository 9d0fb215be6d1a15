"""
The commands of README and docs/ros.md, run as they say.

colcon build, then the executables where ros2 run looks, or on a bare machine those of .venv.

``ros2 run``, ``param``, ``topic pub`` and ``service call`` are carried out as those verbs do
(execute the installed file; use the node's services and topics): ros2cli is not on PyPI.
"""

from importlib import import_module
from importlib.metadata import requires
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import yaml

from impulse_control_ros.files.recording import read_bag
from test.conftest import BIN, ROOT, wait_for

README, NODES_PAGE = ((ROOT / name).read_text() for name in ('README.md', 'docs/ros.md'))
PAGES = [ROOT / 'README.md', *ROOT.glob('docs/*.md'), *ROOT.glob('[be]*/**/README.md')]
FENCES = re.findall(r'^```(\w*)\n(.*?)^```', README + NODES_PAGE, re.S | re.M)
COMMANDS = [
    line
    for language, block in FENCES
    if language == 'bash'
    for line in block.splitlines()
    if not line.startswith('#')
]
PACKAGE = 'impulse_control_ros'
RUN = f'ros2 run {PACKAGE} '
NODES = ('plant_simulator', 'controller', 'recorder')
VERBS = ('param', 'topic', 'service')


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a workspace with what git tracks, built by the README's colcon command."""
    folder = tmp_path_factory.mktemp('workspace')
    tracked = subprocess.run(
        ['git', 'ls-files', '-co', '--exclude-standard'],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split('\n')
    for name in filter(None, tracked):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)
    assert 'colcon build' in COMMANDS
    built = subprocess.run(
        [str(BIN / 'colcon'), 'build'],
        cwd=folder,
        capture_output=True,
        text=True,
        env=colcon_environment(),
        check=False,
    )
    assert built.returncode == 0, built.stderr
    return folder


def sourced(workspace):
    """Return the environment after ``source install/setup.bash``."""
    assert 'source install/setup.bash' in COMMANDS
    said = subprocess.run(
        ['bash', '-c', 'source install/setup.bash && env -0'],
        cwd=workspace,
        env=colcon_environment(),
        check=True,
        capture_output=True,
        text=True,
    )
    return dict(line.split('=', 1) for line in said.stdout.split('\0') if line)


def colcon_environment():
    path = f'{BIN}{os.pathsep}{os.environ["PATH"]}'
    return os.environ | {'PATH': path, 'AMENT_PREFIX_PATH': sys.prefix}


class Shell:
    """Carries out the README's lines in the built workspace."""

    def __init__(self, graph, client, workspace):
        self.graph, self.client = graph, client
        graph.environment = sourced(workspace)
        self._prefix = workspace / 'install' / PACKAGE
        self._config = workspace / 'config'
        self.outcomes = []

    def run(self, line):
        words = [word.strip('"') for word in re.findall(r'"[^"]*"|\S+', line)]
        verb = '_'.join(words[1:3]) if words[1] in VERBS else words[1]
        outcome = getattr(self, verb)(*words[3:] if '_' in verb else words[2:])
        self.outcomes.append(outcome)
        return outcome

    def start(self, line):
        words = line.split()
        assert words[:3] == ['ros2', 'run', PACKAGE]
        arguments = [
            str(self._config / word.removeprefix('config/'))
            if word.startswith('config/')
            else word.replace('runs/', f'{self.graph.folder}/')
            for word in words[4:]
        ]
        return self.graph.start(words[3], *arguments, bin_folder=self._prefix / 'lib' / PACKAGE)

    def param_set(self, node, name, value):
        result = self.client.set(node.strip('/'), **{name: yaml.safe_load(value)})
        assert result.successful, result.reason
        return name

    def param_get(self, node, name):
        return self.client.get(node.strip('/'), name)[0]

    def topic_pub(self, once, topic, kind, content):
        assert once == '--once'
        package, _, name = kind.split('/')
        message = getattr(import_module(f'{package}.msg'), name)
        publisher = self.client.node.create_publisher(message, topic, 10)

        def matched():
            ends = self.client.node.get_subscriptions_info_by_topic(topic)
            return 'controller' in [end.node_name for end in ends] and (
                publisher.get_subscription_count() >= len(ends)
            )

        # the recorder may be matched before the controller is
        self.client.spin_until(matched, f'the subscribers of {topic}')
        publisher.publish(message(**yaml.safe_load(content)))
        return topic

    def service_call(self, service, kind, content='{}'):
        package, _, name = kind.split('/')
        response = self.client.call(
            service, getattr(import_module(f'{package}.srv'), name), **yaml.safe_load(content)
        )
        assert response.success, response.message
        return response.message


@pytest.fixture
def shell(graph, client, workspace):
    return Shell(graph, client, workspace)


def ros2(verb):
    return [line for line in COMMANDS if line.startswith(f'ros2 {verb} ')]


def bare():
    return [line for line in COMMANDS if line.startswith('closed_loop ')]


def python_with(words):
    return next(block for language, block in FENCES if language == 'python' and words in block)


def test_every_command_of_the_readme_is_run_here_or_by_ci():
    known = {
        'make demo',
        'make test',
        'colcon build',
        'source install/setup.bash',
        '. .venv/bin/activate',
        *bare(),
    }
    known |= {line for verb in ('run', *VERBS) for line in ros2(verb)}
    assert len(COMMANDS) > 10
    assert [line for line in COMMANDS if line not in known] == []


def test_the_workspace_can_be_sourced_and_finds_the_built_package(workspace):
    said = subprocess.run(
        [sys.executable, '-c', f'import {PACKAGE}; print({PACKAGE}.__file__)'],
        cwd='/',
        env=sourced(workspace),
        check=True,
        capture_output=True,
        text=True,
    )
    assert said.stdout.startswith(str(workspace / 'install'))


def test_the_layouts_are_installed(workspace):
    share = workspace / 'install' / PACKAGE / 'share' / PACKAGE
    for path in (ROOT / 'layouts').iterdir():
        assert (share / 'layouts' / path.name).read_text() == path.read_text()


def test_the_composed_run_of_the_readme_is_recorded_and_looked_at(shell):
    runs = shell.graph.folder
    composed, *rest = [line for line in ros2('run') if line.split()[3] not in NODES]
    process = shell.start(composed)
    assert process.wait() == 0, process.output
    assert len(read_bag(runs / 'underdamped').states) == 20_001
    others = {line.split()[3] + line.split()[-1]: shell.start(line) for line in rest}
    said = subprocess.run(
        [sys.executable, '-c', python_with('to_pandas').replace('runs/', '')],
        cwd=runs,
        check=True,
        env=os.environ | {'MPLBACKEND': 'Agg'},
        capture_output=True,
        text=True,
    ).stdout.split()
    assert float(said[0]) > 0.375
    assert said[1] == '10.0'
    assert (runs / 'underdamped.png').read_bytes().startswith(b'\x89PNG')
    statuses = {name: process.wait() for name, process in others.items()}
    assert statuses == {name: int(name == 'replayK:=12.0') for name in others}
    assert 'messages published' in others['replay0.5'].output
    assert 'every message is the same, to the bit' in others['replay--closed-loop'].output
    assert others['replayK:=12.0'].output.endswith('it differs\n')
    assert (runs / 'underdamped.html').exists()
    assert len(pd.read_parquet(runs / 'underdamped.parquet')) == 20_001


def test_a_bare_machine_does_as_the_demo_does_by_the_names_of_the_executables():
    (composed,) = (line for line in ros2('run') if ' closed_loop ' in line)
    assert [RUN + line for line in bare()] == [composed]


def test_the_three_processes_of_the_readme_are_tuned_as_it_says(shell):
    nodes = [shell.start(line) for line in ros2('run') if line.split()[3] in NODES]
    assert len(nodes) == 3
    nodes[0].says('running from')
    for line in (line for verb in VERBS for line in ros2(verb)):
        shell.run(line)
        if line in ros2('topic'):
            shell.client.spin_until(lambda: shell.client.get('controller', 'x_r') == [0.1], 'x_r')
    assert 12.0 in shell.outcomes
    assert (
        subprocess.run(
            [sys.executable, '-c', python_with('AsyncParameterClient')],
            env=shell.graph.env,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.count('successful=True')
        == 2
    )
    shell.client.spin_until(lambda: shell.client.get('controller', 'x_r') == [0.2], 'x_r')
    for process in nodes:
        assert process.interrupt() == 0, process.output
    run = read_bag(shell.graph.folder / 'axis')
    assert run.recording_summary['missing'] == '0'
    assert (np.diff(run.states['stamp']) == 100_000).all()


def test_make_demo_prints_the_table_of_the_readme(tmp_path, graph):
    shutil.copytree(ROOT / 'config', tmp_path / 'config')
    said = subprocess.run(
        [sys.executable, '-m', f'{PACKAGE}.tools.demo'],
        cwd=tmp_path,
        env=graph.env,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    table = next(block for language, block in FENCES if 'settling' in block)
    for line in table.strip('\n').splitlines():
        assert line in said
    report = Path(tmp_path, said.splitlines()[-1].rsplit(': ')[-1])
    assert report.read_text().endswith('</html>\n')


def test_an_interrupted_demo_says_where_the_recording_is_and_finishes_it(tmp_path, graph):
    shutil.copytree(ROOT / 'config', tmp_path / 'config')
    with subprocess.Popen(
        [sys.executable, '-m', f'{PACKAGE}.tools.demo'],
        cwd=tmp_path,
        env=graph.env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as demo:
        bag = wait_for(lambda: list(tmp_path.glob('runs/*/pd_only_lower')), 'the first bag')[0]
        os.killpg(demo.pid, signal.SIGINT)
        said = demo.communicate()[1]
    assert demo.returncode == 1
    assert said.count('demo: interrupted') == 1
    assert 'Traceback' not in said
    assert read_bag(bag).recording_summary['missing'] == '0'


def test_the_python_of_the_readme_runs(tmp_path):
    code = python_with('simulate')
    said = subprocess.run(
        [sys.executable, '-c', code], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    assert f'{float(said[0]):.6f} m' in code
    assert f'{said[1]} impulses' in code


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page):
    for link in re.findall(r'\]\(([^)]+)\)', page.read_text()):
        file, _, heading = link.replace('\n', '').partition('#')
        if file.startswith('https:'):
            continue
        target = (page.parent / file).resolve()
        assert target.exists(), link
        if heading:
            titles = re.findall(r'^#+ (.*)', target.read_text(), re.M)
            assert heading in [
                re.sub(r'[^\w -]', '', title).lower().replace(' ', '-') for title in titles
            ], link


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_executable_and_file_of_a_command_is_there(page):
    for name in re.findall(rf'{RUN}(\w+)', page.read_text()):
        assert (BIN / name).exists(), name
    for name in re.findall(r'(?:scripts/)?\b(?:config|studies)/\w+\.yaml', page.read_text()):
        assert (ROOT / name).exists(), name


def test_what_pip_brings_in_a_workspace_is_what_the_package_requires():
    line = next(
        line
        for line in (ROOT / 'docs/install.md').read_text().splitlines()
        if line.startswith('pip install ')
    )
    known_to_rosdep = {'numpy', 'pyyaml', 'setuptools'}
    assert (
        set(shlex.split(line)[2:])
        == {item for item in requires(PACKAGE) if 'extra ==' not in item} - known_to_rosdep
    )
