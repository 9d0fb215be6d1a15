"""The tools' executables: Ctrl-C is taken before the long imports, see stop.py."""

from importlib import import_module

from impulse_control_ros.stop import StopRequest


def sweep() -> int:
    """Run a study."""
    stop = StopRequest()
    status = int(import_module('impulse_control_ros.tools.sweep').main(stop))
    stop.ignore()
    return status


def paper_figures() -> int:
    """Draw the paper's figures; it ends at once at Ctrl-C, for what it writes is whole."""
    return int(import_module('impulse_control_ros.tools.paper.command').main())
