"""Real processes on a ROS domain of their own, and a rclpy node to talk to them."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, ExitStack
import ctypes
import itertools
import os
from pathlib import Path
import resource
import signal
import socket
import subprocess
import sys
import time

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import pytest
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
ROOT = Path(__file__).parent.parent
CONFIG = ROOT / 'config'
BIN = Path(sys.executable).parent
PATIENCE = 240.0
PR_SET_PDEATHSIG = 1
_numbers = itertools.count(os.getpid())


def wait_for(condition: Callable[[], object], what: str,
             pause: Callable[[], object] = lambda: time.sleep(0.02)) -> object:
    """Return the first true value of ``condition``; fail naming ``what`` when patience ends."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        pause()
    return pytest.fail(f'{what}: not within {PATIENCE:g} s')


def die_with_parent() -> None:
    """Let a child end with a test session that is killed: it would disturb the next one."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


class Process:
    """A started executable; its output goes to a file."""

    def __init__(self, name: str, command: list[str], log: Path, env: dict[str, str]) -> None:
        self.name, self._log = name, log
        with log.open('wb') as out:
            self._popen = subprocess.Popen(
                command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=env,
                start_new_session=True, preexec_fn=die_with_parent)

    @property
    def output(self) -> str:
        return self._log.read_text(errors='replace')

    @property
    def running(self) -> bool:
        return self._popen.poll() is None

    @property
    def memory_map(self) -> str:
        """Name the libraries it has loaded."""
        return Path(f'/proc/{self._popen.pid}/maps').read_text()

    def says(self, text: str) -> None:
        """Wait until the output holds ``text``."""
        wait_for(lambda: text in self.output or not self.running, f'{self.name}: {text!r}')
        assert text in self.output

    def send(self, number: signal.Signals) -> None:
        self._popen.send_signal(number)

    def limit_files(self, size: int) -> None:
        """Let it write no file beyond ``size`` bytes, as on a full disk."""
        resource.prlimit(self._popen.pid, resource.RLIMIT_FSIZE, (size, size))

    def wait(self) -> int:
        """Return the exit status."""
        try:
            return self._popen.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            return pytest.fail(f'{self.name} does not end:\n{self.output}')

    def interrupt(self) -> int:
        """Press Ctrl-C; returns the exit status."""
        if self.running:
            self.send(signal.SIGINT)
        return self.wait()

    def kill(self) -> None:
        """Kill it if it still runs."""
        if self.running:
            self._popen.kill()
            self._popen.wait()


def free_domain() -> tuple[int, socket.socket]:
    """
    Return a ROS domain that nobody uses, and the socket that claims it while it is open.

    DDS listens to some of the domain's UDP ports, those of its first participants among them; the
    claim is on the TCP port of the first, so that test sessions on one machine keep apart. None
    is used twice soon, for what was killed lives on in the discovery for a while.
    """
    for domain in (number % 100 + 1 for number in itertools.islice(_numbers, 100)):
        first_port = 7400 + 250 * domain
        claim = socket.socket()
        try:
            for port in (first_port, *range(first_port + 10, first_port + 20)):
                with socket.socket(type=socket.SOCK_DGRAM) as heard:
                    heard.bind(('', port))
            claim.bind(('', first_port))
        except OSError:
            claim.close()
        else:
            return domain, claim
    return pytest.fail('all ROS domains from 1 to 100 are in use')


class Graph:
    """A ROS domain of its own, and the processes started on it."""

    def __init__(self, folder: Path) -> None:
        self.domain, self._claim = free_domain()
        self.folder = folder
        self.environment: Mapping[str, str] = os.environ
        self._processes: list[Process] = []

    @property
    def env(self) -> dict[str, str]:
        return {
            **self.environment,
            'ROS_DOMAIN_ID': str(self.domain), 'ROS_LOG_DIR': str(self.folder / 'log'),
            'PYTHONUNBUFFERED': '1'}

    def share_no_memory(self) -> None:
        """Let who is started anew after a kill be heard: docs/reliability.md says why."""
        self.environment = {**self.environment,
                            'FASTRTPS_DEFAULT_PROFILES_FILE': str(CONFIG / 'udp.xml')}

    def start(self, name: str, *arguments: object, config: Path | None = None,
              bin_folder: Path = BIN) -> Process:
        """Start an executable of ours, with ROS arguments and a parameter file."""
        command = [str(bin_folder / name), *(str(item) for item in arguments)]
        if config:
            if '--ros-args' not in command:
                command.append('--ros-args')
            command += ['--params-file', str(config)]
        log = self.folder / f'{len(self._processes)}_{name}.log'
        self._processes.append(Process(name, command, log, self.env))
        return self._processes[-1]

    def close(self) -> None:
        """End what still runs, and print what all said: pytest shows it where a test failed."""
        for process in self._processes:
            process.kill()
            print(f'--- {process.name} (exit {process.wait()}):\n{process.output}')
        self._claim.close()


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    made = Graph(tmp_path)
    try:
        yield made
    finally:
        made.close()


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Keep ``count`` processes busy meanwhile."""
    with ExitStack() as stack:
        for _ in range(count):
            loop = subprocess.Popen([sys.executable, '-c', 'while True: pass'])
            stack.callback(loop.wait)
            stack.callback(loop.kill)
        yield


class Client:
    """A node of the test's own on the graph's domain."""

    def __init__(self, graph: Graph) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=graph.domain)
        self.node = rclpy.create_node('test_client', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def spin_until(self, condition: Callable[[], object], what: str) -> object:
        """Serve the node until ``condition`` is true; returns its value."""
        return wait_for(condition, what, lambda: self._executor.spin_once(timeout_sec=0.05))

    def spin_for(self, seconds: float) -> None:
        """Serve the node for some seconds, where there is nothing to wait for."""
        until = time.monotonic() + seconds
        self.spin_until(lambda: time.monotonic() > until, f'{seconds:g} s')

    def call(self, service: str, kind: type, once: bool = False, **request: object) -> object:
        """
        Call a service and return its response.

        A response is lost when the server has not yet matched this client's reader, so the call
        is made again after a while; one that is to be made ``once`` waits until the server has
        answered a client of ours that it discovered later.
        """
        client = self.node.create_client(kind, service)
        try:
            self.spin_until(client.service_is_ready, f'service {service}')
            if once:
                self.call(f'{service.rpartition("/")[0]}/get_parameters', GetParameters)
            calls, asked = [], 0.0

            def answered() -> list[object]:
                nonlocal asked
                if not calls or (not once and time.monotonic() > asked + 10.0):
                    asked = time.monotonic()
                    calls.append(client.call_async(kind.Request(**request)))
                return [call for call in calls if call.done()]
            return self.spin_until(answered, f'response of {service}')[0].result()
        finally:
            self.node.destroy_client(client)

    def set(self, target: str, **values: object) -> SetParametersResult:
        """Set parameters of a node, all or none."""
        parameters = [Parameter(name, value=value).to_parameter_msg()
                      for name, value in values.items()]
        return self.call(f'/{target}/set_parameters_atomically', SetParametersAtomically,
                         parameters=parameters).result

    def get(self, target: str, *names: str) -> list[object]:
        """Return parameters of a node."""
        response = self.call(f'/{target}/get_parameters', GetParameters, names=list(names))
        return [parameter_value_to_python(value) for value in response.values]

    def change_state(self, transition: int) -> str:
        """Ask the managed controller for a transition; returns the state that it is in then."""
        self.call('/controller/change_state', ChangeState, transition=Transition(id=transition))
        return self.call('/controller/get_state', GetState).current_state.label

    def activate(self) -> None:
        """Configure and activate the managed controller."""
        self.change_state(Transition.TRANSITION_CONFIGURE)
        assert self.change_state(Transition.TRANSITION_ACTIVATE) == 'active'

    def listen(self, topic: str, kind: type) -> list[object]:
        """Return a list that grows with the messages of a topic while this node is served."""
        received: list[object] = []
        self.node.create_subscription(kind, topic, received.append, 1000)
        return received

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def client(graph: Graph) -> Iterator[Client]:
    made = Client(graph)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(scope='session')
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """
    Return a folder with two bags of real runs.

    ``underdamped`` is of closed_loop; ``left`` of three processes in the namespace /left, with
    varying damping and all topics.
    """
    folder = tmp_path_factory.mktemp('recorded')
    graph = Graph(folder)
    try:
        composed = graph.start('closed_loop', '--ros-args', '-p',
                               f'recorder:bag:={folder / "underdamped"}',
                               config=CONFIG / 'underdamped.yaml')
        assert composed.wait() == 0
        left = ('--ros-args', '-r', '__ns:=/left', '--params-file', CONFIG / 'time_varying.yaml')
        topics = '[setpoint, damping, recorder_progress, /clock, /diagnostics, /parameter_events]'
        plant, *others = (
            graph.start(name, *left, *more)
            for name, *more in (('plant_simulator',), ('controller',), (
                'recorder', '-p', f'bag:={folder / "left"}', '-p', f'topics:={topics}')))
        assert plant.wait() == 0
        for process in reversed(others):
            assert process.interrupt() == 0
    finally:
        graph.close()
    return folder
