"""
The services of the standard simulation_interfaces, if that package is installed.

These services complement simulation_control.py and make the same requests. Simulated time never
goes back, and a waiting callback would block the lockstep that it waits for. The services
therefore deviate from the standard:

* step_simulation responds when the steps are requested, not when they are done;
* reset_simulation resets the state and lets time continue, also for SCOPE_DEFAULT, which the
  standard defines as everything; a scope that includes time is rejected;
* STATE_STOPPED is rejected, because a stopped simulation restarts from its initial time;
* the action simulate_steps is not offered.
"""

from collections.abc import Callable
from typing import Any

Outcome = tuple[int, str]

STEPS_ASKED_FOR = 'step_simulation responds when the steps are requested'
STATE_ALONE = 'reset_simulation resets the state only; time continues'
ENDING = 'the run is ending'


def standard_types(logger: Any) -> tuple[Any, Any] | None:
    """Return the messages and services of simulation_interfaces; None if it is missing."""
    try:
        # import the C module too: a package built for another Python must not stop a plant
        from simulation_interfaces import msg, simulation_interfaces_s__rosidl_typesupport_c, srv

        del simulation_interfaces_s__rosidl_typesupport_c
    except ModuleNotFoundError:
        return None
    except ImportError as error:
        logger.warning(f'the services of simulation_interfaces are not offered: {error}')
        return None
    return msg, srv


class SimulationInterfaces:
    """
    Offers the services of simulation_interfaces for ``plant``, a `PlantSimulator`.

    A service whose type an older simulation_interfaces lacks is neither offered nor listed.
    """

    def __init__(self, plant: Any) -> None:
        self._plant = plant
        self._features: list[int] = []
        types = standard_types(plant.get_logger())
        if types is None:
            return
        msg, self._srv = types
        self._results, self._states, self._ids = (
            msg.Result,
            msg.SimulationState,
            msg.SimulatorFeatures,
        )
        plant.create_service(
            self._srv.GetSimulatorFeatures, '~/get_simulator_features', self._get_features
        )
        self._offer(
            'GetSimulationState',
            '~/get_simulation_state',
            self._get_state,
            'SIMULATION_STATE_GETTING',
        )
        self._offer(
            'SetSimulationState',
            '~/set_simulation_state',
            self._set_state,
            'SIMULATION_STATE_SETTING',
            'SIMULATION_STATE_PAUSE',
        )
        self._offer(
            'StepSimulation',
            '~/step_simulation',
            self._step,
            'STEP_SIMULATION_SINGLE',
            'STEP_SIMULATION_MULTIPLE',
        )
        self._offer(
            'ResetSimulation',
            '~/reset_simulation',
            self._reset,
            'SIMULATION_RESET',
            'SIMULATION_RESET_STATE',
        )

    def _offer(
        self, kind: str, name: str, act: Callable[[Any, Any], Outcome], *features: str
    ) -> None:
        """Offer ``act(request, response)`` as a service, and list its features."""
        if not hasattr(self._srv, kind):
            return

        def callback(request: Any, response: Any) -> Any:
            code, message = act(request, response)
            response.result = self._results(result=code, error_message=message)
            return response

        self._plant.create_service(getattr(self._srv, kind), name, callback)
        self._features += [getattr(self._ids, feature) for feature in features]

    def _get_features(self, _: Any, response: Any) -> Any:
        response.features.features = self._features
        response.features.custom_info = f'{STEPS_ASKED_FOR}; {STATE_ALONE}'
        return response

    def _get_state(self, _: Any, response: Any) -> Outcome:
        response.state.state = self._state()
        return self._results.RESULT_OK, self._plant.control.when

    def _set_state(self, request: Any, response: Any) -> Outcome:
        control, states, wanted = self._plant.control, self._states, request.state.state
        names = {
            states.STATE_PLAYING: 'playing',
            states.STATE_PAUSED: 'paused',
            states.STATE_QUITTING: 'quitting',
        }
        if wanted not in names:
            allowed = ', '.join(f'{name} ({value})' for value, name in names.items())
            return (
                self._results.RESULT_FEATURE_UNSUPPORTED,
                f'state = {wanted}: must be {allowed}',
            )
        if wanted == self._state():
            return response.ALREADY_IN_TARGET_STATE, f'already {names[wanted]} {control.when}'
        if control.quitting:
            return response.INCORRECT_TRANSITION, f'state = {wanted}: {ENDING}'
        if wanted == states.STATE_QUITTING:
            control.quit()
        else:
            control.pause(wanted == states.STATE_PAUSED)
        return self._results.RESULT_OK, f'{names[wanted]} {control.when}'

    def _step(self, request: Any, _: Any) -> Outcome:
        steps, failed = request.steps, self._results.RESULT_OPERATION_FAILED
        if self._plant.control.quitting:
            return failed, f'steps = {steps}: {ENDING}'
        if not self._plant.control.step(steps):
            return failed, f'steps = {steps} is refused while playing: pause first'
        return (
            self._results.RESULT_OK,
            f'{steps} steps requested {self._plant.control.when}; {STEPS_ASKED_FOR}',
        )

    def _reset(self, request: Any, _: Any) -> Outcome:
        plant, scope = self._plant, request.scope
        if scope not in (request.SCOPE_DEFAULT, request.SCOPE_STATE):
            return (
                self._results.RESULT_FEATURE_UNSUPPORTED,
                f'scope = {scope}: must be SCOPE_STATE '
                f'({request.SCOPE_STATE}), for time never goes back and nothing is spawned',
            )
        if plant.control.quitting or not plant.control.reset():
            why = ENDING if plant.clock.tick >= 0 else 'there is no run yet'
            return self._results.RESULT_INCORRECT_STATE, f'scope = {scope}: {why}'
        return self._results.RESULT_OK, f'{plant.control.start}; {STATE_ALONE}'

    def _state(self) -> int:
        control = self._plant.control
        if control.quitting:
            return self._states.STATE_QUITTING
        return self._states.STATE_PAUSED if control.paused else self._states.STATE_PLAYING
