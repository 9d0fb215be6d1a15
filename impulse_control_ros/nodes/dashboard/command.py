"""The command line of the dashboard."""

import argparse
from importlib.util import find_spec
import os
import secrets
import socket
import sys
from typing import Any
import webbrowser

from impulse_control_ros.command_line import StopRequest
from impulse_control_ros.errors import MissingPackageError
from impulse_control_ros.nodes.child import remappings
from impulse_control_ros.nodes.spin import main as run_node, Maker

LOCAL = ('127.0.0.1', 'localhost', '::1')
ALL = ('0.0.0.0', '::')  # noqa: S104 (only compared)
PORT = 8090


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that are not ROS arguments."""
    parser.add_argument(
        '--port', type=int, default=PORT, metavar='N', help='default: %(default)s; 0 for any'
    )
    parser.add_argument('--no-browser', action='store_true', help='do not open a browser')
    parser.add_argument(
        '--host',
        default=LOCAL[0],
        metavar='ADDRESS',
        help='address to serve on (default: %(default)s, this machine only); any other needs the '
        'token in the printed address',
    )


def address(host: str, port: int, token: str) -> str:
    """Return the address of the page; on all addresses of this machine, by its name."""
    name = socket.gethostname() if host in ALL else f'[{host}]' if ':' in host else host
    return f'http://{name}:{port}/' + (f'?token={token}' if token else '')


def main(stop: StopRequest) -> int:
    """Run the node; raises `MissingPackageError` without Bokeh."""
    if find_spec('bokeh') is None:
        raise MissingPackageError(
            "bokeh is missing: pip install 'impulse_control_ros[dashboard]', or pip install bokeh"
        )

    def makers(options: argparse.Namespace) -> list[Maker]:
        def make() -> Any:
            from impulse_control_ros.nodes.dashboard.node import Dashboard

            token = '' if options.host in LOCAL else secrets.token_urlsafe(16)
            node = Dashboard(options.host, options.port, token, remappings(sys.argv))
            url = address(options.host, node.server.port, token)
            node.get_logger().info(f'open {url}')
            has_display = os.environ.get('DISPLAY') or os.environ.get('WAYLAND_DISPLAY')
            if has_display and not options.no_browser:
                webbrowser.open(url)
            return node

        return [make]

    return run_node(
        stop,
        'dashboard',
        'A page in the browser that shows a run and tunes its nodes.',
        makers,
        'joint_name:=axis',
        add_options,
    )
