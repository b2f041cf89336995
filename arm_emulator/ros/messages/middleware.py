"""Hot paths in C: messages taken and published without Python (c/middleware.h)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.c import MIDDLEWARE, make_middleware_unit
from arm_emulator.ros.messages.fixed_layout import FixedLayout
from arm_emulator.toolchain.c_header import CData, Library
from arm_emulator.toolchain.compile_unit import load_library

LIBRARIES = ("librcutils.so", "librcl.so")  # rclpy has loaded them, but for itself

Numbers = NDArray[Any]


@cache
def get_middleware() -> Library:
    """Return the compiled middleware.h, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler, or no librcl.
    """
    for name in LIBRARIES:
        try:
            ctypes.CDLL(name, ctypes.RTLD_GLOBAL)
        except OSError as error:
            rule = "be that of the rclpy in use"
            raise Refusal("middleware", name, rule, error) from None
    return load_library(make_middleware_unit())


class HotPath(Protocol):
    """A node's messages that are taken and published in C.

    Attributes:
        beside: timers, if it has the attribute, during whose callbacks messages may be taken in C.
    """

    @property
    def takes(self) -> Sequence[tuple[Subscription, CData, CData]]:
        """Subscriptions, with function and argument that take their messages, see ros_topic."""

    @property
    def outgoing(self) -> Sequence[Outgoing]:
        """Messages that C publishes."""

    def begin_in_c(self) -> None:
        """Prepare: from here until `end_in_c` messages are taken in C."""

    def end_in_c(self) -> None:
        """Take over the results of C."""


class Outgoing:
    """A message of constant strings and lengths, published from Python and from C.

    Attributes:
        publisher: of it.
        layout: its numbers are set in ``layout.message``.
        struct: ``ros_message *``.

    Args:
        publisher: of it.
        message: with its strings and lengths.
        number: of its topic in a log.
        further: arrays whose numbers C copies into the message, by names of its fields; several of
            one field follow each other. They must stay where they are.
    """

    def __init__(
        self,
        publisher: Publisher,
        message: Any,
        number: int = -1,
        further: Sequence[tuple[str, Numbers]] = (),
    ) -> None:
        self.publisher, self.layout = publisher, FixedLayout(message)
        ffi, places = MIDDLEWARE.ffi, self.layout.places
        copies: list[dict[str, Any]] = []
        ends: dict[str, int] = {}
        for name, numbers in further:
            for row in numbers.reshape(-1, 1) if not numbers.ndim else np.atleast_2d(numbers):
                at = ends.get(name, places[name])
                if len(row):
                    copies.append(_make_copy(row, at, self.layout.message, name))
                ends[name] = at + 8 * len(row)
        self._copies = ffi.new("ros_copy[]", copies)
        self._arrays = [numbers for _, numbers in further]
        self._data = ffi.from_buffer("uint8_t[]", self.layout.bytes)
        self.struct = MIDDLEWARE.make_struct(
            "ros_message",
            data=self._data,
            size=self.layout.size,
            stamp_at=places.get("header.stamp.sec", places.get("clock.sec", -1)),
            tick_at=places.get("tick", -1),
            copy=self._copies,
            copies=len(copies),
            number=number,
        )

    def bind_to_c(self) -> Any:
        """Let C publish it; return the handle, which must be held meanwhile."""
        handle: Any = self.publisher.handle
        self.struct.publisher = MIDDLEWARE.ffi.cast("void *", handle.pointer)
        return handle

    def publish_message(self) -> None:
        """Publish the message with the numbers that are set."""
        self.publisher.publish(self.layout.write_message())


_KINDS = {
    ("f8", "f8"): "ROS_SAME",
    ("i8", "i8"): "ROS_SAME",
    ("u4", "i8"): "ROS_UINT32_TO_INT64",
    ("i8", "f8"): "ROS_INT64_TO_DOUBLE",
    ("u4", "f8"): "ROS_UINT32_TO_DOUBLE",
}


def _make_copy(row: Numbers, at: int, message: Any, name: str) -> dict[str, Any]:
    """Return a ``ros_copy`` of a row of numbers to a byte of a message."""
    kind = _KINDS[row.dtype.str[1:], getattr(message, name).dtype.str[1:]]
    return {
        "from": MIDDLEWARE.ffi.cast("void *", row.ctypes.data),
        "stride": row.strides[0],
        "count": len(row),
        "kind": MIDDLEWARE.get_constant(kind),
        "at": at,
    }
