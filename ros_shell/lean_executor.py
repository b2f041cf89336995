"""An executor for one node with little to do per message.

rclpy's SingleThreadedExecutor collects all entities of a node anew, and makes a coroutine and a
task, for every message: on the order of 0.3 ms of Python each time, more than a servo period can
spare in lock-step. This one collects them now and then, and calls plain callbacks.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

# s, wall: how often new entities are looked for, and those served that are left to rclpy's own
# executor (QoS events, clients, guard conditions).
HOUSEKEEPING = 0.2


class LeanExecutor:
    """Serves the subscriptions, timers and services of one node in the calling thread.

    Callbacks are plain functions and run one after the other, as with SingleThreadedExecutor.

    Args:
        node: the node to serve.
        housekeeping: see `HOUSEKEEPING`; a node with actions, which are among what is left to
            rclpy's executor, wants it shorter [s, wall].
    """

    def __init__(self, node: Node, housekeeping: float = HOUSEKEEPING) -> None:
        self._node = node
        self._housekeeping = housekeeping
        self._context = node.context
        self._rest = SingleThreadedExecutor(context=node.context)
        self._rest.add_node(node)

    def spin(self) -> None:
        """Serve until the context is shut down.

        Raises:
            ExternalShutdownException: it was, as by a signal.
        """
        while True:
            with ExitStack() as held:
                self._serve(held, until=time.monotonic() + self._housekeeping)
            self._rest.spin_once(timeout_sec=0.0)

    def _serve(self, held: ExitStack, until: float) -> None:
        node = self._node
        subscriptions, timers, services = (
            [(one.handle.pointer, one) for one in many]
            for many in (node.subscriptions, node.timers, node.services)
        )
        for _, one in (*subscriptions, *timers, *services):
            held.enter_context(one.handle)
        context: Any = self._context.handle
        held.enter_context(context)
        waiting: Any = rclpy_implementation.WaitSet(
            len(subscriptions), 0, len(timers), 0, len(services), 0, context
        )
        while (left := until - time.monotonic()) > 0.0:
            waiting.clear_entities()
            for _, subscription in subscriptions:
                waiting.add_subscription(subscription.handle)
            for _, timer in timers:
                waiting.add_timer(timer.handle)
            for _, service in services:
                waiting.add_service(service.handle)
            waiting.wait(int(left * 1e9))
            if not self._context.ok():
                raise ExternalShutdownException
            for _, subscription in _ready(waiting, "subscription", subscriptions):
                self._take_message(subscription)
            for _, timer in _ready(waiting, "timer", timers):
                if timer.handle.is_timer_ready():
                    timer.handle.call_timer()
                    timer.callback()
            for _, service in _ready(waiting, "service", services):
                self._take_request(service)

    def _take_message(self, subscription: Any) -> None:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        if subscription._callback_type is subscription.CallbackType.MessageOnly:
            subscription.callback(taken[0])
        else:
            subscription.callback(*taken)

    def _take_request(self, service: Any) -> None:
        request, header = service.handle.service_take_request(service.srv_type.Request)
        if header is not None:
            response = service.callback(request, service.srv_type.Response())
            service.send_response(response, header)


def _ready(waiting: Any, kind: str, entities: list[tuple[int, Any]]) -> list[tuple[int, Any]]:
    pointers = waiting.get_ready_entities(kind)
    return [entity for entity in entities if entity[0] in pointers] if pointers else []
