"""An executor for one node with little to do per message.

For every message, rclpy's SingleThreadedExecutor collects all entities of a node again, and makes a
coroutine and a task: on the order of 0.3 ms of Python each time, more than a servo period can
spare in lock-step. This one collects them now and then, and calls plain callbacks; a node with a
hot path has its messages taken in C, and Python sees the others.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.subscription import Subscription

from arm_emulator.ros.c import ARRIVALS, MIDDLEWARE
from arm_emulator.ros.messages.middleware import HotPath, get_middleware
from arm_emulator.ros.node.entities import Entities, take_message
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.sole_publisher import (
    SolePublisher,
    call_back,
    deliver_message,
    split_received,
)
from arm_emulator.workarounds.rclpy_internals import make_guard_condition

# s, wall: interval at which new entities are looked for, and those served that are left to
# rclpy's own executor (QoS events, clients, guard conditions).
HOUSEKEEPING = 0.2
# s, wall: interval at which timers and services are checked while messages keep coming. Waiting
# for some twenty of them takes longer than the message of a tick.
REST = 2e-3


class LeanExecutor:
    """Serves the subscriptions, timers and services of one node in the calling thread.

    Callbacks are plain functions and run one after the other, as with SingleThreadedExecutor; no
    message is taken in C meanwhile. Where the middleware permits, messages of a hot path are taken
    in C where they arrive (`Arrivals`), elsewhere by Python.

    Args:
        node: the node to serve. Its `housekeeping`, if it has one, is the interval of what is left
            to rclpy's executor, shorter for actions [s, wall].
        take: calls back with a message of a subscription, as `take_message`.
    """

    def __init__(
        self,
        node: Node,
        take: Callable[[Any, SolePublisher | None], bool] = take_message,
    ) -> None:
        self._node, self._take_message = node, take
        self._hot: HotPath | None = None
        self._arrivals: Arrivals | None = None
        self._served = -1  # generation of these
        self._context = node.context
        self._rclpy_executor = SingleThreadedExecutor(context=node.context)
        self._rclpy_executor.add_node(node)

    def spin(self) -> None:
        """Serve until the context is shut down.

        Raises:
            ExternalShutdownException: it was shut down, as by a signal.
        """
        try:
            while True:
                housekeeping = getattr(self._node, "housekeeping", HOUSEKEEPING)
                until = time.monotonic() + housekeeping
                with Entities(self._node) as entities:
                    self._update_hot_path()
                    if self._arrivals is not None:
                        self._serve_with_arrivals(self._arrivals, entities, until)
                    else:
                        self._serve_in_python(entities, until)
                # A transition may have served the node by an executor of its own meanwhile.
                self._rclpy_executor.add_node(self._node)
                self._rclpy_executor.spin_once(timeout_sec=0.0)
                self._deliver_withheld()
        finally:
            self._end_arrivals()

    def _update_hot_path(self) -> None:
        node = self._node
        hot = node.in_c if isinstance(node, ManagedNode) else None
        if hot is self._hot and self._served == self._generation:
            return
        self._end_arrivals()
        self._hot, self._served = hot, self._generation
        if hot is not None:
            with contextlib.suppress(LookupError):
                self._arrivals = Arrivals(hot, self._context.handle, self._soles)

    def _end_arrivals(self) -> None:
        arrivals, self._arrivals = self._arrivals, None
        if arrivals is not None:
            arrivals.end_path()

    @property
    def _generation(self) -> int:
        """Changes when other entities are to be served."""
        return self._node.generation if isinstance(self._node, ManagedNode) else 0

    @property
    def _soles(self) -> dict[Any, SolePublisher]:
        """Publishers whose messages are taken, by subscription."""
        return self._node.sole_publishers if isinstance(self._node, ManagedNode) else {}

    def _take_oldest(self, subscription: Any) -> None:
        self._take_message(subscription, self._soles.get(subscription))

    def _deliver_withheld(self) -> None:
        """Report what was dropped; call back where the publisher has become the one meanwhile."""
        for subscription, sole in [*self._soles.items()]:
            sole.report_dropped()
            for data in sole.release_withheld():
                deliver_message(subscription, data)

    def _count_messages(self, in_c: int, in_python: bool) -> None:
        if isinstance(self._node, ManagedNode):
            self._node.in_c_so_far += in_c
            self._node.in_python_so_far += in_python

    def _serve_with_arrivals(self, arrivals: Arrivals, entities: Entities, until: float) -> None:
        """Wait for everything else while messages are taken in C."""
        generation = self._generation
        others = [
            subscription for subscription in entities.subscriptions if subscription not in arrivals
        ]
        beside = getattr(self._hot, "beside", ())
        while time.monotonic() < until and generation == self._generation:
            open_ = arrivals.open_path()
            try:
                while True:
                    left = until - time.monotonic() if open_ else 0.0
                    entities.wait_for_events(left, others, arrivals.guard)
                    if left <= 0.0 or not entities.has_only_timers(beside):
                        break
                    entities.serve_timers()
            finally:  # a signal ends the wait: what C has done so far is recorded, too
                in_c = arrivals.close_path()
            message = arrivals.list_left()
            self._count_messages(in_c, message is not None)
            if message is not None:
                subscription, data, publisher = message
                call_back(subscription, self._soles.get(subscription), data, publisher)
            entities.serve_timers()
            entities.serve_services()
            for subscription in entities.list_ready_subscriptions():
                self._take_oldest(subscription)

    def _serve_in_python(self, entities: Entities, until: float) -> None:
        """Wait for messages alone while they keep coming, and check the rest now and then."""
        generation, look, busy = self._generation, 0.0, False
        while (now := time.monotonic()) < until and generation == self._generation:
            messages_alone = busy and now < look
            if messages_alone:
                entities.wait_for_events(look - now, entities.subscriptions, alone=True)
            else:
                entities.wait_for_events(0.0 if busy else until - now, entities.subscriptions)
                entities.serve_timers()
                entities.serve_services()
                look = time.monotonic() + REST
            ready = entities.list_ready_subscriptions()
            for subscription in ready:
                self._take_oldest(subscription)
            self._count_messages(0, bool(ready))
            busy = bool(ready) or messages_alone


# Middlewares that call back without a lock that taking a message needs.
CALL_BACK_UNLOCKED = ("rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")


class Arrivals:
    """Takes messages in C while it is open, without Python.

    Attributes:
        guard: a guard condition, triggered when a message was left to Python.

    Args:
        hot: the messages.
        context: handle of rclpy's context.
        soles: publishers whose messages are taken, by subscription.

    Raises:
        LookupError: the middleware does not report arrivals in the way that is needed.
    """

    def __init__(self, hot: HotPath, context: Any, soles: Mapping[Any, SolePublisher]) -> None:
        if rclpy.get_rmw_implementation_identifier() not in CALL_BACK_UNLOCKED:
            raise LookupError
        self._hot = hot
        self._subscriptions = [subscription for subscription, _, _ in hot.takes]
        self._stack = ExitStack()
        for subscription in self._subscriptions:
            self._stack.enter_context(subscription.handle)
        for message in hot.outgoing:
            self._stack.enter_context(message.bind_to_c())
        self.guard: Any = make_guard_condition(context)
        self._stack.enter_context(self.guard)
        ffi, self._calls = ARRIVALS.ffi, get_middleware()
        guard = ffi.cast("void *", self.guard.pointer)
        self._topics = ffi.new("ros_topic[]", len(hot.takes))
        for k, (subscription, take, argument) in enumerate(hot.takes):
            handle: Any = subscription.handle
            self._topics[k].subscription = ffi.cast("void *", handle.pointer)
            if subscription in soles:
                self._topics[k].owner = soles[subscription].owner
            MIDDLEWARE.fill_struct(self._topics + k, take=take, **{"with": argument})
        self._all = self._calls.ros_arrivals_new(self._topics, len(self._subscriptions), guard)
        self._arrived = ARRIVALS.make_struct("ros_arrived", left=-1)
        self._handled = 0
        if not self._all:
            self._stack.close()
            raise LookupError

    def __contains__(self, subscription: Subscription) -> bool:
        return subscription in self._subscriptions

    def open_path(self) -> bool:
        """Let messages be taken; False if one was left to Python."""
        self._hot.begin_in_c()
        return bool(self._calls.ros_arrivals_open(self._all))

    def close_path(self) -> int:
        """Let no more be taken; return how many were since the last time."""
        self._calls.ros_arrivals_close(self._all, self._arrived)
        self._hot.end_in_c()
        before, self._handled = self._handled, self._arrived.handled
        return int(self._handled - before)

    def list_left(self) -> tuple[Subscription, bytes, bytes] | None:
        """Return what was left to Python when this was closed: subscription, bytes, publisher."""
        arrived = self._arrived
        if arrived.left < 0:
            return None
        return self._subscriptions[arrived.left], *split_received(arrived.message)

    def end_path(self) -> None:
        """Stop for good; nothing may be taken in C afterwards."""
        self._calls.ros_arrivals_delete(self._all)
        self._stack.close()
