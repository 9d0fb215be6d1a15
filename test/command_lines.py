"""The commands, run in this process."""

from functools import partial
from importlib import import_module
from types import SimpleNamespace

from impulse_control_ros import command_line


def status_of(name: str, *arguments: object) -> int:
    """Run a command with these arguments; returns its exit status."""
    module = import_module(f'impulse_control_ros.{getattr(command_line, name).args[1]}')
    main = partial(module.main, SimpleNamespace(requested=False), [str(one) for one in arguments])
    return command_line.exit_status(name, main)
