"""Another of our executables, started as a child of a node."""

from collections.abc import Sequence
import signal
import subprocess
import sys
from typing import IO

START = 'import sys; from impulse_control_ros import command_line; sys.exit(command_line.{}())'


class Child:
    """
    The executable ``name`` with its ``arguments``; ``out`` takes what it says.

    Ctrl-C in the terminal does not reach it: its parent ends it.
    """

    def __init__(self, name: str, *arguments: str, out: IO[str] | None = None) -> None:
        self._popen = subprocess.Popen(  # noqa: S603 (our own executable)
            [sys.executable, '-c', START.format(name), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=out,
            start_new_session=True,
        )

    @property
    def status(self) -> int | None:
        """The exit status; None while it runs."""
        return self._popen.poll()

    def interrupt(self) -> None:
        """Press Ctrl-C, if it still runs."""
        if self.status is None:
            self._popen.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Press Ctrl-C, and wait until it has ended."""
        self.interrupt()
        self._popen.wait()


def remappings(arguments: Sequence[str]) -> list[str]:
    """
    Return the rules of a command line that rename topics or the namespace, for another node.

    A rule for the name of a node is not among them.
    """
    pairs = zip(arguments, arguments[1:], strict=False)
    rules = [rule for flag, rule in pairs if flag in ('-r', '--remap')]
    return [
        part
        for rule in rules
        if not rule.startswith(('__node:=', '__name:='))
        for part in ('-r', rule)
    ]
