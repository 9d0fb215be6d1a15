"""The tools' executables: Ctrl-C is taken before the long imports, see stop.py."""

from importlib import import_module

from impulse_control_ros.stop import StopRequest


def sweep() -> int:
    """Run a study; it may be left at any moment, and at the second Ctrl-C is."""
    stop = StopRequest(patience=1)
    status = int(import_module('impulse_control_ros.tools.sweep').main(stop))
    stop.ignore()
    return status


def simulate() -> int:
    """Make the bag of an experiment; Ctrl-C finishes it with what is there."""
    stop = StopRequest()
    status = int(import_module('impulse_control_ros.tools.simulate').main(stop))
    stop.ignore()
    return status


def replay() -> int:
    """Play a bag, or run it again."""
    stop = StopRequest()
    status = int(import_module('impulse_control_ros.tools.replay').main(stop))
    stop.ignore()
    return status


def paper_figures() -> int:
    """Draw the paper's figures; it may be left at any moment."""
    StopRequest(patience=0)
    return int(import_module('impulse_control_ros.tools.paper.command').main())


def export_bag() -> int:
    """Write a bag as a table; it may be left at any moment."""
    StopRequest(patience=0)
    return int(import_module('impulse_control_ros.tools.export').main())


def analyze() -> int:
    """Say what recorded runs were; it may be left at any moment."""
    StopRequest(patience=0)
    return int(import_module('impulse_control_ros.tools.analyze.command').main())
