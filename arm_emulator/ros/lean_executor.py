"""An executor for one node with little to do per message.

rclpy's SingleThreadedExecutor collects all entities of a node anew, and makes a coroutine and a
task, for every message: on the order of 0.3 ms of Python each time, more than a servo period can
spare in lock-step. This one collects them now and then, waits in C, and calls plain callbacks; a
node with a hot path has its messages taken in C, and Python sees the others.
"""

from __future__ import annotations

import inspect
import time
from contextlib import ExitStack
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from arm_emulator.ros.c import MIDDLEWARE
from arm_emulator.ros.managed_node import ManagedNode
from arm_emulator.ros.middleware import FAILED, PYTHON, HotPath, middleware

# s, wall: interval at which new entities are looked for, and those served that are left to
# rclpy's own executor (QoS events, clients, guard conditions).
HOUSEKEEPING = 0.2
# s, wall: interval at which timers and services are checked while messages keep coming. Waiting
# for some twenty of them takes longer than the message of a tick.
REST = 2e-3


class LeanExecutor:
    """Serves the subscriptions, timers and services of one node in the calling thread.

    Callbacks are plain functions and run one after the other, as with SingleThreadedExecutor.

    Args:
        node: the node to serve. Its `housekeeping`, if it has one, is the interval of what is left
            to rclpy's executor, shorter for actions [s, wall].
        hot: messages in C of a node that is not a `ManagedNode`; None: nothing.
    """

    def __init__(self, node: Node, hot: HotPath | None = None) -> None:
        self._node, self._given = node, hot
        self._hot: HotPath | None = None
        self._run = middleware().ros_wait_run
        self._context = node.context
        self._rest = SingleThreadedExecutor(context=node.context)
        self._rest.add_node(node)

    def spin(self) -> None:
        """Serve until the context is shut down.

        Raises:
            ExternalShutdownException: it was shut down, as by a signal.
        """
        while True:
            with ExitStack() as held:
                housekeeping = getattr(self._node, "housekeeping", HOUSEKEEPING)
                self._serve(held, until=time.monotonic() + housekeeping)
            # A transition may have served the node by an executor of its own meanwhile.
            self._rest.add_node(self._node)
            self._rest.spin_once(timeout_sec=0.0)

    def _serve(self, held: ExitStack, until: float) -> None:
        """Wait for messages alone while they keep coming, and check the rest now and then."""
        node, generation = self._node, self._generation
        self._hot = node.in_c if isinstance(node, ManagedNode) else self._given
        # rclpy's executor serves callbacks that wait.
        at_once = [one for one in node.services if not inspect.iscoroutinefunction(one.callback)]
        subscriptions, timers, services = (
            [(one.handle.pointer, one) for one in many]
            for many in (node.subscriptions, node.timers, at_once)
        )
        for _, one in (*subscriptions, *timers, *services):
            held.enter_context(one.handle)
        context: Any = self._context.handle
        held.enter_context(context)
        wait_set = rclpy_implementation.WaitSet
        all_of_them: Any = wait_set(
            len(subscriptions), 0, len(timers), 0, len(services), 0, context
        )
        messages: Any = wait_set(len(subscriptions), 0, 0, 0, 0, 0, context)
        held.enter_context(messages)
        for message in () if self._hot is None else self._hot.outgoing:
            held.enter_context(message.bind())
        waiting = self._wait_for(messages, subscriptions)
        quiet = True
        look = time.monotonic()  # for the other entities
        while (now := time.monotonic()) < until and generation == self._generation:
            if quiet or now >= look:
                all_of_them.clear_entities()
                for _, subscription in subscriptions if quiet else ():
                    all_of_them.add_subscription(subscription.handle)
                for _, timer in timers:
                    all_of_them.add_timer(timer.handle)
                for _, service in services:
                    all_of_them.add_service(service.handle)
                all_of_them.wait(int((until - now if quiet else 0.0) * 1e9))
                if not self._context.ok():
                    raise ExternalShutdownException
                for _, timer in _ready(all_of_them, "timer", timers):
                    if timer.handle.is_timer_ready():
                        timer.handle.call_timer()
                        timer.callback()
                for _, service in _ready(all_of_them, "service", services):
                    self._take_request(service)
                look = time.monotonic() + REST
                quiet = quiet and not _ready(all_of_them, "subscription", subscriptions)
            else:
                quiet = not self._take_messages(waiting, subscriptions, look - now)

    @property
    def _generation(self) -> int:
        """Changes when other entities are to be served."""
        return self._node.generation if isinstance(self._node, ManagedNode) else 0

    def _wait_for(self, messages: Any, subscriptions: list[tuple[int, Any]]) -> Any:
        """Return a ``ros_wait *`` for these subscriptions."""
        ffi = MIDDLEWARE.ffi
        takes = () if self._hot is None else self._hot.takes
        topics = ffi.new("ros_topic[]", len(subscriptions))
        for k, (pointer, subscription) in enumerate(subscriptions):
            topics[k].subscription = ffi.cast("void *", pointer)
            for one, take, argument in takes:
                if one is subscription:
                    MIDDLEWARE.fill(topics + k, take=take, **{"with": argument})
        self._topics = topics
        pointer = ffi.cast("void *", messages.pointer)
        return MIDDLEWARE.new("ros_wait", set=pointer, topic=topics, topics=len(topics), left=-1)

    def _take_messages(
        self, waiting: Any, subscriptions: list[tuple[int, Any]], seconds: float
    ) -> bool:
        """Take messages for some time, or until one is for Python; return whether any came."""
        if self._hot is not None:
            self._hot.begin()
        end = self._run(waiting, seconds)
        if self._hot is not None:
            self._hot.end()
        if not self._context.ok():
            raise ExternalShutdownException
        if end == FAILED:
            raise RuntimeError("rcl does not wait for messages")
        if isinstance(self._node, ManagedNode):
            self._node.in_c_so_far += waiting.handled
            self._node.in_python_so_far += end == PYTHON
        for topic, (_, subscription) in zip(self._topics, subscriptions, strict=True):
            if topic.ready:
                self._take_message(subscription)
        if waiting.left >= 0:
            data = bytes(MIDDLEWARE.ffi.buffer(waiting.data, waiting.size))
            subscriptions[waiting.left][1].callback(data)
        return bool(end or waiting.handled)

    def _take_message(self, subscription: Any) -> None:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is None:
            return
        kind = subscription._callback_type  # noqa: SLF001  # as rclpy's executor looks at it
        if kind is subscription.CallbackType.MessageOnly:
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
