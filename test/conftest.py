"""Real processes on a ROS domain of their own, and a rclpy node to talk to them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
import itertools
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

ROOT = Path(__file__).parent.parent
CONFIG = ROOT / 'config'
BIN = Path(sys.executable).parent
PATIENCE = 240.0
_domains = itertools.count(os.getpid() % 90)


def wait_for(condition: Callable[[], object], what: str, patience: float = PATIENCE) -> object:
    """Return the first true value of ``condition``; fail naming ``what`` when patience ends."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    return pytest.fail(f'{what}: not within {patience:g} s')


class Process:
    """A started executable; its output goes to a file."""

    def __init__(self, name: str, command: list[str], log: Path, env: dict[str, str]) -> None:
        self.name, self._log = name, log
        with log.open('wb') as out:
            self._popen = subprocess.Popen(
                command, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=env,
                start_new_session=True)

    @property
    def output(self) -> str:
        return self._log.read_text(errors='replace')

    @property
    def running(self) -> bool:
        return self._popen.poll() is None

    def says(self, text: str, patience: float = PATIENCE) -> None:
        """Wait until the output holds ``text``."""
        try:
            wait_for(lambda: text in self.output or not self.running, text, patience)
            assert text in self.output
        except (AssertionError, pytest.fail.Exception):
            pytest.fail(f'{self.name} does not say {text!r}:\n{self.output}')

    def send(self, number: signal.Signals) -> None:
        self._popen.send_signal(number)

    def wait(self, patience: float = PATIENCE) -> int:
        """Return the exit status."""
        try:
            return self._popen.wait(patience)
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


class Graph:
    """A ROS domain of its own, and the processes started on it."""

    def __init__(self, folder: Path) -> None:
        self.domain = next(_domains) % 100 + 1
        self.folder = folder
        self._processes: list[Process] = []

    @property
    def env(self) -> dict[str, str]:
        return os.environ | {'ROS_DOMAIN_ID': str(self.domain),
                             'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                             'ROS_LOG_DIR': str(self.folder / 'log'), 'PYTHONUNBUFFERED': '1'}

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
        for process in self._processes:
            process.kill()


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
