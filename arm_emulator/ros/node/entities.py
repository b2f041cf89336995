"""Subscriptions, timers and services of a node, waited for together."""

import inspect
from collections.abc import Collection
from contextlib import ExitStack
from typing import Any, Self

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from arm_emulator.ros.node.sole_publisher import (
    SolePublisher,
    call_back,
    receive_message,
    split_received,
)
from arm_emulator.workarounds.rclpy_internals import call_subscription_back, make_wait_set


class Entities:
    """The entities of a node at this time; in a `with` block none of them is released.

    A service that waits within its callback is left to rclpy's executor.

    Attributes:
        subscriptions, timers, services: those waited for.
        context: handle of their context.

    Args:
        node: the node.
    """

    def __init__(self, node: Node) -> None:
        self.subscriptions: list[Any] = [*node.subscriptions]
        self.timers: list[Any] = [*node.timers]
        self.services: list[Any] = [
            service
            for service in node.services
            if not inspect.iscoroutinefunction(service.callback)
        ]
        self._owner: Context = node.context
        self.context: Any = node.context.handle
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        for entity in (*self.subscriptions, *self.timers, *self.services):
            self._stack.enter_context(entity.handle)
        self._stack.enter_context(self.context)
        counts = len(self.subscriptions), 1, len(self.timers), 0, len(self.services), 0
        self._all: Any = make_wait_set(counts, self.context)
        self._stack.enter_context(self._all)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def wait_for_events(
        self, seconds: float, subscriptions: list[Any], guard: Any = None, *, alone: bool = False
    ) -> None:
        """Wait for some of the subscriptions, and unless alone for any timer, service or guard.

        Raises:
            ExternalShutdownException: the context was shut down.
        """
        everything = self._all
        everything.clear_entities()
        for subscription in subscriptions:
            everything.add_subscription(subscription.handle)
        if guard is not None:
            everything.add_guard_condition(guard)
        for timer in () if alone else self.timers:
            everything.add_timer(timer.handle)
        for service in () if alone else self.services:
            everything.add_service(service.handle)
        everything.wait(int(max(0.0, seconds) * 1e9))
        if not self._owner.ok():
            raise ExternalShutdownException

    def list_ready_subscriptions(self) -> list[Any]:
        """Return those that have messages."""
        return self._list_ready("subscription", self.subscriptions)

    def has_only_timers(self, timers: Collection[Any]) -> bool:
        """Return whether nothing is ready but some of these timers."""
        others = ("subscription", "service", "guard_condition")
        if any(self._all.get_ready_entities(kind) for kind in others):
            return False
        return all(timer in timers for timer in self._list_ready("timer", self.timers))

    def serve_timers(self) -> None:
        """Call back for each timer that is due."""
        for timer in self._list_ready("timer", self.timers):
            if timer.handle.is_timer_ready():
                timer.handle.call_timer()
                timer.callback()

    def serve_services(self) -> None:
        """Answer a request of each service."""
        for service in self._list_ready("service", self.services):
            request, header = service.handle.service_take_request(service.srv_type.Request)
            if header is not None:
                response = service.callback(request, service.srv_type.Response())
                service.send_response(response, header)

    def _list_ready(self, kind: str, entities: list[Any]) -> list[Any]:
        pointers = self._all.get_ready_entities(kind)
        return (
            [entity for entity in entities if entity.handle.pointer in pointers] if pointers else []
        )


def take_message(subscription: Any, sole: SolePublisher | None = None) -> bool:
    """Call back with the oldest message of a subscription; return whether there was one.

    Args:
        subscription: the subscription.
        sole: the publisher whose messages are taken; None: any.
    """
    if sole is not None:
        received = receive_message(subscription, sole.owner)
        if received is not None:
            call_back(subscription, sole, *split_received(received))
        return received is not None
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is None:
        return False
    call_subscription_back(subscription, taken)
    return True
