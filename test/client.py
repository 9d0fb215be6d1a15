"""A rclpy node of the tests' own, which talks to the processes on a graph."""

from collections.abc import Callable, Iterable
import time

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.publisher import Publisher

from impulse_control_ros.nodes.transport import prefer_udp
from test.processes import Graph, wait_for

ASK_AGAIN = 2.0
prefer_udp(rclpy.get_rmw_implementation_identifier())  # as the nodes do


class Client:
    """A node on the graph's domain."""

    def __init__(self, graph: Graph) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=graph.domain)
        self.node = rclpy.create_node('test_client', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._services: dict[str, object] = {}
        self._reports: dict[str, dict[str, str]] = {}

    def spin_until(self, condition: Callable[[], object], what: str) -> object:
        """Serve the node until ``condition`` is true; returns its value."""
        return wait_for(condition, what, lambda: self._executor.spin_once(timeout_sec=0.05))

    # -- services ---------------------------------------------------------------------------

    def call(self, service: str, kind: type, once: bool = False, **request: object) -> object:
        """
        Call a service and return its response.

        A response is lost when the server has not yet matched this client's reader, so the call
        is made again after a while; one that is to be made ``once`` waits until the server has
        answered a client of ours that it discovered later.
        """
        if service not in self._services:
            self._services[service] = self.node.create_client(kind, service)
            if once:
                self._discovered_by(service.rpartition('/')[0])
        client = self._services[service]
        self.spin_until(client.service_is_ready, f'service {service}')
        calls, asked = [], 0.0

        def answered() -> list[object]:
            nonlocal asked
            if not calls or (not once and time.monotonic() > asked + ASK_AGAIN):
                asked = time.monotonic()
                calls.append(client.call_async(kind.Request(**request)))
            return [call for call in calls if call.done()]

        return self.spin_until(answered, f'response of {service}')[0].result()

    def _discovered_by(self, node: str) -> None:
        """Serve until a node has answered a new client: it has discovered what was made before."""
        parameters = f'{node}/get_parameters'
        self._services.pop(parameters, None)
        self.call(parameters, GetParameters)

    def set(self, target: str, **values: object) -> SetParametersResult:
        """Set parameters of a node, all or none."""
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        return self.call(
            f'/{target}/set_parameters_atomically', SetParametersAtomically, parameters=parameters
        ).result

    def get(self, target: str, *names: str) -> list[object]:
        """Return parameters of a node."""
        response = self.call(f'/{target}/get_parameters', GetParameters, names=list(names))
        return [parameter_value_to_python(value) for value in response.values]

    def change_state(self, transition: int) -> str:
        """Ask the managed controller for a transition; returns the state that it is in then."""
        self.call('/controller/change_state', ChangeState, transition=Transition(id=transition))
        return self.call('/controller/get_state', GetState).current_state.label

    def activate(self) -> None:
        """Configure and activate the managed controller."""
        self.change_state(Transition.TRANSITION_CONFIGURE)
        assert self.change_state(Transition.TRANSITION_ACTIVATE) == 'active'

    # -- topics -----------------------------------------------------------------------------

    def listen(self, topic: str, kind: type, qos: object = 1000) -> list[object]:
        """Return a list that grows with the messages of a topic while this node is served."""
        received: list[object] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def publisher(self, topic: str, kind: type, *heard_by: str) -> Publisher:
        """Return a publisher once the nodes ``heard_by`` are matched."""
        made = self.node.create_publisher(kind, topic, 1000)

        def matched() -> bool:
            ends = self.node.get_subscriptions_info_by_topic(topic)
            return {*heard_by} <= {end.node_name for end in ends} and (
                made.get_subscription_count() >= len(ends)
            )

        self.spin_until(matched, f'{heard_by} on {topic}')
        for name in heard_by:
            self._discovered_by(f'/{name}')
        return made

    def reports(self, node: str) -> dict[str, str]:
        """Return what a node said last on /diagnostics, with its ``message``; {} for nothing."""
        if not self._reports:
            self._reports[''] = {}
            self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_report, 100)
        return self._reports.get(f'/{node}', {})

    def _on_report(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self._reports[status.name] = {'message': status.message} | {
                value.key: value.value for value in status.values
            }

    def reported(self, node: str, **values: object) -> dict[str, str]:
        """Serve until a node reports ``values`` on /diagnostics; returns all that it reports."""
        wanted = {name: str(value) for name, value in values.items()}

        def found() -> dict[str, str]:
            report = self.reports(node)
            return report if report.items() >= wanted.items() else {}

        try:
            return self.spin_until(found, f'{wanted} of {node}')
        finally:
            print(node, self.reports(node))

    def recorded(self, commands: int, events: int = 1, controller: str = 'controller') -> None:
        """
        Serve until a recorder misses no command and event that the controller sends from now on.

        ``commands`` and ``events`` are the subscriptions, the recorder's among them, that the
        controller is to have matched: what others have discovered proves nothing of it.
        """
        self.reported(controller, command_subscriptions=commands, event_subscriptions=events)

    def count_of(self, node: str, name: str) -> int:
        """Return a count that a node reports; 0 before its first report."""
        return int(self.reports(node).get(name, 0))

    def nodes(self) -> Iterable[str]:
        """Return the names of the nodes on the graph."""
        return self.node.get_node_names()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)
