"""The parameters of plants, as a controller keeps them."""

from rclpy.logging import get_logger

from impulse_control_ros.core.protocol import NodeHeader
from impulse_control_ros.files.experiment import ControllerParameters, PlantParameters
from impulse_control_ros.files.parameter_event import encode_parameter_event
from impulse_control_ros.nodes.known_plants import KnownPlants, MOST


def test_the_plant_in_use_is_kept_however_many_others_are_heard():
    plants, values = KnownPlants(get_logger('test')), PlantParameters().flat()
    runs = [f'{k:08x}' for k in range(3 * MOST)]
    for run in runs:
        plants.on_event(
            encode_parameter_event(1, 0, NodeHeader(run, '/plant_simulator').frame_id, values, {})
        )
        if run == runs[0]:
            plants.adopt(run, ControllerParameters())
    assert [run for run in runs if run in plants] == [runs[0], *runs[-MOST + 1 :]]
    assert not plants.is_free_running(runs[0])
