"""The three nodes as processes under test, and a user of their topics beside them."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from arm_emulator.bringup import Bringup
from arm_emulator.node_shell import NANOSECONDS, nanoseconds_of, stamp
from arm_emulator.offline import OfflineRun
from arm_emulator_msgs.msg import EmulatorStatus, MotorCommand, MotorState

JOINTS = ["waist", "shoulder", "elbow"]  # of three_axis
PATIENCE = 30.0  # s, for what takes well below a second on an idle machine
ALL_THREE = ("emulator", "servo", "motion_controller")

# Deep enough for every state of a test: what is recorded must not get lost.
RECORD_QOS = QoSProfile(depth=20_000)
# A depth of 1 would keep only the newest for a node that is just being discovered.
SEND_QOS = QoSProfile(depth=100)


def free_domain() -> int:
    """Return a ROS domain in which nobody is on this machine."""
    domains = list(range(1, 101))
    random.SystemRandom().shuffle(domains)
    for domain in domains:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                # The port of a domain's first participant (DDSI-RTPS 9.6.2.4).
                probe.bind(("0.0.0.0", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise RuntimeError("every ROS domain is taken")


class User:
    """Listens to everything that the nodes say, sends what a test asks for, calls services."""

    def __init__(self, domain: int) -> None:
        self.joint_names = JOINTS
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("user", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._raw_states: list[bytes] = []
        self.recording = True
        self.status: EmulatorStatus | None = None
        self.truth: JointState | None = None
        self.joint_states: JointState | None = None
        self.joint_targets: JointState | None = None
        self.description = ""
        self.diagnostics: dict[str, Any] = {}  # newest of each node
        self.words: dict[str, list[str]] = {name: [] for name in ALL_THREE}  # all that was said
        listen = self.node.create_subscription
        listen(MotorState, "motor_states", self._on_state, RECORD_QOS, raw=True)
        listen(EmulatorStatus, "emulator/status", self._on_status, 10)
        listen(DiagnosticArray, "diagnostics", self._on_diagnostics, 100)
        late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listen(String, "robot_description", self._on_description, late)
        for topic in ("emulator/joint_states", "joint_states", "joint_targets"):
            listen(JointState, topic, self._keeper(topic.split("/")[-1], topic), 10)
        publish = self.node.create_publisher
        self.commands = publish(MotorCommand, "motor_commands", SEND_QOS)
        self.states = publish(MotorState, "motor_states", SEND_QOS)
        self.targets = publish(JointState, "joint_targets", SEND_QOS)
        self.measured = publish(JointState, "joint_states", SEND_QOS)
        self.tool_targets = publish(PoseStamped, "tool_target", SEND_QOS)
        self.stamps: dict[str, int] = {}  # of the newest diagnostics of each node [ns]
        self._own_topics = {one.topic_name for one in self.node.subscriptions}
        self._clients: dict[str, Any] = {}

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def add(self, node: Node) -> None:
        """Spin a node of the test's, too."""
        self._executor.add_node(node)

    def spin(self, seconds: float = 0.02) -> None:
        self._executor.spin_once(timeout_sec=seconds)

    def wait(self, what: str, condition: Callable[[], Any], patience: float = PATIENCE) -> Any:
        """Spin until the condition holds and return its value."""
        deadline = time.monotonic() + patience
        while True:
            value = condition()
            if value:
                return value
            assert time.monotonic() < deadline, (
                f"waited {patience:g} s for {what}; status {self.status}; said {self.words}"
            )
            self.spin()

    def call(self, name: str, request: bool | None = None) -> Any:
        """Call a service of the nodes and return its answer, see `calls`."""
        return self.calls((name, request))[0]

    def calls(self, *calls: tuple[str, bool | None]) -> list[Any]:
        """Call services one right after the other: True or False for SetBool, None for Trigger."""
        futures = []
        for name, request in calls:
            kind = Trigger if request is None else SetBool
            client = self._clients.get(name)
            if client is None:
                client = self._clients[name] = self.node.create_client(kind, name)
            self.wait(f"service {name}", client.service_is_ready)
            message = kind.Request() if request is None else kind.Request(data=request)
            futures.append(client.call_async(message))
        self.wait(f"the answers of {calls}", lambda: all(future.done() for future in futures))
        return [future.result() for future in futures]

    def send_tool_target(
        self,
        position: tuple[float, float, float],
        at: float = 0.0,
        orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
        frame: str = "",
    ) -> None:
        """Publish a tool target [m] that holds from logical time `at` [s]."""
        message = PoseStamped()
        message.header.stamp = stamp(round(at * NANOSECONDS))
        message.header.frame_id = frame
        p, o = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = position
        o.x, o.y, o.z, o.w = orientation
        self.publish(self.tool_targets, message)

    def publish(self, publisher: Any, message: Any) -> None:
        """Publish when the nodes listen: one, and to tool targets two."""
        others = 2 if publisher is self.tool_targets else 1
        others += publisher.topic_name in self._own_topics
        self.wait(
            f"a listener on {publisher.topic_name}",
            lambda: publisher.get_subscription_count() >= others,
        )
        publisher.publish(message)

    def motor_states(self) -> dict[int, bytes]:
        """Return all that was recorded: tick -> the bits of counts and currents.

        A state that was said again must say the same.
        """
        recorded: dict[int, bytes] = {}
        for raw in self._raw_states:
            message = deserialize_message(raw, MotorState)
            assert list(message.joint_names) == self.joint_names
            bits = bits_of(message.encoder_counts, message.current)
            if recorded.setdefault(int(message.tick), bits) != bits:
                raise AssertionError(f"tick {message.tick} was told twice, and differently")
        return recorded

    @property
    def tick(self) -> int:
        """Newest tick recorded, -1 for none."""
        if not self._raw_states:
            return -1
        return int(deserialize_message(self._raw_states[-1], MotorState).tick)

    def forget(self) -> None:
        """Begin a new recording."""
        self._raw_states.clear()
        self.status = self.truth = self.joint_states = self.joint_targets = None

    def value(self, node: str, key: str) -> str:
        """Return a value of a node's newest diagnostics, empty if it has none of that name."""
        status = self.diagnostics.get(node)
        return next((pair.value for pair in status.values if pair.key == key), "") if status else ""

    def refused(self, node: str, topic: str) -> int:
        """Return how many messages of a topic a node says it refused."""
        return int(self.value(node, f"refused {topic}") or 0)

    def said(self, node: str, words: str) -> list[str]:
        """Return what a node said in its diagnostics that begins with these words."""
        return [message for message in self.words[node] if message.startswith(words)]

    def _on_state(self, raw: bytes) -> None:
        if self.recording:
            self._raw_states.append(raw)

    def _on_status(self, status: EmulatorStatus) -> None:
        self.status = status

    def _on_description(self, message: String) -> None:
        self.description = message.data

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.stamps[status.name] = nanoseconds_of(array.header.stamp)
            self.diagnostics[status.name] = status
            said = self.words.setdefault(status.name, [])
            if not said or said[-1] != status.message:
                said.append(status.message)

    def _keeper(self, attribute: str, topic: str) -> Callable[[JointState], None]:
        name = "truth" if topic.startswith("emulator") else attribute

        def keep(message: JointState) -> None:
            setattr(self, name, message)

        return keep


def bits_of(encoder_counts: Any, current: Any) -> bytes:
    """Return the bits of a motor state's numbers."""
    return bytes(encoder_counts.tobytes()) + bytes(current.tobytes())


def offline_states(run: OfflineRun, ticks: int) -> dict[int, bytes]:
    """Return what `User.motor_states` records, of a run without a network, up to a tick."""
    session = run.session
    states = {session.tick: bits_of(session.state.encoder_counts, session.state.current)}
    while session.tick < ticks:
        run.advance(1)
        states[session.tick] = bits_of(session.state.encoder_counts, session.state.current)
    return states


def assert_same_bits(one: dict[int, bytes], other: dict[int, bytes], ticks: int) -> None:
    """Compare two recordings from tick 1 to `ticks`.

    Tick 0 may have been told, and answered, before somebody listened.
    """
    for tick in range(1, ticks + 1):
        assert tick in one and tick in other, f"tick {tick} is missing"
        assert one[tick] == other[tick], f"the first difference is at tick {tick}"


@contextmanager
def ros_domain() -> Iterator[int]:
    """Put this process, and those that it starts, into a ROS domain of their own."""
    mine = {"ROS_DOMAIN_ID": str(free_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    before = {name: os.environ.get(name) for name in mine}
    os.environ.update(mine)
    try:
        yield int(mine["ROS_DOMAIN_ID"])
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


@contextmanager
def user() -> Iterator[User]:
    """Be a user in a ROS domain of its own."""
    with ros_domain() as domain:
        one = User(domain)
        try:
            yield one
        finally:
            one.close()


@contextmanager
def network(
    log: Path,
    *,
    scene: str = "three_axis",
    clock: str = "lockstep",
    start: str = "paused",
    only: tuple[str, ...] = ALL_THREE,
    **emulator: object,
) -> Iterator[tuple[User, Bringup]]:
    """Run nodes and a user in a ROS domain of their own; at the end all must end cleanly."""
    nodes = Bringup(scene, clock=clock, start=start, emulator=emulator, log=log, only=only)
    with user() as one, nodes:
        yield one, nodes
        for name in only:
            code = nodes.process(name).poll()
            assert code is None, f"{name} ended by itself with {code}: {logs(log)}"
        codes = nodes.stop()
        assert set(codes.values()) == {0}, f"exit codes {codes}: {logs(log)}"


@contextmanager
def node(module: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run one node with arguments of one's own; it must end cleanly."""
    process = subprocess.Popen([sys.executable, "-m", module, "--ros-args", *arguments])
    try:
        yield process
        assert process.poll() is None, f"{module} ended by itself"
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(PATIENCE)
    assert code == 0


def kill(nodes: Bringup, name: str) -> None:
    """Kill a node; what it left unsaid stays unsaid."""
    process = nodes.process(name)
    process.kill()
    process.wait()


def logs(folder: Path) -> str:
    """Return what the nodes wrote."""
    return "\n".join(f"--- {f.name}\n{f.read_text()[-3000:]}" for f in sorted(folder.glob("*.log")))


@contextmanager
def busy_processor(count: int) -> Iterator[None]:
    """Keep processors busy beside a test."""
    spin = [sys.executable, "-IS", "-c", "while True: pass"]
    loads = [subprocess.Popen(spin) for _ in range(count)]
    try:
        yield
    finally:
        for load in loads:
            load.kill()
        for load in loads:
            load.wait()
