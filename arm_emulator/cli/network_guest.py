"""A node of a command that joins a running network for a moment."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.ctrl_c import CtrlC


class NetworkGuest(Node):
    """Keeps the newest message of each subscribed topic."""

    def __init__(self, name: str, namespace: str) -> None:
        super().__init__(
            name, namespace=namespace, enable_rosout=False, start_parameter_services=False
        )
        self.newest: dict[str, Any] = {}

    def listen(self, topic: str, kind: Any, qos: QoSProfile) -> None:
        """Keep the newest message of a topic from now on."""
        self.create_subscription(
            kind, topic, lambda message: self.newest.__setitem__(topic, message), qos
        )

    def spin_until(self, condition: Callable[[], bool], patience: float) -> bool:
        """Take messages until a condition holds; False: it did not within this time [s]."""
        deadline = time.monotonic() + patience
        while not condition():
            if time.monotonic() > deadline:
                return False
            rclpy.spin_once(self, timeout_sec=0.05)
        return True


@contextlib.contextmanager
def guest(name: str, namespace: str) -> Iterator[NetworkGuest]:
    """Join the network for a block; Ctrl-C breaks it off.

    Raises:
        Refusal: the namespace is invalid.
    """
    ctrl_c = CtrlC(None)
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        node = NetworkGuest(name, namespace)
    except Exception as error:  # rclpy has an exception for each rule of names
        rclpy.try_shutdown()
        reason = str(error).splitlines()[0]
        raise Refusal(name, "--namespace", "be a name of ROS", reason) from None
    del ctrl_c
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
