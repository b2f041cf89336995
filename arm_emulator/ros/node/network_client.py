"""A node of a command or a test that joins a running network for a moment."""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.process.ctrl_c import CtrlC

ASK_AGAIN = 2.0  # s, after which a service that has not answered is called once more


class NetworkClient(Node):
    """Keeps the newest message of each subscribed topic.

    Args:
        name: of the node.
        namespace: of the network.
        context: of rclpy; None: that of the process.
    """

    def __init__(self, name: str, namespace: str, context: Context | None = None) -> None:
        super().__init__(
            name,
            context=context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)
        self.newest: dict[str, Any] = {}

    def listen_to(self, topic: str, kind: Any, qos: QoSProfile) -> None:
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
            with CtrlC.delay_interrupt():
                self._executor.spin_once(timeout_sec=0.05)
        return True

    def call_service(self, client: Any, request: Any, patience: float) -> Any:
        """Call a service and return its answer; None: it gave none within this time [s].

        A server that has not discovered this client yet loses its answer. So the request is sent
        again every few seconds, and must be one that may be done twice.
        """
        deadline = time.monotonic() + patience
        if not self.spin_until(client.service_is_ready, patience):
            return None
        futures: list[Any] = []

        def is_answered() -> bool:
            return any(future.done() for future in futures)

        while not is_answered() and (left := deadline - time.monotonic()) > 0.0:
            futures.append(client.call_async(request))
            self.spin_until(is_answered, min(left, ASK_AGAIN))
        return next((future.result() for future in futures if future.done()), None)

    def is_heard(self, publisher: Publisher, by: str) -> bool:
        """Return whether a message now published gets to all subscribers, and to a certain node.

        One subscriber is not enough: others than the node that acts on a topic read it, too.

        Args:
            publisher: of the message.
            by: topic on which that node, and no other, publishes.
        """
        kinds = self.get_publishers_info_by_topic(self.resolve_topic_name(by))
        acting = {(endpoint.node_namespace, endpoint.node_name) for endpoint in kinds}
        readers = self.get_subscriptions_info_by_topic(publisher.topic_name)
        there = {(endpoint.node_namespace, endpoint.node_name) for endpoint in readers}
        matched = publisher.get_subscription_count()
        return bool(acting) and acting <= there and matched >= len(readers)


def check_timeout(where: str, timeout: float) -> None:
    """Refuse a time to wait that has no end, since it is no number, or none before now."""
    if not timeout >= 0.0:
        raise Refusal(where, "--timeout", "be >= 0 s", timeout)


@contextlib.contextmanager
def join_network(name: str, namespace: str) -> Iterator[NetworkClient]:
    """Join the network for a block; Ctrl-C breaks it off.

    Raises:
        Refusal: the namespace is invalid.
    """
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        node = NetworkClient(name, namespace)
    except Exception as error:  # rclpy has an exception for each rule of names
        rclpy.try_shutdown()
        reason = str(error).splitlines()[0]
        raise Refusal(name, "--namespace", "be a name of ROS", reason) from None
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
