"""The barrier of a node: every input passes here, and no error of an input ends the node.

A callback may fail in ways that its author did not think of. Its caller then gets a refusal, the
node's diagnostics have it, and the log has the traceback, since it is a defect.
"""

import traceback
from collections.abc import Awaitable, Callable
from functools import wraps
from typing import Any, Protocol

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException

from arm_emulator.base.memory import is_out_of_memory
from arm_emulator.base.refusal import Refusal

LOG_PERIOD = 5.0  # s, wall: between two tracebacks


class Restart(Exception):
    """A node must clean up and start again."""


class Guarded(Protocol):
    """A node behind the barrier."""

    @property
    def refuse(self) -> Callable[..., None]:
        """Take a topic or a service, and the reason for which an input of it is refused."""

    @property
    def context(self) -> Context:
        """Context of the node."""

    def get_logger(self) -> Any:
        """Return the log of the node."""


def convert_to_refusal(node: Guarded, where: str, error: Exception, is_service: bool) -> Refusal:
    """Return what a callback has raised as a refusal; report it where the sender gets no answer.

    Raises:
        Exception: an error of the node itself, which has to end or to start again.
    """
    ends = isinstance(error, Restart | ExternalShutdownException) or not node.context.ok()
    if ends or is_out_of_memory(error):
        raise error
    if isinstance(error, Refusal):
        if not is_service:
            node.refuse(where, error)
        return error
    actual = f"{type(error).__name__}: {error}"
    reason = Refusal(where, "input", "be processed without an error", actual)
    lines = "".join(traceback.format_exception(error, limit=-20))
    node.get_logger().error(lines, throttle_duration_sec=LOG_PERIOD)
    node.refuse(where, reason)
    return reason


def guard_callback(
    node: Guarded,
    where: str,
    callback: Callable[..., Any],
    refused: Callable[..., Any] | None = None,
    check: Callable[[], None] = lambda: None,
) -> Callable[..., Any]:
    """Return a callback that does not fail.

    Args:
        node: the node.
        where: its topic or service.
        callback: the callback.
        refused: gets the reason and the callback's arguments, and returns an answer; None: the
            sender gets no answer.
        check: called before; may refuse.
    """

    @wraps(callback)
    def call_guarded(*arguments: Any) -> Any:
        try:
            check()
            return callback(*arguments)
        except Exception as error:
            reason = convert_to_refusal(node, where, error, refused is not None)
            return refused(reason, *arguments) if refused is not None else None

    return call_guarded


def guard_coroutine(
    node: Guarded,
    where: str,
    callback: Callable[..., Awaitable[Any]],
    refused: Callable[..., Any],
    check: Callable[[], None] = lambda: None,
) -> Callable[..., Awaitable[Any]]:
    """Return a coroutine function that does not fail, see `guard_callback`."""

    @wraps(callback)
    async def call_guarded(*arguments: Any) -> Any:
        try:
            check()
            return await callback(*arguments)
        except Exception as error:
            return refused(convert_to_refusal(node, where, error, is_service=True), *arguments)

    return call_guarded


def refuse_request(reason: Refusal, request: Any, response: Any) -> Any:
    """Write a refusal into the response of a service, as far as its type has room for one."""
    failed = SetParametersResult(successful=False, reason=str(reason))
    if isinstance(response, SetParameters.Response):
        response.results = [failed] * len(request.parameters)
    elif isinstance(response, SetParametersAtomically.Response):
        response.result = failed
    elif hasattr(response, "success"):
        response.success = False
        if hasattr(response, "message"):
            response.message = str(reason)
    return response


def set_singly(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Return a callback of set_parameters that calls another one for each parameter.

    Those before one that fails are set, and reported so.
    """

    def set_each(request: SetParameters.Request, response: SetParameters.Response) -> Any:
        for parameter in request.parameters:
            only = SetParameters.Request(parameters=[parameter])
            response.results.extend(callback(only, SetParameters.Response()).results)
        return response

    return set_each
