"""
``replay``: what a bag holds once more, as messages on the graph or computed and compared.

The messages are published by nodes/player.py, which alone needs ROS.
"""

import argparse
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
import sys
from typing import Any

from impulse_control_ros.command_line import add_selection, Parser, selection, StopRequest, warn
from impulse_control_ros.errors import BagError, MissingPackageError

DESCRIPTION = 'Play a bag on the ROS graph, or run it again and compare every message.'
COMPARED = """\
The last two print what differs, bit by bit, and exit with 1 where anything does."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what is not for ROS."""
    parser.add_argument(
        'bag', metavar='BAG', type=Path, help='a rosbag2 folder, or one of its files'
    )
    play = parser.add_argument_group(
        'on the graph',
        'param set /replay rate 2.0 tunes it, and the service ~/pause (std_srvs/SetBool) holds it',
    )
    play.add_argument('--rate', type=float, help='bag seconds per wall second')
    play.add_argument('--start-offset', metavar='S', type=float, help='seconds of the bag to skip')
    play.add_argument('--loop', action='store_true', help='begin again at the end')
    play.add_argument('--start-paused', action='store_true', help='wait for ~/pause with false')
    play.add_argument(
        '--topics', metavar='TOPIC', nargs='+', help='the topics to publish; all if not given'
    )
    play.add_argument(
        '--clock',
        metavar='HZ',
        type=float,
        help='messages on /clock per wall second, 100 if not given; 0 for none',
    )
    again = parser.add_argument_group('computed and compared', COMPARED)
    which = again.add_mutually_exclusive_group()
    which.add_argument(
        '--controller', action='store_true', help='let the control law answer the recorded states'
    )
    which.add_argument(
        '--closed-loop',
        action='store_true',
        help='run the whole experiment again, from the parameters in the bag',
    )
    again.add_argument(
        '--params',
        metavar='FILE',
        type=Path,
        action='append',
        default=[],
        help='with --controller: a parameter file, whose controller answers; may be repeated, '
        'later ones count',
    )
    again.add_argument(
        '-p',
        dest='overrides',
        metavar='NAME:=VALUE',
        action='append',
        default=[],
        help='with --controller: a parameter of the controller',
    )
    add_selection(parser)


def main(stop: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Play a bag, or compute and compare it; returns the exit status, 1 for a difference."""
    parser = Parser(prog='replay', description=DESCRIPTION)
    add_options(parser)
    given = list(sys.argv[1:] if arguments is None else arguments)
    ours = given[: (given + ['--ros-args']).index('--ros-args')]
    options = parser.parse_args(ours)
    if not (options.controller or options.closed_loop):
        if options.params or options.overrides or selection(options):
            parser.error('--params, -p and the part of the bag are for --controller')
        try:
            player = import_module('impulse_control_ros.nodes.player')
        except ModuleNotFoundError as error:
            raise MissingPackageError(
                f'{error.name} is missing: playing a bag needs ROS 2'
            ) from None
        return int(player.main(stop, DESCRIPTION, add_options))
    if options.closed_loop and (options.params or options.overrides):
        parser.error('--params and -p are for --controller')
    if (
        ours != given
        or options.loop
        or options.start_paused
        or options.topics
        or any(value is not None for value in (options.rate, options.start_offset, options.clock))
    ):
        parser.error(
            'ROS arguments, and those for playing on the graph, are not for '
            '--controller and --closed-loop'
        )
    lines, same = compared(options)
    print('\n'.join(lines))
    return 0 if same else 1


def overrides_of(options: argparse.Namespace) -> Mapping[str, Any]:
    """Return the controller's parameters of the command line; raises `ParameterError`."""
    from impulse_control_ros.files.experiment import ControllerParameters
    from impulse_control_ros.files.parameter_file import read_parameters

    given = read_parameters(
        {'controller': ControllerParameters}, options.params, options.overrides
    )['controller']
    # what an experiment does not name has its default
    return ControllerParameters().flat() | given if options.params else given


def compared(options: argparse.Namespace) -> tuple[list[str], bool]:
    """Run the bag again; returns what to print, and whether every message is the same."""
    import numpy as np

    from impulse_control_ros.files.recording import read_bag
    from impulse_control_ros.tools.bag_diff import difference, lines_of, same
    from impulse_control_ros.tools.resimulate import closed_loop, missing_memory, open_loop

    recording = read_bag(options.bag, **selection(options))
    overrides = overrides_of(options)
    if recording.unread is not None:
        warn(
            'replay',
            f'{options.bag} was cut off: {recording.unread} bytes at its end cannot be read',
        )
    if recording.lacks:
        warn('replay', f'{options.bag}: incomplete: {"; ".join(recording.lacks)}')
    try:
        rerun = open_loop(recording, overrides) if options.controller else closed_loop(recording)
    except BagError as error:
        raise BagError(f'{options.bag}: {error}') from None
    found = {topic: difference(*pair) for topic, pair in rerun.pairs.items()}
    commands = found['joint_commands']
    if not len(commands.common):
        raise BagError(f'{options.bag}: no command in it answers one of its states')
    # a run that is ended may leave its last state unanswered
    absent = int(np.count_nonzero(commands.new < recording.states['stamp'][-1]))
    # what a finished bag lacks without having said so
    identical = same(found) and absent <= int(recording.recording_summary.get('missing', absent))
    memory = missing_memory(recording) if options.controller and not overrides else ''
    lacks = f' of the bag is the same, to the bit; {absent} commands are not in it'
    return [
        f'{options.bag}: {len(recording.states)} states, {rerun.changes} changes on the way',
        *(
            f'with {name} = {value!r}'
            for name, value in overrides.items()
            if any(change.values.get(name) != value for change in recording.controllers)
        ),
        *lines_of(found),
        ': '.join(filter(None, ('it differs', memory)))
        if not identical
        else 'every message' + (lacks if absent else ' is the same, to the bit'),
    ], identical
