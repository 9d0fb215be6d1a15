"""
Init, spin and shutdown, for every executable.

The EventsExecutor is many times faster than the default one, but its ``spin()`` ignores signals
and uses a full core. The loop therefore calls ``spin_once`` with a timeout. Exiting with a live
executor can crash, so the executor, the nodes and the context are shut down in this order.
"""

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
import inspect
import sys
from time import perf_counter, sleep
from typing import Any

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from impulse_control_ros.command_line import Parser, StopRequest
from impulse_control_ros.errors import BagError, ImpulseControlError, ParameterError
from impulse_control_ros.files.parameter_file import (
    command_line_sections,
    require_known_nodes,
    unused,
)
from impulse_control_ros.nodes.transport import place_on_core, prefer_udp

IDLE = 0.1
MOST_EVENTS = 50
EMPTY_TURN = 40e-6
ANSWER = 0.2  # s for the answer of a service that ended the nodes: DDS sends it again if lost
Maker = Callable[[], Any]


def make_executor() -> Executor:
    """Return an EventsExecutor, or the standard one, with a log line, if rclpy has none."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        rclpy.logging.get_logger('impulse_control_ros').info(
            'this rclpy has no EventsExecutor: the standard executor is several times slower'
        )
        return SingleThreadedExecutor()
    return EventsExecutor()


def spin(
    nodes: Sequence[Any], stop: StopRequest, between: Callable[[], bool] | None = None
) -> None:
    """
    Serve the nodes until one is finished or a stop is requested; then close them in order.

    In addition to rclpy's interface, a node has ``finished``; ``failure``, the reason if it
    failed; ``poll()``, which does the work due on the wall clock and returns the seconds until the
    next call; and ``close()``, which flushes pending data. ``between`` does other work between the
    executor's turns, and returns whether it wants the next turn at once.
    """
    executor = make_executor()
    try:
        for node in nodes:
            executor.add_node(node)
        while not stop.requested:
            busy = between and between()
            timeout, finished = IDLE, False
            for node in nodes:
                timeout = min(timeout, node.poll())
                finished = finished or node.finished
            if finished:
                break
            if busy:
                serve_what_waits(executor)
            else:
                executor.spin_once(timeout_sec=timeout)
    except BaseException:
        for node in nodes:  # save the recording, whatever went wrong
            with suppress(Exception):
                node.close()
        raise
    else:
        for node in nodes:
            node.close()
        if not stop.requested:
            sleep(ANSWER)
    finally:
        executor.shutdown()


def serve_what_waits(executor: Executor) -> None:
    """Serve the pending events; a turn longer than EMPTY_TURN means that none is left."""
    for _ in range(MOST_EVENTS):
        began = perf_counter()
        executor.spin_once(timeout_sec=0.0)
        if perf_counter() - began > EMPTY_TURN:
            return


def main(
    stop: StopRequest,
    prog: str,
    description: str,
    makers: Callable[[argparse.Namespace], list[Maker]],
    example: str,
    add_options: Callable[[argparse.ArgumentParser], None] | None = None,
    between: Callable[[], bool] | None = None,
) -> int:
    """
    Run the nodes of an executable; return the exit status.

    ``makers`` returns the factories of the nodes for the parsed options; ``example`` is a
    parameter for the help. The exit status is 0 on success, 2 for invalid arguments or parameters,
    reported in one line, and 1 for any other error.
    """
    nodes: list[Any] = []
    try:
        options = parse(prog, description, example, add_options)
        prefer_udp(rclpy.get_rmw_implementation_identifier())
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        for make in makers(options):
            nodes.append(make())
        place_on_core(nodes[0].parameters.cpu_core)
        check_command_line(nodes)
    except UnicodeEncodeError as error:
        return leave(nodes, f'{prog}: argument {error.object!a}: must be UTF-8', 2)
    except _rclpy.UnknownROSArgsError as error:
        return leave(nodes, f'{prog}: unknown ROS arguments {error}', 2)
    except (ImpulseControlError, _rclpy.RCLError) as error:
        # the error may already start with the name of the node
        where = '' if str(error).startswith(f'{prog}: ') else f'{prog}: '
        return leave(nodes, where + first_line(error), 2)
    # else rclpy's first log line does this, and a robot waits tens of ms for its first effort
    inspect.getmodule(inspect.currentframe())
    try:
        spin(nodes, stop, between)
    except (BagError, OSError) as error:
        return leave(nodes, f'{prog}: {error}', 1)
    except BaseException:
        leave(nodes, '', 1)
        raise
    failure = next(filter(None, (node.failure for node in nodes)), None)
    if failure:
        return leave(nodes, f'{prog}: {failure}', 2 if isinstance(failure, ParameterError) else 1)
    return leave(nodes, '', 0)


def check_command_line(nodes: Sequence[Any]) -> None:
    """Raise `ParameterError` for parameters that reach no node; a file may be for other nodes."""
    sections = list(command_line_sections(sys.argv))
    kinds = {node.get_fully_qualified_name(): type(node.parameters) for node in nodes}
    if len(nodes) > 1:
        require_known_nodes(sections, kinds)
    for what in unused(sections, kinds):
        if len(nodes) > 1 or what.startswith('-p '):
            raise ParameterError(what)
        nodes[0].get_logger().warning(what)


def leave(nodes: Sequence[Any], message: str, status: int) -> int:
    """Destroy the nodes, shut down rclpy, print the ``message``; return ``status``."""
    for node in reversed(nodes):
        node.destroy_node()
    rclpy.try_shutdown()
    if message:
        print(message, file=sys.stderr)
    return status


def first_line(error: BaseException) -> str:
    """Return rcl's message without its source locations, on one line."""
    return ' '.join(str(error).split(', at /')[0].split(', at ./')[0].split())


def parse(
    prog: str,
    description: str,
    example: str,
    add_options: Callable[[argparse.ArgumentParser], None] | None,
) -> argparse.Namespace:
    """Parse the arguments that are not for ROS; raises `UsageError`."""
    parser = Parser(
        prog=prog,
        description=description,
        epilog='ROS arguments follow --ros-args, e.g. --ros-args --params-file FILE -p '
        f'{example}; all parameters are in docs/reference/parameters.md',
    )
    if add_options:
        add_options(parser)
    return parser.parse_args(remove_ros_args(sys.argv)[1:])
