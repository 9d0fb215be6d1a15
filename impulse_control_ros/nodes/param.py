"""The verbs of ``param``, with the words and the output of ``ros2 param``."""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
import os
from time import monotonic
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
import rclpy
from rclpy.exceptions import NameValidationException
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from impulse_control_ros.command_line import warn
from impulse_control_ros.core.parameter import declared, meant
from impulse_control_ros.errors import NodeError, RefusedError, UsageError
from impulse_control_ros.files.experiment import NODES
from impulse_control_ros.files.parameter_file import base
from impulse_control_ros.files.saved_parameters import node_text, values_of_node, write_experiment
from impulse_control_ros.nodes.parameter_client import node_names, nodes_found, ParameterClient
from impulse_control_ros.nodes.spin import first_line
from impulse_control_ros.nodes.transport import prefer_udp

# by the number in rcl_interfaces/msg/ParameterType
TYPES = (
    *('not set', 'boolean', 'integer', 'double', 'string'),
    *('byte array', 'boolean array', 'integer array', 'double array', 'string array'),
)
LABELS = {bool: 'Boolean', int: 'Integer', float: 'Double', str: 'String', bytes: 'Byte'}
NEEDED = ('plant_simulator', 'controller')  # for an experiment


class Graph:
    """A hidden node that asks the others, each for at most ``timeout`` [s]."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self._node = rclpy.create_node(
            f'_param_{os.getpid()}',
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._serve = partial(self._executor.spin_once, timeout_sec=0.05)

    def client(self, name: str) -> ParameterClient:
        """Return the client of a node; raises `UsageError` for a name that no node can have."""
        full = f'/{name.removeprefix("/")}'
        try:
            return ParameterClient(self._node, full, self._serve, self._timeout)
        except (NameValidationException, UnicodeEncodeError) as error:
            raise UsageError(f'invalid node {name!r}: {first_line(error)}') from None

    def nodes(
        self, spin_time: float, with_hidden: bool = False, needed: Sequence[str] = ('',)
    ) -> list[str]:
        """
        Return the nodes found within ``spin_time`` [s].

        Wait longer, up to the timeout, for a name with each of the ``needed`` ends.
        """
        found: list[str] = []
        began = monotonic()
        while (passed := monotonic() - began) < spin_time or (
            passed < self._timeout
            and not all(any(name.endswith(one) for name in found) for one in needed)
        ):
            self._serve()
            found = node_names(self._node, with_hidden)
        return found

    def close(self) -> None:
        """Shut down the executor, and destroy the node."""
        self._executor.shutdown()
        self._node.destroy_node()


@contextmanager
def joined(timeout: float) -> Iterator[Graph]:
    """Join the graph of the environment's ROS domain."""
    prefer_udp(rclpy.get_rmw_implementation_identifier())
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    graph = Graph(timeout)
    try:
        yield graph
    finally:
        graph.close()
        rclpy.try_shutdown()


def carry_out(verb: str, options: argparse.Namespace) -> None:
    """Carry out a verb; raises `ImpulseControlError`."""
    with joined(options.timeout) as graph:
        VERBS[verb](graph, options)


def list_parameters(graph: Graph, options: argparse.Namespace) -> None:
    """Print the names of the parameters of one node, or of all nodes."""
    if options.node_name:
        print_names(graph.client(options.node_name), options)
        return
    for name in graph.nodes(options.spin_time, options.include_hidden_nodes):
        try:
            print_names(graph.client(name), options, f'{name}:\n')
        except NodeError as error:
            warn('param', str(error))


def print_names(client: ParameterClient, options: argparse.Namespace, title: str = '') -> None:
    """Print the names of the parameters of a node."""
    names = [name for name in client.list(options.param_prefixes) if options.filter.match(name)]
    types = {}
    if options.param_type:
        types = {one.name: f' (type: {TYPES[one.type]})' for one in client.describe(names)}
    lines = ''.join(f'  {name}{types.get(name, "")}\n' for name in names)
    if lines:
        print(title + lines, end='')


def get(graph: Graph, options: argparse.Namespace) -> None:
    """Print the value of a parameter."""
    client, name = graph.client(options.node_name), options.parameter_name
    value = client.get([name])[name]
    if value is None:
        raise lacks(client, 'Parameter not set', name)
    if options.hide_type:
        print(value)
    elif isinstance(value, list):
        kind = LABELS[type(value[0])] if value else TYPES[client.describe([name])[0].type]
        print(f'{kind.removesuffix(" array").capitalize()} values are: {value}')
    else:
        print(f'{LABELS[type(value)]} value is: {value}')


def lacks(client: ParameterClient, what: str, name: str) -> NodeError:
    """Return the error for a parameter that a node does not have."""
    return NodeError(f'{what}: {name} of {client.target}{meant(name, client.list())}')


def set_parameters(graph: Graph, options: argparse.Namespace) -> None:
    """Set parameters, all or none."""
    require_set(graph.client(options.node_name), options.values, 'Setting parameter failed')
    print('Set parameter successful')


def require_set(client: ParameterClient, values: Mapping[str, Any], failed: str) -> None:
    """Set all values or none; raises `RefusedError` with the node's reason."""
    try:
        client.set_atomically(values)
    except RefusedError as error:
        raise RefusedError(f'{failed}: {error}') from None


def describe(graph: Graph, options: argparse.Namespace) -> None:
    """Print what a node tells about its parameters."""
    client, names = graph.client(options.node_name), options.parameter_names
    found = client.describe(names)
    if not found:
        known = client.list()
        unknown = [name for name in names if name not in known] or names
        raise lacks(client, 'Parameter not declared', unknown[0])
    for one in found:
        print('\n'.join(described(one)))


def described(one: ParameterDescriptor) -> Iterator[str]:
    """Yield the lines on a parameter."""
    yield f'Parameter name: {one.name}'
    yield f'  Type: {TYPES[one.type]}'
    if one.description:
        yield f'  Description: {one.description}'
    yield '  Constraints:'
    if one.read_only:
        yield '    Read only: true'
    for bounds in [*one.floating_point_range, *one.integer_range][:1]:
        yield f'    Min value: {bounds.from_value}'
        yield f'    Max value: {bounds.to_value}'
        if bounds.step:
            yield f'    Step: {bounds.step}'
    if one.additional_constraints:
        yield f'    Additional constraints: {one.additional_constraints}'


def dump(graph: Graph, options: argparse.Namespace) -> None:
    """Print all values of a node as a parameter file, or save those of our nodes."""
    if options.save:
        save_experiment(graph, options)
        return
    client = graph.client(options.node_name)
    values = client.get(client.list())
    has_value = {name: value for name, value in values.items() if value is not None}
    print(node_text(client.target, has_value))


def save_experiment(graph: Graph, options: argparse.Namespace) -> None:
    """Write the running values of our nodes in one namespace as an experiment."""
    given = options.namespace.rstrip('/')
    found = graph.nodes(options.spin_time, needed=[f'{given}/{kind}' for kind in NEEDED])
    ours = [
        name
        for name in found
        if base(name) in NODES and (not options.namespace or name == f'{given}/{base(name)}')
    ]
    spaces = sorted({name.rpartition('/')[0] or '/' for name in ours})
    if not ours:
        raise NodeError(f'Node not found: {", ".join(NODES)}; {nodes_found(found)}')
    if len(spaces) > 1:
        raise UsageError(f'our nodes are in {", ".join(spaces)}: choose one with --namespace')
    write_experiment(options.save, {base(name): values_of(graph.client(name)) for name in ours})
    for kind in {*NEEDED} - {*map(base, ours)}:
        warn('param', f'{kind} is not running: {options.save} has no values of it')
    print(f'saved {", ".join(ours)} to {options.save}')


def values_of(client: ParameterClient) -> dict[str, Any]:
    """Return the values of one of our nodes; raises `NodeError` if it is another's."""
    values = client.get(name for name, _, _ in declared(NODES[base(client.target)]))
    for name, value in values.items():
        if value is None:
            raise lacks(client, 'Parameter not set', name)
    return values


def load(graph: Graph, options: argparse.Namespace) -> None:
    """Set the values that a parameter file has for a node, all or none."""
    client = graph.client(options.node_name)
    values = values_of_node(
        options.parameter_file, client.target, client.list(), not options.no_use_wildcard
    )
    require_set(client, values, f'{options.parameter_file}: setting parameters failed')
    for name in values:
        print(f'Set parameter {name} successful')


def delete(graph: Graph, options: argparse.Namespace) -> None:
    """Delete a parameter; most nodes refuse this."""
    client = graph.client(options.node_name)
    require_set(client, {options.parameter_name: None}, 'Deleting parameter failed')
    print('Deleted parameter successfully')


VERBS: dict[str, Callable[[Graph, argparse.Namespace], None]] = {
    'list': list_parameters,
    'get': get,
    'set': set_parameters,
    'describe': describe,
    'dump': dump,
    'load': load,
    'delete': delete,
}
