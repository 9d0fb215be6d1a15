"""Reset, pause, step and quit of a plant: the services ~/reset, ~/pause and ~/step."""

from time import monotonic
from typing import Any

from std_srvs.srv import SetBool, Trigger


class SimulationControl:
    """
    The requests to ``plant``, a `PlantSimulator`, which acts on them between two samples.

    ``paused``, ``quitting`` and ``reset_wanted`` are the pending requests.
    """

    def __init__(self, plant: Any) -> None:
        self.paused = self.quitting = self.reset_wanted = False
        self._plant = plant
        self._steps_left = 0
        plant.create_service(Trigger, '~/reset', self._on_reset)
        plant.create_service(SetBool, '~/pause', self._on_pause)
        plant.create_service(Trigger, '~/step', self._on_step)

    def reset(self) -> bool:
        """Request a reset at the next state; returns False if there is no next state."""
        self.reset_wanted = self._plant.has_next
        return self.reset_wanted

    def pause(self, paused: bool) -> None:
        """Pause or resume."""
        self.paused, self._steps_left = paused, 0
        self._plant.pacer.restart(self._plant.clock.tick, monotonic())

    def step(self, samples: int) -> bool:
        """Request more ``samples`` while paused; returns False if not paused."""
        if self.paused:
            self._steps_left += samples
        return self.paused

    def quit(self) -> None:
        """End the run at the present state."""
        self.quitting = True

    @property
    def holds(self) -> bool:
        """Whether a pause holds the next sample."""
        return self.paused and not self._steps_left

    def take_step(self) -> bool:
        """Claim the next sample; False while a pause or the real time factor holds it."""
        pacer, tick = self._plant.pacer, self._plant.clock.tick
        if self.holds:
            return False
        if self.paused:
            self._steps_left -= 1
        elif pacer.wall_step:
            now = monotonic()
            if now < pacer.due(tick):
                return False
            pacer.made(tick, now)
        return True

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        clock, start = self._plant.clock, self._plant.parameters
        response.success = self.reset()
        response.message = (
            f'the state at {clock.seconds(1)} s is x_0 = {start.x_0:g} m, v_0 = {start.v_0:g} m/s'
            if response.success
            else 'refused: there is no run'
        )
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = True
        self.pause(request.data)
        response.message = (
            f'{"paused" if request.data else "running"} at {self._plant.clock.seconds()} s'
        )
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        samples = self._plant.parameters.step_ticks
        response.success = self.step(samples)
        count = f'{samples} sample{"s" if samples > 1 else ""}'
        response.message = (
            f'{count} from {self._plant.clock.seconds()} s'
            if response.success
            else 'refused: pause first'
        )
        return response
