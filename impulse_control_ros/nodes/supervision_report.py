"""Reports on the supervision of a controller, in the log and on /diagnostics."""

import math
from typing import Any

from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.impulse_verdicts import (
    ABSENT,
    CONFIRMED,
    GROWING,
    NO_VERDICT,
    OUT_OF_BAND,
    REVERSED,
    STALLED,
    VERDICTS,
)
from impulse_control_ros.core.sampled_controller import SampledController

DIGITS = 4  # of a learnt mass


def reason(verdict: int, ratio: float, used_mass: float, gains: ControlGains) -> str:
    """
    Return the meaning of a verdict other than CONFIRMED, and its likely cause or remedy.

    ``ratio`` is the jump over the one expected for ``used_mass`` [kg].
    """
    return {
        ABSENT: f'no jump was seen within response_timeout = {gains.response_timeout} samples; '
        'friction holds the axis, the delay is longer, or actuator or sensor do not act',
        OUT_OF_BAND: f'jumps are {ratio * gains.m / used_mass:.2g} times what m = {gains.m:g} kg '
        f'gives; {used_mass / ratio if ratio else math.inf:.2g} kg would fit',
        REVERSED: 'the velocity jumped against the impulse; the likely cause is the sign of the '
        'actuator or of the sensor',
        GROWING: 'the error grew beyond its last turning point while impulses acted',
        STALLED: 'impulses at rest hardly bring the axis nearer to the set-point; set a larger '
        'position_deadband',
    }[verdict]


class SupervisionReport:
    """The reports on the supervision of ``law``, the law of the controller ``node``."""

    def __init__(self, node: Any, law: SampledController) -> None:
        self._node, self._law, self._logger = node, law, node.get_logger()
        self.begin()
        node.create_service(Trigger, '~/keep_learnt_mass', self._keep_mass)

    def begin(self) -> None:
        """Start with an empty memory of the law."""
        self._told, self._last, self._ratio, self._suspended = NO_VERDICT, NO_VERDICT, 0.0, False
        self._delay, self._why = 0, ''
        self.parameters_changed()

    def parameters_changed(self) -> None:
        """Read the mass that the next impulse is computed for, and log findings on the delay."""
        self._used_mass = self._law.learnt().used_mass
        self._node.plants.advise_for_delay(self._node.parameters, self._delay)

    def judged(self, verdict: int, ratio: float) -> None:
        """Log a verdict that suspends impulses, or that differs from the last one in the log."""
        learnt, used_mass = self._law.learnt(), self._used_mass
        self._last, self._ratio, self._used_mass = verdict, ratio, learnt.used_mass
        if verdict == CONFIRMED:
            self._advise(learnt.delay)
            return
        why = reason(verdict, ratio, used_mass, self._node.parameters)
        if learnt.is_suspended_anew:
            self.look(ended=True)
            self._why = why
            self._logger.warning(f'impulses suspended for {learnt.suspended:g} s: {why}')
            self._suspended = True
        elif verdict != self._told:
            self._logger.warning(f'impulse {VERDICTS[verdict].replace("_", " ")}: {why}')
        self._told = verdict

    def _advise(self, delay: float) -> None:
        """Log the findings on a delay [s] that has changed by more than a sample."""
        gains = self._node.parameters
        samples = 0 if math.isnan(delay) else round(delay / gains.time_step)
        if abs(samples - self._delay) > 1:
            self._delay = samples
            self._node.plants.advise_for_delay(gains, samples)

    def look(self, ended: bool = False) -> None:
        """Log the end of a suspension."""
        if self._suspended and (ended or not self._law.suspended):
            self._suspended, self._told = False, NO_VERDICT
            self._logger.info('impulses resumed')

    @property
    def suspended(self) -> str:
        """Why impulses are suspended; '' while they are not."""
        return f'impulses suspended: {self._why}' if self._law.suspended else ''

    def values(self) -> dict[str, object]:
        """Return the values on /diagnostics."""
        learnt, counts = self._law.learnt(), self._node.answers.verdicts
        return {
            **dict(zip(VERDICTS[1:], counts[1:], strict=True)),
            'last_verdict': VERDICTS[self._last],
            'last_ratio': f'{self._ratio:.4g}',
            'learnt_mass': f'{learnt.mass:.4g}',
            'learnt_mass_spread': f'{learnt.mass_spread:.2g}',
            'learnt_delay': f'{learnt.delay:.6g}',
            'velocity_noise': f'{learnt.velocity_noise:.3g}',
            'suspended': f'{learnt.suspended:.3f}',
        }

    def _keep_mass(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Set m to the learnt mass."""
        mass, before = self._law.learnt().mass, self._node.parameters.m
        if math.isnan(mass):
            response.message = 'no mass is learnt yet'
            return response
        kept = float(f'{mass:.{DIGITS}g}')
        result = self._node.set_parameters_atomically(
            [Parameter('m', Parameter.Type.DOUBLE, kept)]
        )
        response.success = result.successful
        response.message = result.reason or f'm: {kept:g} kg, before {before:g} kg'
        self._logger.info(f'keep_learnt_mass: {response.message}')
        return response
