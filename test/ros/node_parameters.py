"""Parameters of running nodes, set by their services."""

from typing import Any

from network import User
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient


class Parameters:
    """Set parameters as `ros2 param` does."""

    def __init__(self, user: User) -> None:
        self._user = user
        self._clients: dict[str, AsyncParameterClient] = {}

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._clients:
            client = self._clients[node] = AsyncParameterClient(self._user.node, node)
            self._user.wait(f"parameter services of {node}", client.services_are_ready)
            self._user.meet(node)
        return self._clients[node]

    def _answer(self, future: Any) -> Any:
        self._user.wait("an answer about parameters", future.done)
        return future.result()

    def set(self, node: str, **values: Any) -> str:
        """Set parameters at once, __ for dots; return why not, empty if they were set."""
        parameters = [Parameter(name.replace("__", "."), value=v) for name, v in values.items()]
        result = self._answer(self._client(node).set_parameters_atomically(parameters)).result
        assert result.successful != bool(result.reason), result
        return str(result.reason)

    def get(self, node: str, name: str) -> Any:
        values = self._answer(self._client(node).get_parameters([name])).values
        return values[0].double_value

    def describe(self, node: str, names: list[str]) -> dict[str, Any]:
        answer = self._answer(self._client(node).describe_parameters(names))
        return {descriptor.name: descriptor for descriptor in answer.descriptors}

    def names(self, node: str) -> list[str]:
        return list(self._answer(self._client(node).list_parameters()).result.names)
