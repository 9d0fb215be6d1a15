"""A recording started from the dashboard: our recorder as a process, and the report of its bag."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
import signal
import subprocess
import sys
import tempfile

START = 'import sys; from impulse_control_ros import command_line; sys.exit(command_line.{}())'


class Child:
    """A process of one of our executables; its output is kept."""

    def __init__(self, name: str, *arguments: str) -> None:
        self._out = tempfile.TemporaryFile('w+')  # noqa: SIM115 (read when the process has ended)
        self._popen = subprocess.Popen(  # noqa: S603 (our own executable)
            [sys.executable, '-c', START.format(name), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=self._out,
            stderr=self._out,
            start_new_session=True,  # Ctrl-C in the terminal is for the dashboard, which ends it
        )

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._popen.poll() is not None

    @property
    def trouble(self) -> str:
        """The last line that it said, if it failed."""
        if not self._popen.returncode:
            return ''
        self._out.seek(0)
        said = self._out.read().strip().splitlines()
        return said[-1] if said else f'ended with status {self._popen.returncode}'

    def interrupt(self) -> None:
        """End it as Ctrl-C does."""
        if not self.ended:
            self._popen.send_signal(signal.SIGINT)

    def wait(self) -> None:
        """Wait until it has ended."""
        self._popen.wait()


class Recording:
    """
    The recordings of a dashboard, one after another, into ``folder``.

    ``ros_arguments`` are the rules of remapping that the recorder shares with the dashboard.
    ``state`` says in words what goes on; ``report`` is the file of the last report, or None.
    """

    def __init__(self, folder: Path, ros_arguments: Sequence[str]) -> None:
        self.folder, self.state, self.report = folder, '', ''
        self._arguments = ros_arguments
        self._recorder: Child | None = None
        self._analyze: Child | None = None
        self._bag = Path()

    @property
    def running(self) -> bool:
        """Whether a recorder runs."""
        return self._recorder is not None

    def start(self) -> str:
        """Start a recorder; return why not, or ''."""
        if self._recorder or self._analyze:
            return f'refused: {self.state}'
        self._bag = self.folder / f'dashboard_{datetime.now():%Y_%m_%d-%H_%M_%S}'
        self._recorder = Child(
            'recorder', '--ros-args', *self._arguments, '-p', f'bag:={self._bag}'
        )
        self.state, self.report = f'recording {self._bag}', ''
        return ''

    def stop(self) -> str:
        """End the recorder; return why not, or ''."""
        if not self._recorder:
            return 'refused: nothing is recorded'
        self._recorder.interrupt()
        self.state = f'finishing {self._bag}'
        return ''

    def poll(self) -> None:
        """Go on to the report once the recorder has ended, and to the end once that has."""
        if self._recorder and self._recorder.ended:
            trouble, self._recorder = self._recorder.trouble, None
            if trouble or not self._bag.exists():
                self.state = trouble or 'nothing was recorded: no plant, or no controller'
                return
            self.state = f'making the report of {self._bag}'
            report = self._bag.with_suffix('.html')
            self._analyze = Child('analyze', str(self._bag), '--report', str(report))
        elif self._analyze and self._analyze.ended:
            trouble, self._analyze = self._analyze.trouble, None
            self.state = f'recorded {self._bag}' + (f'; no report: {trouble}' if trouble else '')
            self.report = '' if trouble else self._bag.with_suffix('.html').name

    def close(self) -> None:
        """End what still runs; the recorder finishes its bag."""
        for child in (self._recorder, self._analyze):
            if child:
                child.interrupt()
                child.wait()
