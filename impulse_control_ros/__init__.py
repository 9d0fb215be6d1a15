"""
Impulse-based hybrid motion control (Ruderman, IECON 2017) for ROS 2.

    import impulse_control_ros as ic
    ic.simulate(ic.Plant(F_c=1.0), ic.ControlGains(), duration=5.0).plot()

Each name below is imported when it is first used.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from impulse_control_ros import errors
    from impulse_control_ros.core import metrics
    from impulse_control_ros.core.batch import simulate_batch
    from impulse_control_ros.core.check import check_run
    from impulse_control_ros.core.control_gains import ControlGains
    from impulse_control_ros.core.damping import Damping
    from impulse_control_ros.core.design import check_gains
    from impulse_control_ros.core.hybrid import Reading, Solution, solve
    from impulse_control_ros.core.identification import Identification, Record
    from impulse_control_ros.core.identify import identify
    from impulse_control_ros.core.nonidealities import Actuator, Disturbance, Payload, Sensor
    from impulse_control_ros.core.plant import Plant
    from impulse_control_ros.core.simulate import Run, simulate
    from impulse_control_ros.core.stribeck import Stribeck
    from impulse_control_ros.files.parameter_file import load_experiment
    from impulse_control_ros.files.recording import read_bag, Recording

__version__ = '0.1.0'
__all__ = [
    'Actuator',
    'ControlGains',
    'Damping',
    'Disturbance',
    'Identification',
    'Payload',
    'Plant',
    'Reading',
    'Record',
    'Recording',
    'Run',
    'Sensor',
    'Solution',
    'Stribeck',
    'check_gains',
    'check_run',
    'errors',
    'identify',
    'load_experiment',
    'metrics',
    'read_bag',
    'simulate',
    'simulate_batch',
    'solve',
]
_HOMES = {
    name: module
    for module, names in {
        'errors': 'errors',
        'core.batch': 'simulate_batch',
        'core.check': 'check_run',
        'core.control_gains': 'ControlGains',
        'core.damping': 'Damping',
        'core.design': 'check_gains',
        'core.hybrid': 'Reading Solution solve',
        'core.identification': 'Identification Record',
        'core.identify': 'identify',
        'core.metrics': 'metrics',
        'core.nonidealities': 'Actuator Disturbance Payload Sensor',
        'core.plant': 'Plant',
        'core.simulate': 'Run simulate',
        'core.stribeck': 'Stribeck',
        'files.parameter_file': 'load_experiment',
        'files.recording': 'Recording read_bag',
    }.items()
    for name in names.split()
}


def __getattr__(name: str) -> Any:
    """Import a name on its first use."""
    if name not in _HOMES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    module = import_module(f'{__name__}.{_HOMES[name]}')
    # metrics and errors are modules themselves
    globals()[name] = value = getattr(module, name, module)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
