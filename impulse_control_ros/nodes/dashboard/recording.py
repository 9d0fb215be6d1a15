"""A recording started on the page: a recorder process, and the report of its bag."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
import tempfile

from impulse_control_ros.nodes.child import Child

NAME = ('-r', '__node:=dashboard_recorder')  # beside one of the user's own


class Recording:
    """
    The recordings of a dashboard, one after another, into ``folder``.

    ``ros_arguments`` are the remapping rules that the recorder shares with the dashboard.
    ``state`` describes the recording in words; ``report`` is the name of the last report, or ''.
    """

    def __init__(self, folder: Path, ros_arguments: Sequence[str]) -> None:
        self.folder, self.state, self.report = folder, '', ''
        self._arguments = ros_arguments
        self._recorder: Child | None = None
        self._analyze: Child | None = None
        self._bag = Path()
        self._out = tempfile.TemporaryFile('w+')  # noqa: SIM115 (open until the end)

    @property
    def running(self) -> bool:
        """Whether a recorder runs."""
        return self._recorder is not None

    def start(self) -> str:
        """Start a recorder; return why not, or ''."""
        if self._recorder or self._analyze:
            return f'refused: {self.state}'
        self._bag = self.folder / f'dashboard_{datetime.now():%Y_%m_%d-%H_%M_%S}'
        self._recorder = self._start(
            'recorder', '--ros-args', *self._arguments, *NAME, '-p', f'bag:={self._bag}'
        )
        self.state, self.report = f'recording {self._bag}', ''
        return ''

    def _start(self, *command: str) -> Child:
        self._out.seek(0)
        self._out.truncate()
        return Child(*command, out=self._out)

    def _trouble(self, status: int) -> str:
        """Return the last line of output of a child that failed, else ''."""
        self._out.seek(0)
        said = self._out.read().strip().splitlines() if status else []
        return said[-1] if said else f'ended with status {status}' if status else ''

    def stop(self) -> str:
        """End the recorder; return why not, or ''."""
        if not self._recorder:
            return 'refused: nothing is recorded'
        self._recorder.interrupt()
        self.state = f'finishing {self._bag}'
        return ''

    def poll(self) -> None:
        """Start the report once the recorder has ended, and note its end."""
        if self._recorder and self._recorder.status is not None:
            trouble, self._recorder = self._trouble(self._recorder.status), None
            if trouble or not self._bag.exists():
                self.state = trouble or 'nothing was recorded: no plant, or no controller'
                return
            self.state = f'making the report of {self._bag}'
            report = self._bag.with_suffix('.html')
            self._analyze = self._start('analyze', str(self._bag), '--report', str(report))
        elif self._analyze and self._analyze.status is not None:
            trouble, self._analyze = self._trouble(self._analyze.status), None
            self.state = f'recorded {self._bag}' + (f'; no report: {trouble}' if trouble else '')
            self.report = '' if trouble else self._bag.with_suffix('.html').name

    def close(self) -> None:
        """End the processes that still run; the recorder finishes its bag."""
        for child in (self._recorder, self._analyze):
            if child:
                child.end()
        self._out.close()
