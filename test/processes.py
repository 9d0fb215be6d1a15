"""Real processes on a ROS domain of their own."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
import ctypes
import itertools
import os
from pathlib import Path
import re
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time

import pytest

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
ENVIRONMENT = dict(os.environ)  # of the processes; rclpy here may add to ours
ENVIRONMENT['BROWSER'] = 'true'  # the dashboard opens none
if ENVIRONMENT.pop('PYTHONDONTWRITEBYTECODE', ''):  # a third of the time of a start
    ENVIRONMENT.setdefault('PYTHONPYCACHEPREFIX', f'{tempfile.gettempdir()}/pycache_{os.getuid()}')
ROOT = Path(__file__).parent.parent
CONFIG = ROOT / 'config'
BIN = Path(sys.executable).parent
PATIENCE = 100.0
PR_SET_PDEATHSIG = 1
_numbers = itertools.count(os.getpid())


def wait_for(
    condition: Callable[[], object],
    what: str,
    pause: Callable[[], object] = lambda: time.sleep(0.02),
) -> object:
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
        self.name, self.folder, self._log = name, log.parent, log
        with log.open('wb') as out:
            self._popen = subprocess.Popen(
                command,
                stdout=out,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=env,
                start_new_session=True,
                preexec_fn=die_with_parent,
                cwd=log.parent,
            )

    @property
    def output(self) -> str:
        return self._log.read_text(errors='replace')

    @property
    def pid(self) -> int:
        return self._popen.pid

    @property
    def running(self) -> bool:
        return self._popen.poll() is None

    @property
    def memory_map(self) -> str:
        """Name the libraries it has loaded."""
        return Path(f'/proc/{self._popen.pid}/maps').read_text()

    @property
    def totals(self) -> dict[str, int]:
        """The counts in the last line that a plant says of its run."""
        counts = self.output.rpartition('times real time); ')[2]
        return {name: int(count) for count, name in re.findall(r'(\d+) (\w+)', counts)}

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
        """Kill it if it still runs, as kill -9 does."""
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


def as_yaml(value: object) -> str:
    """Return a parameter as ROS reads it on the command line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f'[{",".join(map(as_yaml, value))}]'
    text = str(value)
    return text.replace('e', '.0e') if isinstance(value, float) and '.' not in text else text


class Graph:
    """A ROS domain of its own, and the processes started on it."""

    def __init__(self, folder: Path) -> None:
        self.domain, self._claim = free_domain()
        self.folder = folder
        self.environment: Mapping[str, str] = ENVIRONMENT
        self._processes: list[Process] = []

    @property
    def env(self) -> dict[str, str]:
        return {
            **self.environment,
            'ROS_DOMAIN_ID': str(self.domain),
            'ROS_LOG_DIR': str(self.folder / 'log'),
            'PYTHONUNBUFFERED': '1',
        }

    def start(
        self,
        name: str,
        *arguments: object,
        config: Path | Sequence[Path] = (),
        bin_folder: Path = BIN,
        **parameters: object,
    ) -> Process:
        """
        Start an executable of ours, with parameter files and ``parameters``, which count more.

        Its own ``arguments`` go first; ROS arguments may follow behind --ros-args.
        """
        command = [str(bin_folder / name), *(str(item) for item in arguments)]
        if (config or parameters) and '--ros-args' not in command:
            command.append('--ros-args')
        for path in [config] if isinstance(config, Path) else config:
            command += ['--params-file', str(path)]
        for key, value in parameters.items():
            command += ['-p', f'{key}:={as_yaml(value)}']
        log = self.folder / f'{len(self._processes)}_{name}.log'
        self._processes.append(Process(name, command, log, self.env))
        return self._processes[-1]

    def close(self) -> None:
        """End what still runs, and print what all said: pytest shows it where a test failed."""
        for process in self._processes:
            process.kill()
            print(f'--- {process.name} (exit {process.wait()}):\n{process.output}')
        self._claim.close()


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Keep ``count`` processes busy meanwhile."""
    with ExitStack() as stack:
        for _ in range(count):
            loop = subprocess.Popen(
                [sys.executable, '-c', 'while True: pass'], preexec_fn=die_with_parent
            )
            stack.callback(loop.wait)
            stack.callback(loop.kill)
        yield
