"""Messages of a hot path, taken in C where they arrive (c/arrivals.h)."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription

from arm_emulator.ros.c import ARRIVALS
from arm_emulator.ros.middleware import HotPath, middleware, topics_of
from arm_emulator.ros.sole_publisher import SolePublisher, parts_of

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
        self._subscriptions = [one for one, _, _ in hot.takes]
        self._held = ExitStack()
        for one in self._subscriptions:
            self._held.enter_context(one.handle)
        for message in hot.outgoing:
            self._held.enter_context(message.bind())
        self.guard: Any = rclpy_implementation.GuardCondition(context)
        self._held.enter_context(self.guard)
        ffi, self._calls = ARRIVALS.ffi, middleware()
        guard = ffi.cast("void *", self.guard.pointer)
        self._topics = topics_of(self._subscriptions, hot, soles)
        self._all = self._calls.ros_arrivals_new(self._topics, len(self._subscriptions), guard)
        self._arrived = ARRIVALS.new("ros_arrived", left=-1)
        self._handled = 0
        if not self._all:
            self._held.close()
            raise LookupError

    def __contains__(self, subscription: Subscription) -> bool:
        return subscription in self._subscriptions

    def open(self) -> bool:
        """Let messages be taken; False if one was left to Python."""
        self._hot.begin()
        return bool(self._calls.ros_arrivals_open(self._all))

    def close(self) -> int:
        """Let no more be taken; return how many were since the last time."""
        self._calls.ros_arrivals_close(self._all, self._arrived)
        self._hot.end()
        before, self._handled = self._handled, self._arrived.handled
        return int(self._handled - before)

    def left(self) -> tuple[Subscription, bytes, bytes] | None:
        """Return what was left to Python when this was closed: subscription, bytes, publisher."""
        arrived = self._arrived
        if arrived.left < 0:
            return None
        return self._subscriptions[arrived.left], *parts_of(arrived.message)

    def end(self) -> None:
        """Stop for good; nothing may be taken in C afterwards."""
        self._calls.ros_arrivals_delete(self._all)
        self._held.close()
