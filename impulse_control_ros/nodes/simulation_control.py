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
        self.paused = plant.parameters.start_paused
        self.quitting = self.reset_wanted = False
        self._plant, self._logger = plant, plant.get_logger()
        self._steps_left = 0
        plant.create_service(Trigger, '~/reset', self._on_reset)
        plant.create_service(SetBool, '~/pause', self._on_pause)
        plant.create_service(Trigger, '~/step', self._on_step)

    def reset(self) -> bool:
        """Request a reset at the next state; returns False if there is no next state."""
        self.reset_wanted = self._plant.has_next
        if self.reset_wanted:
            self._logger.info(f'reset: {self.start}')
        return self.reset_wanted

    def pause(self, paused: bool) -> None:
        """Pause or resume."""
        if paused != self.paused:
            self._logger.info(f'{"paused" if paused else "resumed"} {self.when}')
        self.paused, self._steps_left = paused, 0
        self._plant.pacer.restart(self._plant.clock.tick, monotonic())

    def step(self, samples: int) -> bool:
        """Request more ``samples`` while paused; returns False if not paused."""
        if self.paused:
            self._steps_left += samples
            self._logger.info(f'steps requested {self.when}: {samples}')
        return self.paused

    def quit(self) -> None:
        """End the run at the present state."""
        self._logger.info(f'quitting {self.when}')
        self.quitting = True

    @property
    def when(self) -> str:
        """The simulated time."""
        clock = self._plant.clock
        return f'at {clock.seconds()} s' if clock.tick >= 0 else 'before the first state'

    @property
    def start(self) -> str:
        """The state after a reset."""
        start = self._plant.parameters
        return (
            f'the state at {self._plant.clock.seconds(1)} s is x_0 = {start.x_0:g} m, '
            f'v_0 = {start.v_0:g} m/s'
        )

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
        response.success = self.reset()
        response.message = self.start if response.success else 'refused: there is no run'
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = True
        self.pause(request.data)
        response.message = f'{"paused" if request.data else "running"} {self.when}'
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        samples = self._plant.parameters.step_ticks
        response.success = self.step(samples)
        count = f'{samples} sample{"s" if samples > 1 else ""}'
        response.message = f'{count} {self.when}' if response.success else 'refused: pause first'
        return response
