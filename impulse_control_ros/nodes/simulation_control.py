"""The services that control the plant's simulation: ~/reset, ~/pause and ~/step."""

from typing import Any

from std_srvs.srv import SetBool, Trigger


class SimulationControl:
    """
    Offers the services of ``plant``, a `PlantSimulator`.

    They ask for what the plant then does between two samples; the answer says at which one.
    """

    def __init__(self, plant: Any) -> None:
        self._plant = plant
        plant.create_service(Trigger, '~/reset', self._on_reset)
        plant.create_service(SetBool, '~/pause', self._on_pause)
        plant.create_service(Trigger, '~/step', self._on_step)

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        plant, start = self._plant, self._plant.parameters
        response.success = plant.reset()
        response.message = (
            f'the state at {plant.seconds(1)} s is x_0 = {start.x_0:g} m, v_0 = {start.v_0:g} m/s'
            if response.success else 'refused: there is no run')
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        plant, response.success = self._plant, True
        plant.pause(request.data)
        response.message = f'{"paused" if request.data else "running"} at {plant.seconds()} s'
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        plant, samples = self._plant, self._plant.parameters.step_ticks
        response.success = plant.step(samples)
        count = f'{samples} sample{"s" if samples > 1 else ""}'
        response.message = (f'{count} from {plant.seconds()} s' if response.success
                            else 'refused: pause first')
        return response
