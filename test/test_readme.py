"""
README and docs: every command of a page is run in order, as a reader would, and every link leads.

=========  =====================================================================================
bash       each line is run in the page's folder; ``# exit status N`` is the expected status
python     is run as a script
yaml       is saved under NAME.yaml if its first line is ``# NAME.yaml``
text       each line is in the output of the page's commands; ``...`` stands for anything
=========  =====================================================================================

"Ctrl-C" in the text between two blocks interrupts the running nodes. ``ros2 run``, ``param``,
``topic pub`` and ``service call`` are carried out as those verbs do, because ros2cli is not on
PyPI; a block that starts with another verb of it is not run.
"""

from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import entry_points, requires
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys

import pytest
from rosgraph_msgs.msg import Clock
import yaml

from impulse_control_ros.files.recording import read_bag
from test.conftest import BIN, ROOT, wait_for
from test.processes import PATIENCE

README, INSTALL = ROOT / 'README.md', ROOT / 'docs/how-to/install.md'
DOCS = sorted(ROOT.glob('docs/**/*.md'))
PAGES = [README, *DOCS, *ROOT.glob('[be]*/**/README.md')]
PACKAGE = 'impulse_control_ros'
NODES = ('plant_simulator', 'controller', 'recorder', 'closed_loop', 'dashboard')
TOOLS = [entry.name for entry in entry_points(group='console_scripts') if PACKAGE in entry.value]
NOT_ON_PYPI = ('ros2 bag', 'ros2 control', 'ros2 launch', 'ros2 lifecycle', 'ros2 security')
# what the gate, the fixture of the workspace and test_paper_figures do
DONE_ELSEWHERE = (
    'make test',
    '. .venv/bin/activate',
    'pip install',
    'colcon build',
    'source ',
    'paper_figures',
)
PIECE = re.compile(r'^```(\w*)\n(.*?)^```|(Ctrl-C)', re.S | re.M)
EXIT_STATUS = re.compile(r'  # exit status (\d)$')


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def pieces(page: Path) -> Iterator[tuple[str, str]]:
    """Return the language and content of each block of a page, and ('', 'Ctrl-C') between."""
    for found in PIECE.finditer(page.read_text()):
        yield found[1] or '', found[2] or found[3]


def has_commands(page: Path) -> bool:
    return any(language in ('bash', 'python') for language, _ in pieces(page))


class Reader:
    """Follows a page in a folder of its own."""

    def __init__(self, graph, client, executables=BIN):
        self._graph, self._client, self._executables = graph, client, executables
        self._running, self._started, self._said = [], [], ''
        for room in ('config', 'studies', 'examples'):
            (graph.folder / room).symlink_to(ROOT / room)

    def follow(self, page):
        for language, block in pieces(page):
            if block == 'Ctrl-C':
                self._interrupt()
            elif language == 'bash' and not block.startswith(NOT_ON_PYPI):
                for line in block.splitlines():
                    self._run_line(line)
            elif language == 'python':
                self._run_script(block)
            elif language == 'yaml' and (name := re.match(r'# (\w+\.yaml)\n', block)):
                (self._graph.folder / name[1]).write_text(block)
            elif language == 'text':
                for line in block.splitlines():
                    self._expect(line)
        self._wait()

    @property
    def output(self):
        return self._said + ''.join(process.output for process in self._started)

    def _expect(self, line):
        words = r'[ \n]+'.join(map(re.escape, line.split()))  # argparse breaks lines
        pattern = re.compile(words.replace(r'\.\.\.', '.*'))
        if any(process.running for process in self._running):
            wait_for(lambda: pattern.search(self.output), f'{line!r} in\n{self.output}')
        assert pattern.search(self.output), line

    def _run_line(self, line):
        status = EXIT_STATUS.search(line)
        words = shlex.split(line, comments=True)
        if words[:3] == ['ros2', 'run', PACKAGE]:
            words = words[3:]
        if line.startswith(DONE_ELSEWHERE) or not words:
            return
        if words[0] == 'dashboard':
            words[1:1] = ['--port', '0']  # another session may have the default
        if words[0] in NODES:
            process = self._graph.start(*words, bin_folder=self._executables)
            self._running.append(process)
            self._started.append(process)
        elif words[0] == 'excite':  # beside the nodes that it moves, which go on
            self._run([str(self._executables / words[0]), *words[1:]])
        elif words[0] == 'ros2':
            self._be_running()
            getattr(self, '_'.join(words[1:3]))(*words[3:])
        elif words[0] == 'param':
            self._be_running()
            command = [str(self._executables / words[0]), *words[1:], '--timeout', str(PATIENCE)]
            self._run(command, int(status[1] if status else 0))
        elif line == 'make demo':
            self._wait()
            self._run([sys.executable, '-m', f'{PACKAGE}.tools.demo'])
            report = self._graph.folder / re.search(r'any browser: (.*)', self._said)[1]
            assert report.read_text().endswith('</html>\n')
        else:
            self._wait()
            assert words[0] in TOOLS, line
            self._run(
                [str(self._executables / words[0]), *words[1:]], int(status[1] if status else 0)
            )

    def _run_script(self, script):
        try:
            self._run([sys.executable, '-c', script], timeout=30.0)
        except subprocess.TimeoutExpired:
            # DDS loses the response of a service that has not discovered its client yet
            self._run([sys.executable, '-c', script])

    def _run(self, command, status=0, timeout=PATIENCE):
        ended = subprocess.run(
            command,
            timeout=timeout,
            cwd=self._graph.folder,
            env=self._graph.env | {'MPLBACKEND': 'Agg'},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        self._said += ended.stdout
        assert ended.returncode == status, (command, ended.stdout)

    def _be_running(self):
        for process in self._running:
            if process.name in ('plant_simulator', 'closed_loop'):
                process.says('running from')
            elif process.name == 'recorder':
                process.says('recording into')

    def _interrupt(self):
        if self._running:
            clock = []
            self._client.node.create_subscription(Clock, '/clock', clock.append, 10)
            self._client.spin_until(lambda: len(clock) >= 10, '0.1 s of simulated time')
        for process in self._running:
            assert process.interrupt() == 0, process.output
        self._running.clear()

    def _wait(self):
        for process in self._running:
            assert process.wait() == 0, process.output
        self._running.clear()

    def param_set(self, node, name, value):
        result = self._client.set(node.strip('/'), **{name: yaml.safe_load(value)})
        assert result.successful, result.reason

    def param_get(self, node, name):
        self._said += f'{self._client.get(node.strip("/"), name)[0]}\n'

    def topic_pub(self, once, topic, kind, content):
        assert once == '--once'
        package, _, name = kind.split('/')
        message = getattr(import_module(f'{package}.msg'), name)
        publisher = self._client.node.create_publisher(message, topic, 10)

        def matched():
            ends = self._client.node.get_subscriptions_info_by_topic(topic)
            return 'controller' in [end.node_name for end in ends] and (
                publisher.get_subscription_count() >= len(ends)
            )

        # the recorder may be matched before the controller is
        self._client.spin_until(matched, f'the subscribers of {topic}')
        publisher.publish(message(**yaml.safe_load(content)))
        controller = f'{topic.rpartition("/")[0]}/controller'.strip('/')
        value = yaml.safe_load(content)['data']
        self._client.spin_until(lambda: self._client.get(controller, 'x_r') == [value], 'x_r')

    def service_call(self, service, kind, content='{}'):
        package, _, name = kind.split('/')
        response = self._client.call(
            service, getattr(import_module(f'{package}.srv'), name), **yaml.safe_load(content)
        )
        assert response.success, response.message


@pytest.mark.parametrize(
    'page', [page for page in (README, *DOCS) if has_commands(page) and page != INSTALL], ids=named
)
def test_the_commands_of_a_page_do_what_it_says(page, graph, client):
    Reader(graph, client).follow(page)


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a workspace with what git tracks, built by colcon."""
    folder = tmp_path_factory.mktemp('workspace')
    tracked = subprocess.run(
        ['git', 'ls-files', '-co', '--exclude-standard'],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split('\n')
    for name in filter(None, tracked):
        if (ROOT / name).exists():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
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


def colcon_environment():
    path = f'{BIN}{os.pathsep}{os.environ["PATH"]}'
    return os.environ | {'PATH': path, 'AMENT_PREFIX_PATH': sys.prefix}


def sourced(workspace):
    """Return the environment after ``source install/setup.bash``."""
    said = subprocess.run(
        ['bash', '-c', 'source install/setup.bash && env -0'],
        cwd=workspace,
        env=colcon_environment(),
        check=True,
        capture_output=True,
        text=True,
    )
    return dict(line.split('=', 1) for line in said.stdout.split('\0') if line)


def test_the_workspace_of_the_install_page_is_built_and_runs(workspace, graph, client):
    graph.environment = sourced(workspace)
    executables = workspace / 'install' / PACKAGE / 'lib' / PACKAGE
    Reader(graph, client, executables).follow(INSTALL)
    said = subprocess.run(
        [sys.executable, '-c', f'import {PACKAGE}; print({PACKAGE}.__file__)'],
        cwd='/',
        env=graph.env,
        check=True,
        capture_output=True,
        text=True,
    )
    assert said.stdout.startswith(str(workspace / 'install'))
    for name in TOOLS:
        assert (executables / name).exists(), name


def test_the_layouts_are_installed(workspace):
    share = workspace / 'install' / PACKAGE / 'share' / PACKAGE
    for path in (ROOT / 'layouts').iterdir():
        assert (share / 'layouts' / path.name).read_text() == path.read_text()


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


def links(page: Path) -> list[str]:
    return [
        link.replace('\n', '')
        for link in re.findall(
            r'\]\(([^)]+)\)', re.sub(r'```.*?```', '', page.read_text(), flags=re.S)
        )
        if not link.startswith('https:')
    ]


@pytest.mark.parametrize('page', PAGES, ids=named)
def test_every_link_leads_somewhere(page):
    for link in links(page):
        file, _, heading = link.partition('#')
        target = (page.parent / file).resolve() if file else page
        assert target.exists(), link
        if heading:
            titles = re.findall(r'^#+ (.*)', target.read_text(), re.M)
            assert heading in [
                re.sub(r'[^\w -]', '', title).lower().replace(' ', '-') for title in titles
            ], link


def test_the_index_has_every_page_and_every_picture_is_shown():
    index = ROOT / 'docs/README.md'
    listed = {(index.parent / link.partition('#')[0]).resolve() for link in links(index)}
    assert set(DOCS) - {index} <= listed
    shown = {(page.parent / link).resolve() for page in PAGES for link in links(page)}
    assert set(ROOT.glob('docs/images/*')) <= shown


@pytest.mark.parametrize('page', PAGES, ids=named)
def test_every_file_that_a_page_names_is_there(page):
    names = re.findall(
        r'\b(?:config|studies|docs|benchmarks|scripts|test)/[\w/.-]+\.(?:yaml|md|py)\b',
        page.read_text(),
    )
    for name in names:
        assert (ROOT / name).exists(), name


def test_what_pip_brings_in_a_workspace_is_what_the_package_requires():
    line = next(
        line for line in INSTALL.read_text().splitlines() if line.startswith("pip install 'numba")
    )
    known_to_rosdep = {'numpy', 'pyyaml', 'setuptools'}
    assert (
        set(shlex.split(line)[2:])
        == {item for item in requires(PACKAGE) if 'extra ==' not in item} - known_to_rosdep
    )
