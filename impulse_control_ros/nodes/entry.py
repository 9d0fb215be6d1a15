"""The executables of the nodes; they handle Ctrl-C before the slow imports, see stop.py."""

from importlib import import_module

from impulse_control_ros.stop import StopRequest


def _run(name: str) -> int:
    stop = StopRequest()
    status = int(import_module(f'impulse_control_ros.nodes.{name}').main(stop))
    stop.ignore()
    return status


def plant_simulator() -> int:
    """Run the plant simulator node."""
    return _run('plant_simulator')


def controller() -> int:
    """Run the controller node."""
    return _run('controller')


def recorder() -> int:
    """Run the recorder node."""
    return _run('recorder')


def closed_loop() -> int:
    """Run the three nodes in one process."""
    return _run('closed_loop')
