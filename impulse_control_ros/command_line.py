"""
Command lines: Ctrl-C, errors and exit statuses of every executable.

An executable takes Ctrl-C before it imports its command, because the imports take seconds; only
the nodes import rclpy. Exit status 0: done. 1: failed, interrupted, or compared bags differ.
2: invalid arguments, parameters or bag. An error is one line on stderr.
"""

import argparse
from collections.abc import Callable
from functools import partial
from importlib import import_module
from io import TextIOWrapper
import logging
import math
import os
import signal
import sys
from typing import Any, NoReturn

from impulse_control_ros.errors import (
    ImpulseControlError,
    MissingPackageError,
    NodeError,
    SweepError,
    UsageError,
)

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """A flag set by `SIGNALS`; more of them than ``patience`` end the process at once."""

    def __init__(self, patience: float = math.inf) -> None:
        self.requested = False
        self._patience = patience
        for number in SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup
                signal.signal(number, self._request)

    def _request(self, *_: Any) -> None:
        self.requested = True
        self._patience -= 1
        if self._patience < 0:
            os.write(2, b'interrupted\n')
            os._exit(1)

    def ignore(self) -> None:
        """Ignore the signals from now on: the interpreter restores the handlers on exit."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)


class Parser(argparse.ArgumentParser):
    """A parser that raises `UsageError` for an invalid command line."""

    def print_help(self, file: Any = None) -> None:
        """Print the help at once: behind it nobody handles a closed pipe."""
        super().print_help(file)
        sys.stdout.flush()

    def error(self, message: str) -> NoReturn:
        """Raise `UsageError`."""
        raise UsageError(f'{message} (see --help)')


def add_selection(parser: argparse.ArgumentParser) -> None:
    """Add the options that select a part of a bag; `selection` returns their values."""
    group = parser.add_argument_group('part of the bag to read')
    group.add_argument(
        '--run',
        metavar='RUN',
        default='',
        help='the run with this number or id (default: the last one)',
    )
    group.add_argument(
        '--namespace', metavar='NS', default='', help='the system with topics in this namespace'
    )
    group.add_argument(
        '--topic',
        metavar='TOPIC',
        dest='selected',
        action='append',
        default=[],
        help='the topic to read if there are several of a kind (joint_states, joint_commands, '
        '...); a topic of another name is read as joint_states; may be repeated',
    )
    group.add_argument(
        '--joint',
        metavar='JOINT',
        default='',
        help='the joint (default: that of the recorded parameters, axis, or the only one)',
    )
    group.add_argument(
        '--time',
        choices=('stamp', 'log'),
        default='stamp',
        help='time of a state: its stamp or the time of recording (default: %(default)s)',
    )


def selection(options: argparse.Namespace) -> dict[str, Any]:
    """Return the given options of `add_selection` as arguments of `read_bag`."""
    given = {
        'run': options.run,
        'namespace': options.namespace,
        'topics': options.selected,
        'joint': options.joint,
        'log_time': options.time == 'log',
    }
    return {name: value for name, value in given.items() if value}


def ended(name: str, why: object, status: int) -> int:
    """Print why the command ``name`` ends; returns ``status``."""
    print(f'{name}: {why}', file=sys.stderr)
    return status


def warn(name: str, text: str) -> None:
    """Print a warning of the command ``name``."""
    print(f'{name}: warning: {text}', file=sys.stderr)


def log_to_stderr(name: str) -> None:
    """Print what the package logs, as lines of the command ``name``."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter(f'{name}: %(message)s'))
    logger = logging.getLogger('impulse_control_ros')
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)


def exit_status(name: str, command: Callable[[], int]) -> int:
    """Run ``command``, print its error if there is one, and return the exit status."""
    try:
        status = command()
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of stdout has enough, as `head` has
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Python flushes again on exit
        return 1
    except OSError as error:
        file = error.filename2 or error.filename or 'stdout'
        return ended(name, f'{file}: {error.strerror or error}', 1)
    except (SweepError, MissingPackageError, NodeError) as error:
        return ended(name, error, 1)
    except ImpulseControlError as error:
        return ended(name, error, 2)
    return status


def prepare_streams() -> None:
    """Let stdout take any file name, whatever its encoding, and let closed streams take all."""
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, 'w'))  # noqa: SIM115 (open until the end)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors='backslashreplace')


def run(name: str, module: str, patience: float = math.inf) -> int:
    """Run the command ``name`` of a module of this package; returns the exit status."""
    prepare_streams()
    try:
        os.getcwd()
    except FileNotFoundError:
        return ended(name, 'the current folder was deleted: change to one that exists', 1)
    stop = StopRequest(patience)
    log_to_stderr(name)
    main = import_module(f'impulse_control_ros.{module}').main
    status = exit_status(name, partial(main, stop))
    stop.ignore()
    return status


plant_simulator = partial(run, 'plant_simulator', 'nodes.plant_simulator')
controller = partial(run, 'controller', 'nodes.controller')
recorder = partial(run, 'recorder', 'nodes.recorder')
dashboard = partial(run, 'dashboard', 'nodes.dashboard.command')
closed_loop = partial(run, 'closed_loop', 'nodes.closed_loop')
excite = partial(run, 'excite', 'nodes.excite')
simulate = partial(run, 'simulate', 'tools.simulate')
replay = partial(run, 'replay', 'tools.replay')
param = partial(run, 'param', 'tools.param', patience=0)
sweep = partial(run, 'sweep', 'tools.sweep', patience=1)
analyze = partial(run, 'analyze', 'tools.analyze.command', patience=0)
identify = partial(run, 'identify', 'tools.identify.command', patience=0)
export_bag = partial(run, 'export_bag', 'tools.export', patience=0)
paper_figures = partial(run, 'paper_figures', 'tools.paper.command', patience=0)


def simulated_time(duration: float) -> Any:
    """Return a progress bar up to ``duration`` [s]; it is drawn on a terminal only."""
    from tqdm import tqdm

    tqdm.monitor_interval = 0  # no thread beside ours
    return tqdm(
        total=duration,
        unit='s',
        disable=None,
        leave=False,
        bar_format='{l_bar}{bar}| {n:.2f}/{total:.2f} s simulated, {rate_fmt}',
    )
