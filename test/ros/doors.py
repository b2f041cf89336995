"""The three nodes in this process, their callbacks called without a network.

Quick enough for many messages; `network` shows what the nodes do as processes.
"""

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from arm_emulator import Plant, load_scene
from arm_emulator.base.io.config_files import find_config
from arm_emulator.motion.executor.goal_status import GoalReports
from arm_emulator.ros.messages.fixed_layout import FixedLayout
from arm_emulator.ros.messages.message_reader import MessageReader
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_shell import Diagnostics
from arm_emulator.ros.process.ros_domain import own_domain
from emulator_node.node import EmulatorNode
from motion_controller_node.node import MotionControllerNode
from servo_node.node import ServoNode

OURS = ("arm_emulator", "emulator_node", "servo_node", "motion_controller_node")
KINDS = {
    "emulator": EmulatorNode,
    "servo": ServoNode,
    "motion_controller": MotionControllerNode,
}


class Doors:
    """Gives messages to the nodes of one arm, as if they had come over the network."""

    def __init__(self, nodes: dict[str, Any]) -> None:
        self.nodes = nodes
        bare = ManagedNode("bare")
        self._of_every_node = frozenset(vars(bare))
        bare.destroy_node()
        scene = load_scene("three_axis")
        self.joint_names = scene.joint_names
        self.give("motion_controller", "robot_description", String(data=scene.urdf))

    def give(self, node: str, topic: str, message: Any) -> None:
        """Call what listens to a topic."""
        listener = next(
            subscription
            for subscription in self.nodes[node].subscriptions
            if subscription.topic_name == f"/{topic}"
        )
        listener.callback(serialize_message(message) if listener.raw else message)

    def refused(self, node: str) -> int:
        """Return how many messages a node has refused so far."""
        return int(self.nodes[node]._diagnostics.refused)

    def state(self, node: str) -> Any:
        """Return all that a node knows, to be compared; but for its health, and wall times."""
        return {
            name: bits(value)
            for name, value in vars(self.nodes[node]).items()
            if name not in (*self._of_every_node, "_diagnostics", "_duplicates")
            and not name.endswith("_at")
        }


def bits(value: Any, depth: int = 0) -> Any:
    """Return the numbers and texts in an object, to the bit."""
    if isinstance(value, GoalReports | Diagnostics | FixedLayout | MessageReader):
        return None  # reports are no knowledge, and the newest message is a cache
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, float):
        return value.hex()
    if value is None or isinstance(value, int | str | bytes):
        return value
    if depth > 5:
        return type(value).__name__
    if isinstance(value, dict):
        return {str(key): bits(element, depth + 1) for key, element in value.items()}
    if isinstance(value, list | tuple):
        return [bits(element, depth + 1) for element in value]
    if dataclasses.is_dataclass(value):
        return {f.name: bits(getattr(value, f.name), depth + 1) for f in dataclasses.fields(value)}
    if isinstance(value, Plant):
        return bits(value.state)
    if type(value).__module__.split(".")[0] in OURS and hasattr(value, "__dict__"):
        return {name: bits(var, depth + 1) for name, var in vars(value).items()}
    return type(value).__name__


@contextmanager
def doors() -> Iterator[Doors]:
    """Make the three nodes, the emulator in lock-step and at tick 0."""
    files = [str(find_config("three_axis", ".yaml", kind)) for kind in ("servo", "motion")]
    arguments = ["--ros-args"]
    for file in files:
        arguments += ["--params-file", file]
    arguments += ["-p", "emulator:scene:=three_axis", "-p", "emulator:start:=first_answer"]
    with own_domain() as domain:
        rclpy.init(args=arguments, domain_id=domain)
        nodes: dict[str, Any] = {}
        try:
            for name, kind in KINDS.items():
                nodes[name] = kind()
            yield Doors(nodes)
        finally:
            for node in nodes.values():
                node.close()
                node.destroy_node()
            rclpy.try_shutdown()
