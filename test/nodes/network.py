"""The three nodes as processes under test, and a user of their topics beside them."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from arm_emulator.ros.messages.time_stamp import (
    NANOSECONDS,
    convert_to_nanoseconds,
    convert_to_stamp,
)
from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.runs.offline import OfflineRun
from arm_emulator_msgs.msg import EmulatorStatus, MotorCommand, MotorState
from arm_emulator_msgs.srv import BreakWhen, RestoreState, SaveState, SetState, SetVaried

JOINTS = ["waist", "shoulder", "elbow"]  # of three_axis
PATIENCE = 120.0  # s, for what takes well below a second on an idle machine
ASK_AGAIN = 5.0  # s, after which a service that has not answered is called once more
ALL_THREE = ("emulator", "servo", "motion_controller")
# Node that acts on each topic of a user.
RECEIVER = {
    "motor_commands": "emulator",
    "joint_targets": "servo",
    "motor_states": "servo",
    "tool_target": "motion_controller",
    "tool_path": "motion_controller",
    "motion_controller/delta_joint_cmds": "motion_controller",
    "joint_states": "motion_controller",
}

# Node whose messages on a topic are taken, in a network of all three.
SOLE_PUBLISHER = {
    "motor_commands": "servo",
    "joint_targets": "motion_controller",
    "motor_states": "emulator",
    "joint_states": "servo",
}

SERVICES = {
    service.Request: service
    for service in (SetBool, Trigger, SaveState, RestoreState, SetState, SetVaried, BreakWhen)
}

# Deep enough for every state in lock-step: what is recorded must not get lost. In real time
# a Python listener is slower than the machine: it would fall behind by all that is kept for it.
RECORD_QOS = QoSProfile(depth=20_000)
NEWEST_QOS = QoSProfile(depth=5)
# Without default event callbacks, whose checks take half of this user's processor time.
HEAR_ALONE = SubscriptionEventCallbacks(use_default_callbacks=False)
SEND_ALONE = PublisherEventCallbacks(use_default_callbacks=False)
# A depth of 1 would keep only the newest for a node that is just being discovered.
SEND_QOS = QoSProfile(depth=100)


def question(request: Any) -> tuple[Any, Any]:
    """Return type and request of a service: True or False for SetBool, None for Trigger."""
    if request is None:
        request = Trigger.Request()
    elif isinstance(request, bool):
        request = SetBool.Request(data=request)
    return SERVICES[type(request)], request


class User:
    """Listens to everything that the nodes state, sends what a test asks for, calls services."""

    def __init__(self, domain: int, namespace: str = "/", clock: str = "lockstep") -> None:
        self.joint_names = JOINTS
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = NetworkClient("user", namespace, self._context)
        self._raw_states: list[bytes] = []
        self.tick = -1  # newest tick recorded, -1 for none
        self.machine = 0  # the emulator whose states are recorded, 0 for any
        self.own_states: set[bytes] = set()  # what was sent as a motor state, by this user
        self._removed: set[bytes] = set()  # listeners whose process was killed
        self._met: set[tuple[str, bytes]] = set()  # topics, and listeners that know this publisher
        self.status: EmulatorStatus | None = None
        self.truth: JointState | None = None
        self.joint_states: JointState | None = None
        self.joint_targets: JointState | None = None
        self.description = ""
        self.diagnostics: dict[str, Any] = {}  # newest of each node
        self.words: dict[str, list[str]] = {name: [] for name in ALL_THREE}  # all that was reported
        listen = partial(self.node.create_subscription, event_callbacks=HEAR_ALONE)
        qos = RECORD_QOS if clock == "lockstep" else NEWEST_QOS
        listen(MotorState, "motor_states", self._on_state, qos, raw=True)
        listen(EmulatorStatus, "emulator/status", self._on_status, 10)
        listen(DiagnosticArray, "diagnostics", self._on_diagnostics, 100)
        late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        listen(String, "robot_description", self._on_description, late)
        for topic in ("emulator/joint_states", "joint_states", "joint_targets"):
            listen(JointState, topic, self._keeper(topic.split("/")[-1], topic), 1)
        publish = partial(self.node.create_publisher, event_callbacks=SEND_ALONE)
        self.commands = publish(MotorCommand, "motor_commands", SEND_QOS)
        self.states = publish(MotorState, "motor_states", SEND_QOS)
        self.targets = publish(JointState, "joint_targets", SEND_QOS)
        self.measured = publish(JointState, "joint_states", SEND_QOS)
        self.tool_targets = publish(PoseStamped, "tool_target", SEND_QOS)
        self.stamps: dict[str, int] = {}  # of the newest diagnostics of each node [ns]
        self._clients: dict[str, Any] = {}
        self._answered: set[str] = set()  # services that have answered once

    def close(self) -> None:
        self.node.executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def add(self, node: Node) -> None:
        """Spin a node of the test's, too."""
        self.node.executor.add_node(node)

    def spin(self, seconds: float = 0.02) -> None:
        self.node.executor.spin_once(timeout_sec=seconds)

    def wait(
        self, condition_text: str, condition: Callable[[], Any], patience: float = PATIENCE
    ) -> Any:
        """Spin until the condition holds and return its value."""
        value = None

        def holds() -> bool:
            nonlocal value
            value = condition()
            return bool(value)

        assert self.node.spin_until(holds, patience), (
            f"waited {patience:g} s for {condition_text}; status {self.status}; stated {self.words}"
        )
        return value

    def call(self, name: str, request: Any = None) -> Any:
        """Call a service of the nodes and return its answer, see `calls`."""
        return self.calls((name, request))[0]

    def calls(self, *calls: tuple[str, Any]) -> list[Any]:
        """Call services one right after the other, with requests as `question` takes them.

        A server that has not found this client yet loses its answer, and a client does not notice
        that its server was killed: what no server has ever answered is asked again. So the first
        step that a test asks for must be one that may be done twice.
        """
        requests = []
        for name, request in calls:
            kind, message = question(request)
            client = self._clients.get(name)
            if client is None:
                client = self._clients[name] = self.node.create_client(kind, name)
            self.wait(f"service {name}", client.service_is_ready)
            requests.append((name, client, message, [client.call_async(message)]))
        ask_at = time.monotonic() + ASK_AGAIN

        def answered() -> bool:
            nonlocal ask_at
            waiting = [
                request for request in requests if not any(future.done() for future in request[3])
            ]
            if time.monotonic() > ask_at:
                ask_at = time.monotonic() + ASK_AGAIN
                for name, client, message, futures in waiting:
                    if name not in self._answered:
                        futures.append(client.call_async(message))
            return not waiting

        self.wait(f"the answers of {calls}", answered)
        self._answered.update(name for name, _ in calls)
        return [next(f.result() for f in futures if f.done()) for *_, futures in requests]

    def send_tool_target(
        self,
        position: tuple[float, float, float],
        at: float = 0.0,
        orientation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
        frame: str = "",
    ) -> None:
        """Publish a tool target [m] that holds from logical time `at` [s]."""
        message = PoseStamped()
        message.header.stamp = convert_to_stamp(round(at * NANOSECONDS))
        message.header.frame_id = frame
        p, o = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = position
        o.x, o.y, o.z, o.w = orientation
        self.publish(self.tool_targets, message)

    def publish(self, publisher: Any, message: Any) -> None:
        """Publish a message, or bytes, when the node that acts on them listens."""
        self.await_listener(publisher)
        data = message if isinstance(message, bytes) else serialize_message(message)
        if publisher is self.states:
            self.own_states.add(data)
        publisher.publish(data)

    def await_listener(self, publisher: Any) -> None:
        """Wait until the node that acts on a topic listens to this user.

        To count listeners is not enough: recorders and other nodes listen, too. And a node that
        reads with best effort loses what comes before it knows this publisher.
        """
        topic = publisher.topic_name
        receiver = RECEIVER[topic.removeprefix(self.node.get_namespace()).strip("/")]

        def listeners() -> set[tuple[str, bytes]]:
            listeners_now = self._listeners(topic)
            there = {(topic, who) for who, node in listeners_now if node == receiver}
            # A discovered node is matched a moment later; the number confirms that all of them are.
            matched = len(listeners_now) <= publisher.get_subscription_count()
            return (
                {listener for listener in there if listener[1] not in self._removed}
                if matched
                else set()
            )

        there = self.wait(f"{receiver} to listen on {topic}", listeners)
        if not there <= self._met:
            self.meet(receiver)
            self._met |= there

    def meet(self, node: str) -> None:
        """Wait until a node knows all publishers and clients that this user has made so far."""
        assert wait_until_met(self.node, node, PATIENCE), f"{node} does not answer"

    def await_start(self) -> None:
        """Wait until a paused network has connected, and this user receives the machine's states.

        A client that the emulator has not found when it publishes tick 0 misses this tick and those
        after it.
        """
        self.wait(
            "the nodes to meet",
            # Tick 0 by its number: of an emulator that was killed some words may still come.
            lambda: self.status and self.status.answered and self.status.tick == 0,
        )
        again_at = time.monotonic() + 1.0

        def heard() -> bool:
            nonlocal again_at
            if self.tick != 0 and time.monotonic() > again_at:
                again_at = time.monotonic() + 1.0
                assert self.call("emulator/reset").success, "the emulator was not reset"
            return self.tick == 0

        self.wait("tick 0", heard)

    def forget_listeners(self, node: str) -> None:
        """Count no longer on the listeners of a node that was killed: they fade away slowly."""
        for publisher in self.node.publishers:
            listeners_now = self._listeners(publisher.topic_name)
            self._removed.update(who for who, name in listeners_now if name == node)
        self._answered = {name for name in self._answered if not name.startswith(f"{node}/")}

    def _listeners(self, topic: str) -> list[tuple[bytes, str]]:
        """Return identity and node of every known listener on a topic."""
        endpoints = self.node.get_subscriptions_info_by_topic(topic)
        return [(bytes(endpoint.endpoint_gid), endpoint.node_name) for endpoint in endpoints]

    def motor_states(self) -> dict[int, bytes]:
        """Return what was recorded of the newest run: tick -> the bits of counts and currents.

        A state that was reported again must state the same.
        """
        recorded: dict[int, bytes] = {}
        for raw in self._raw_states:
            message = deserialize_message(raw, MotorState)
            names = list(message.joint_names)
            assert names == self.joint_names, (
                f"a motor state of another machine: joints {names}, tick {message.tick}, "
                f"expected {self.joint_names}"
            )
            bits = bits_of(message.encoder_counts, message.current)
            if recorded.setdefault(int(message.tick), bits) != bits:
                raise AssertionError(f"tick {message.tick} was reported twice, and differently")
        return recorded

    def forget(self) -> None:
        """Begin a new recording."""
        self._raw_states.clear()
        self.tick = -1
        self.status = self.truth = self.joint_states = self.joint_targets = None

    def value(self, node: str, key: str) -> str:
        """Return a value of a node's newest diagnostics, empty if it has none of that name."""
        status = self.diagnostics.get(node)
        return next((pair.value for pair in status.values if pair.key == key), "") if status else ""

    def refused(self, node: str, topic: str) -> int:
        """Return how many messages of a topic a node states it refused."""
        return int(self.value(node, f"refused {topic}") or 0)

    def printed(self, node: str, words: str) -> list[str]:
        """Return what a node stated in its diagnostics that begins with these words."""
        return [message for message in self.words.get(node, []) if message.startswith(words)]

    def _on_state(self, raw: bytes) -> None:
        if any(raw[: len(raw) - padding] in self.own_states for padding in range(4)):
            return
        state = deserialize_message(raw, MotorState)
        if self.machine not in (0, state.machine):
            return
        tick = int(state.tick)
        if tick == 0 and self.tick > 0:  # a new run; what is still on its way is of the old one
            self._raw_states.clear()
        self.tick = tick
        self._raw_states.append(raw)

    def _on_status(self, status: EmulatorStatus) -> None:
        self.status = status

    def _on_description(self, message: String) -> None:
        self.description = message.data

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.stamps[status.name] = convert_to_nanoseconds(array.header.stamp)
            self.diagnostics[status.name] = status
            printed = self.words.setdefault(status.name, [])
            if not printed or printed[-1] != status.message:
                printed.append(status.message)

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
    states = {session.tick: bits_of(session.measured.encoder_counts, session.measured.current)}
    while session.tick < ticks:
        run.advance(1)
        states[session.tick] = bits_of(session.measured.encoder_counts, session.measured.current)
    return states


def assert_same_bits(first: dict[int, bytes], second: dict[int, bytes], ticks: int) -> None:
    """Compare two recordings from tick 1 to `ticks`.

    Tick 0 may have been reported, and answered, before somebody listened. A listener in Python
    misses many of a fast network's later states, too: each one depends on all before it.
    """
    both = [tick for tick in range(1, ticks + 1) if tick in first and tick in second]
    assert len(both) > min(ticks // 2, 500) and both[-1] > ticks - 10, (
        f"of {ticks} ticks only {both}"
    )
    for tick in both:
        assert first[tick] == second[tick], f"the first difference is at tick {tick}"


@contextmanager
def user(namespace: str = "/", clock: str = "lockstep") -> Iterator[User]:
    """Be a user in a ROS domain of its own."""
    with own_domain() as domain:
        domain_user = User(domain, namespace, clock)
        try:
            yield domain_user
        finally:
            domain_user.close()


@contextmanager
def network(
    log: Path,
    *,
    scene: str = "three_axis",
    clock: str = "lockstep",
    start: str = "paused",
    only: tuple[str, ...] = ALL_THREE,
    forked: bool = True,
    **emulator: object,
) -> Iterator[tuple[User, Bringup]]:
    """Run nodes and a user in a ROS domain of their own; at the end all must end cleanly.

    Nodes that a test kills and starts again are started as those of `up` (`forked=False`).
    """
    if clock == "lockstep":  # a pace at which listeners in Python keep up, beside other tests
        emulator.setdefault("real_time_factor", 3.0)
    how: dict[str, Any] = {"clock": clock, "start": start, "only": only, "forked": forked}
    nodes = Bringup(scene, emulator=emulator, log=log, **how)
    with user(clock=clock) as network_user, nodes:
        yield network_user, nodes
        for name in only:
            code = nodes.get_process(name).poll()
            assert code is None, f"{name} ended by itself with {code}: {logs(log)}"
        codes = nodes.stop_nodes()
        assert set(codes.values()) == {0}, f"exit codes {codes}: {logs(log)}"


def wait_until_met(client: NetworkClient, node: str, patience: float) -> bool:
    """Wait until a node knows what a client has made so far; False: not within this time [s].

    Before that it may lose a message to a best-effort subscription, and answers to a client. The
    middleware reports publishers and clients in the order of their creation. A node that answers a
    new client therefore knows all earlier ones.
    """
    parameter_client = client.create_client(GetParameters, f"{node}/get_parameters")
    try:
        return client.call_service(parameter_client, GetParameters.Request(), patience) is not None
    finally:
        client.destroy_client(parameter_client)


class SharedNetwork:
    """One network for many tests: each finds it as at its start.

    A test that passes must leave it so that it can return to its start. After a test that fails it
    is ended, and the next test gets new processes.
    """

    def __init__(self, log: Path, *, start: str = "paused", **how: Any) -> None:
        self._log, self._start, self._how = log, start, how
        self._stack = ExitStack()
        self._running: tuple[User, Bringup] | None = None
        self._networks = 0

    @contextmanager
    def __call__(self) -> Iterator[tuple[User, Bringup]]:
        """Lend the network to one test."""
        if self._running is None:
            self._networks += 1
            log = self._log / str(self._networks)
            running_network = network(log, start=self._start, **self._how)
            self._running = self._stack.enter_context(running_network)
        user, _ = self._running
        try:
            yield self._running
            self._return_to_start(user)
        except BaseException:
            self._running = None
            broken, self._stack = self._stack, ExitStack()
            with suppress(AssertionError):  # the test has reported already what is wrong
                broken.close()
            raise

    def close(self) -> None:
        """End the network; its nodes must end cleanly."""
        self._running = None
        self._stack.close()

    def _return_to_start(self, user: User) -> None:
        """Reset the nodes, with power and nothing left of what they stated.

        Counters of diagnostics go on: tests compare differences.
        """
        paused = EmulatorStatus.PHASE_PAUSED
        assert user.call("emulator/power", True).success, "the power was not switched on"
        assert user.call("emulator/pause", True).success, "the machine was not paused"
        if self._start == "paused":  # then all three nodes are there, and nothing is on its way
            user.wait("the pause", lambda: user.status.phase == paused and user.status.answered)
            assert user.call("motion_controller/reset").success, "the targets were not forgotten"
        assert user.call("servo/reset").success, "the servo was not reset"
        user.forget()
        assert user.call("emulator/reset").success, "the emulator was not reset"
        if self._start == "paused":
            user.await_start()
        user.wait("tick 0", lambda: user.status and user.status.tick == 0 and user.tick == 0)
        assert user.status is not None and user.status.powered, "the power is off after a return"
        for printed in user.words.values():
            printed.clear()
        user.own_states.clear()


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


def kill(user: User, nodes: Bringup, name: str) -> None:
    """Kill a node; what it left unsaid stays unsaid."""
    process = nodes.get_process(name)
    process.send_signal(signal.SIGKILL)
    process.wait()
    user.forget_listeners(name)


def logs(folder: Path) -> str:
    """Return what the nodes wrote."""
    return "\n".join(f"--- {f.name}\n{f.read_text()[-3000:]}" for f in sorted(folder.glob("*.log")))
