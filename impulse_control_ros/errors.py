"""Every exception of this package; `ImpulseControlError` catches them all."""


class ImpulseControlError(Exception):
    """Base of the package's exceptions; the message is one line that says what is wrong."""


class ParameterError(ImpulseControlError, ValueError):
    """A refused parameter; the message names it, its value and what is allowed."""


class DivergedError(ImpulseControlError, ArithmeticError):
    """Position or velocity has reached ``bound`` [m, m/s], far below overflow."""

    bound = 1e100

    def __init__(self, position: float, velocity: float, seconds: str) -> None:
        super().__init__(
            f'the loop has diverged: at {seconds} s position = {position:.3g} m, '
            f'velocity = {velocity:.3g} m/s; both must be < {self.bound:g}'
        )


class BagError(ImpulseControlError):
    """A bag that cannot be written or read; the message names the path and the reason."""


class RecordError(ImpulseControlError):
    """A record of an axis that cannot be read or used; the message names the file and why."""


class SweepError(ImpulseControlError, RuntimeError):
    """A sweep that cannot continue; the message says why and what to do."""


class MissingPackageError(ImpulseControlError, ImportError):
    """An optional package is not installed; the message gives the command that installs it."""


class UnreadableError(ImpulseControlError):
    """A JointState lacks the requested values, which ``is_normal`` where others publish too."""

    def __init__(self, reason: str, is_normal: bool = False) -> None:
        super().__init__(reason)
        self.is_normal = is_normal


class MiddlewareError(ImpulseControlError):
    """The ROS middleware encodes messages in a layout that this package does not know."""


class NodeError(ImpulseControlError):
    """A node that is not there or does not answer; the message names it and the nodes found."""


class RefusedError(NodeError):
    """A node refuses new parameters; the message is its reason."""


class ExcitationError(ImpulseControlError, RuntimeError):
    """A motion for identification that ends early; the message says why."""


class UsageError(ImpulseControlError):
    """A command line cannot be carried out; the message says why."""
