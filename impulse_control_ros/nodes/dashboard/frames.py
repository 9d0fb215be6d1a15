"""The frames of the page: the data that are new since the last frame of a window, as JSON."""

from collections.abc import Mapping
import math
from time import monotonic
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor

from impulse_control_ros.core.design import check_gains
from impulse_control_ros.core.parameter import build, declared
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import axis_of, ControllerParameters, PlantParameters
from impulse_control_ros.nodes.dashboard.fields import field_of

BANDS = ('x_r', 'position_deadband', 'velocity_deadband')
GAINS = frozenset(name for name, _, _ in declared(ControllerParameters))
ORDER = {
    name: at
    for at, name in enumerate(
        name for kind in (PlantParameters, ControllerParameters) for name, _, _ in declared(kind)
    )
}


class Frames:
    """The frames of ``dashboard``, a `Dashboard`."""

    def __init__(self, dashboard: Any) -> None:
        self._dashboard = dashboard

    def next(self, seen: dict[str, Any]) -> Mapping[str, Any]:
        """Return the data that are not in the window's record ``seen`` yet, and add them to it."""
        run, peers = self._dashboard.run, self._dashboard.peers
        fresh = seen.get('episode') != run.episode
        since = (0, 0) if fresh else seen['counts']
        seen['episode'], seen['counts'] = run.episode, (run.samples.count, run.impulses.count)
        frame = {
            'fresh': fresh,
            'samples': known(run.samples.columns(since[0])),
            'impulses': known(run.impulses.columns(since[1])),
            **self._figures(),
        }
        reports = self._dashboard.reports()
        if seen.get('reports') != reports:
            seen['reports'] = frame['reports'] = reports
        versions = [(role, peer.name, peer.version) for role, peer in peers.items()]
        if seen.get('versions') != versions:
            seen['versions'] = versions
            frame |= self._parameters()
        return frame

    def _figures(self) -> dict[str, Any]:
        """Return the numbers and texts beside the plots."""
        dashboard, run = self._dashboard, self._dashboard.run
        recording = dashboard.recording
        return {
            'fired': run.fired,
            'last': run.last,
            'impulse_rate': run.impulse_rate.value(),
            'speed': run.speed.value(monotonic()),
            'lost': dashboard.inputs.lost,
            'recording': {
                'running': recording.running,
                'state': recording.state,
                'report': recording.report,
            },
            'undo': dashboard.requests.last_change,
        }

    def _parameters(self) -> dict[str, Any]:
        """Return the form fields of both nodes, and the findings on their values."""
        dashboard = self._dashboard
        gains = dashboard.values('controller')
        return {
            'parameters': {
                role: [
                    field_of(one, peer.values.get(one.name)) for one in in_order(peer.described)
                ]
                for role, peer in dashboard.peers.items()
            },
            'knows_law': dashboard.run.knows_law,
            'bands': {name: gains.get(name) for name in BANDS},
            'findings': findings(gains, dashboard.values('plant')),
        }


def in_order(described: Mapping[str, ParameterDescriptor]) -> list[ParameterDescriptor]:
    """Return the parameters that can be set first, ours in the order of their declaration."""
    return sorted(described.values(), key=lambda one: (one.read_only, ORDER.get(one.name, 0)))


def known(columns: dict[str, list[Any]]) -> dict[str, list[Any]]:
    """Return columns with None for nan, which JSON does not have."""
    return {
        name: [
            None if isinstance(one, float) and not math.isfinite(one) else one for one in column
        ]
        for name, column in columns.items()
    }


def findings(gains: Mapping[str, Any], plant: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return level and text of each finding on our controller's parameters; none if foreign."""
    if not gains.keys() >= GAINS:
        return []
    try:
        ours = build(ControllerParameters, {name: gains[name] for name in GAINS})
    except ParameterError as error:
        return [('ERROR', str(error))]
    return [(one.level.name, one.text) for one in check_gains(ours, axis_of(plant))]
