"""
The executables: Ctrl-C is taken from the first moment, before the long imports.

Signals only set a flag, any number of times; whoever loops looks at it.
"""

from importlib import import_module
import signal
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Set by SIGINT and SIGTERM."""

    def __init__(self) -> None:
        self.requested = False
        for number in SIGNALS:
            signal.signal(number, self._request)

    def _request(self, *_: Any) -> None:
        self.requested = True

    def ignore(self) -> None:
        """Take no signal from now on: the interpreter puts the default handlers back on exit."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def _run(name: str) -> int:
    stop = StopRequest()
    status = int(import_module(f'impulse_control_ros.nodes.{name}').main(stop))
    stop.ignore()
    return status


def plant_simulator() -> int:
    """Run the plant simulator node."""
    return _run('plant_simulator')


def controller() -> int:
    """Run the controller node."""
    return _run('controller')


def recorder() -> int:
    """Run the recorder node."""
    return _run('recorder')


def closed_loop() -> int:
    """Run the three in one process."""
    return _run('closed_loop')
