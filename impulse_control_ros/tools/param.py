"""
``param``: read and set the parameters of any node, with the words of ``ros2 param``.

The verbs are in nodes/param.py, which alone needs ROS.
"""

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
import re
import sys
from typing import Any

from yaml import YAMLError

from impulse_control_ros.command_line import Parser, StopRequest
from impulse_control_ros.errors import MissingPackageError, ParameterError, UsageError
from impulse_control_ros.files.yaml_file import parsed

DESCRIPTION = 'Read and set the parameters of any node, with the words of ros2 param.'
NEGATIVE = re.compile(r'-[.\d]')


def make_parser() -> tuple[Parser, dict[str, Parser]]:
    """Return the parser, and those of the verbs."""
    parser = Parser(prog='param', description=DESCRIPTION)
    commands = parser.add_subparsers(title='Commands', dest='verb', metavar='VERB')
    verbs = {
        verb: commands.add_parser(verb, help=what, description=what)
        for verb, what in (
            ('delete', 'Delete parameter'),
            ('describe', 'Show descriptive information about declared parameters'),
            ('dump', 'Show all of the parameters of a node in a YAML file format'),
            ('get', 'Get parameter'),
            ('list', 'Output a list of available parameters'),
            ('load', 'Load parameter file for a node'),
            ('set', 'Set parameters, all or none'),
        )
    }
    for verb, added in verbs.items():
        optional: Any = {'nargs': '?', 'default': ''} if verb in ('list', 'dump') else {}
        added.add_argument('node_name', help='Name of the ROS node', **optional)
        added.add_argument(
            '--timeout',
            metavar='N',
            type=seconds,
            default=5.0,
            help='Wait for N seconds until the node answers (default %(default)g)',
        )
    for verb in ('list', 'dump'):
        verbs[verb].add_argument(
            '--spin-time',
            metavar='N',
            type=seconds,
            default=2.0,
            help='Look for nodes for N seconds, or until one is found (default %(default)g)',
        )
    add_arguments(verbs)
    return parser, verbs


def add_arguments(verbs: dict[str, Parser]) -> None:
    """Add the arguments of the verbs beside the node's name."""
    for verb in ('get', 'delete'):
        verbs[verb].add_argument('parameter_name', help='Name of the parameter')
    verbs['get'].add_argument('--hide-type', action='store_true', help='Hide the type information')
    verbs['describe'].add_argument('parameter_names', nargs='+', help='Names of the parameters')
    verbs['set'].add_argument(
        'pairs',
        metavar='parameter_name value',
        nargs='+',
        help='Name of a parameter and its value in YAML; several at once, all or none',
    )
    verbs['load'].add_argument('parameter_file', type=Path, help='Parameter file')
    verbs['load'].add_argument(
        '--no-use-wildcard',
        action='store_true',
        help="Do not load parameters in the '/**' namespace into the node",
    )
    verbs['dump'].add_argument(
        '--save',
        metavar='FILE',
        type=Path,
        help='Write the running plant_simulator, controller and recorder as an experiment, a '
        'parameter file for the next run',
    )
    verbs['dump'].add_argument(
        '--namespace', metavar='NS', default='', help='With --save: the namespace of the nodes'
    )
    listed = verbs['list']
    listed.add_argument(
        '--filter',
        metavar='REGEX',
        type=regex,
        default='',
        help='Only parameters matching the regex expression will be showed',
    )
    listed.add_argument(
        '--include-hidden-nodes', action='store_true', help='Consider hidden nodes as well'
    )
    listed.add_argument(
        '--param-prefixes',
        metavar='PREFIX',
        nargs='+',
        default=[],
        help='Only list parameters with the provided prefixes',
    )
    listed.add_argument(
        '--param-type', action='store_true', help='Print parameter types with parameter names'
    )


def seconds(text: str) -> float:
    """Return a time [s]; raises `ArgumentTypeError`."""
    if not re.fullmatch(r'\d+\.?\d*|\.\d+', text):
        raise argparse.ArgumentTypeError(f'{text!r}: must be a number >= 0 [s]')
    return float(text)


def regex(text: str) -> re.Pattern[str]:
    """Return a regular expression; raises `ArgumentTypeError`."""
    try:
        return re.compile(text)
    except re.error as error:
        raise argparse.ArgumentTypeError(f'{text!r}: {error}') from None


def values_of(pairs: Sequence[str]) -> dict[str, Any]:
    """Return values by name from NAME VALUE NAME VALUE ..., each value in YAML."""
    if len(pairs) % 2:
        raise UsageError(f'the value of {pairs[-1]} is missing (see --help)')
    values: dict[str, Any] = {}
    for name, text in zip(pairs[::2], pairs[1::2], strict=True):
        if name in values:
            raise UsageError(f'{name} is given twice')
        try:
            value = parsed(text)
        except YAMLError:
            raise ParameterError(f'invalid {name} = {text!r}: must be YAML') from None
        values[name] = text if value is None else value
    return values


def main(stop: StopRequest, arguments: Sequence[str] | None = None) -> int:
    """Carry out a verb; returns the exit status."""
    parser, verbs = make_parser()
    given = list(sys.argv[1:] if arguments is None else arguments)
    for one in given:
        if not one.isprintable():
            parser.error(f'argument {one!a}: must be printable UTF-8')
    if given[:1] == ['set']:  # argparse takes -1e-3 for an option, but not with a space
        given = [f' {one}' if NEGATIVE.match(one) else one for one in given]
    options = parser.parse_args(given)
    if options.verb is None:
        parser.print_help()
        return 0
    if options.verb == 'set':
        options.values = values_of(options.pairs)
    if options.verb == 'dump' and bool(options.node_name) == bool(options.save):
        verbs['dump'].error('a node_name or --save FILE is required, not both')
    try:
        carry_out = import_module('impulse_control_ros.nodes.param').carry_out
    except ModuleNotFoundError as error:
        raise MissingPackageError(f'{error.name} is missing: param needs ROS 2') from None
    carry_out(options.verb, options)
    return 0
