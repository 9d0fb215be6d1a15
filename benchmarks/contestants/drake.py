"""Drake: a LeafSystem in Python whose witness functions trigger unrestricted updates."""

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    DiagramBuilder,
    LeafSystem,
    UnrestrictedUpdateEvent,
    WitnessFunctionDirection,
)
from pydrake.systems.primitives import LogVectorOutput

READING = 'ONE_JUMP'
KIND = 'interpreted'
PACKAGES = ('drake',)


class Loop(LeafSystem):
    """The closed loop; the direction of the motion is a discrete state."""

    def __init__(self, case):
        LeafSystem.__init__(self)
        self.case, self.rate = case, (case.d + case.D) / case.m
        self.stiffness, self.friction = case.K / case.m, case.F_c / case.m
        self.DeclareStateOutputPort('state', self.DeclareContinuousState(1, 1, 0))
        self.DeclareDiscreteState([-1.0])
        self.witnesses = [
            self.MakeWitnessFunction(
                'position_zero',
                WitnessFunctionDirection.kCrossesZero,
                lambda context: context.get_continuous_state_vector().GetAtIndex(0),
                UnrestrictedUpdateEvent(self.at_position_zero),
            ),
            self.MakeWitnessFunction(
                'velocity_zero',
                WitnessFunctionDirection.kCrossesZero,
                lambda context: context.get_continuous_state_vector().GetAtIndex(1),
                UnrestrictedUpdateEvent(self.at_velocity_zero),
            ),
        ]

    def DoGetWitnessFunctions(self, context):  # noqa: N802 (Drake's name)
        """Name the guards."""
        return self.witnesses

    def DoCalcTimeDerivatives(self, context, derivatives):  # noqa: N802 (Drake's name)
        """Flow in one direction."""
        x, v = context.get_continuous_state_vector().CopyToVector()
        direction = context.get_discrete_state_vector().GetAtIndex(0)
        derivatives.get_mutable_vector().SetFromVector(
            [v, -self.rate * v - self.stiffness * x - self.friction * direction]
        )

    def at_position_zero(self, context, event, state):
        """Jump at x = 0."""
        v = self.case.bounce * context.get_continuous_state_vector().GetAtIndex(1)
        self.jump(state, 0.0, v)

    def at_velocity_zero(self, context, event, state):
        """Jump at v = 0."""
        x = context.get_continuous_state_vector().GetAtIndex(0)
        self.jump(state, x, -self.case.kick * x)

    def jump(self, state, x, v):
        """Set the state after a jump."""
        state.get_mutable_continuous_state().get_mutable_vector().SetFromVector([x, v])
        state.get_mutable_discrete_state().get_mutable_vector().SetAtIndex(
            0, 1.0 if v > 0.0 else -1.0
        )


def prepare(case):
    """Return the run."""
    builder = DiagramBuilder()
    loop = builder.AddSystem(Loop(case))
    log = LogVectorOutput(loop.get_output_port(), builder)
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    context.SetAccuracy(3e-8)  # without it, Drake does not locate events
    simulator.get_mutable_integrator().set_target_accuracy(3e-8)

    def run():
        log.FindMutableLog(context).Clear()
        context.SetTime(0.0)
        context.SetContinuousState([case.x_0, -case.kick * case.x_0])
        context.SetDiscreteState([-1.0])
        simulator.Initialize()
        simulator.AdvanceTo(case.seconds)
        kept = log.FindLog(context)
        return kept.sample_times(), kept.data()[0]

    return run
