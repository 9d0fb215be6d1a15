"""A node that can be managed as a ROS 2 lifecycle node."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from impulse_control_ros.nodes.parameters import ParameterNode
from impulse_control_ros.nodes.spin import first_line


class ManagedNode(ParameterNode, LifecycleNodeMixin):
    """
    A `ParameterNode` that is a lifecycle node once `manage` is called.

    ``active`` is true while the node may act, which is always so for an unmanaged node. Subclasses
    react in `activated` and `deactivated`. The transition to finalized ends the node.
    """

    active = True

    def manage(self) -> None:
        """Start unconfigured, and offer the services of a lifecycle node."""
        self.active = False
        LifecycleNodeMixin.__init__(self)
        change = self._service_change_state
        change.callback = partial(self._change_or_refuse, change.callback)
        self._tell_state()

    def _tell_state(self) -> None:
        self.get_logger().info(f'lifecycle state: {self._state_machine.current_state[1]}')

    def _change_or_refuse(
        self, change: Callable[[Any, Any], Any], request: Any, response: Any
    ) -> Any:
        """Change the state; refuse invalid transitions, which would end the node in rclpy 7."""
        try:
            changed = change(request, response)
            self._tell_state()
            return changed
        except _rclpy.RCLError as error:
            self.get_logger().error(f'invalid lifecycle transition: {first_line(error)}')
            response.success = False
            return response

    def activated(self) -> None:
        """React to becoming active."""

    def deactivated(self) -> None:
        """React to becoming inactive."""

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Become active."""
        self.active = True
        self.activated()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Become inactive."""
        self.active = False
        self.deactivated()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the node, and its process."""
        if self.active:
            self.on_deactivate(state)
        self.finished = True
        return TransitionCallbackReturn.SUCCESS
