"""Requests to the parameter services of another node, each until it is answered."""

from collections.abc import Callable, Mapping, Sequence
import math
from time import monotonic
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from impulse_control_ros.errors import ExcitationError

ASK_AGAIN = 2.0  # s: DDS may lose the response of a service that has just been discovered


class Requests:
    """
    At most one request at a time to the node ``target``; `poll` makes it and passes on the answer.

    ``pending`` tells whether there is one.
    """

    def __init__(self, node: Node, target: str) -> None:
        self._client, self._target = AsyncParameterClient(node, target), target
        self._request: Callable[[], Future] | None = None
        self._then: Callable[[Any], None]
        self._response: Future | None = None
        self._since = self._asked = -math.inf

    @property
    def pending(self) -> bool:
        """Whether an answer is waited for."""
        return self._request is not None

    def get(self, names: Sequence[str], then: Callable[[Any], None]) -> None:
        """Get parameters; ``then`` takes the response."""
        self._begin(lambda: self._client.get_parameters(list(names)), then)

    def set(self, values: Mapping[str, Any], then: Callable[[], None]) -> None:
        """Set parameters, all or none, and call ``then``."""

        def judge(response: Any) -> None:
            if not response.result.successful:
                raise ExcitationError(f'{self._target}: {response.result.reason}')
            then()

        given = [Parameter(name, value=value) for name, value in values.items()]
        self._begin(lambda: self._client.set_parameters_atomically(given), judge)

    def _begin(self, request: Callable[[], Future], then: Callable[[Any], None]) -> None:
        self._request, self._then = request, then
        self._response, self._since, self._asked = None, monotonic(), -math.inf

    def poll(self, patience: float) -> None:
        """Make the request, again if need be; raise `ExcitationError` after ``patience`` [s]."""
        if self._request is None:
            return
        now = monotonic()
        if self._response is not None and self._response.done():
            response, self._request = self._response.result(), None
            self._then(response)
        elif now > self._since + patience:
            raise ExcitationError(f'no answer of {self._target} for {patience:g} s')
        elif now > self._asked + ASK_AGAIN and self._client.services_are_ready():
            self._response, self._asked = self._request(), now
