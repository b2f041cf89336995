"""The three nodes in this process, their topics and services wired without a middleware.

Nothing runs by itself but the threads of a machine in real time: a test delivers messages one by
one, in the order in which they were reported, and may put its own in between.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from network import bits_of, question
from rclpy.serialization import deserialize_message, serialize_message

from arm_emulator.base.io.config_files import find_config
from arm_emulator.ros.c import MIDDLEWARE
from arm_emulator.ros.messages.message_types import read_definition
from arm_emulator.ros.messages.middleware import get_middleware
from arm_emulator.ros.node.barrier import guard_callback, refuse_request
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter
from arm_emulator_msgs.msg import MotorState
from emulator_node.node import EmulatorNode
from motion_controller_node.node import MotionControllerNode
from servo_node.node import ServoNode

# Modules that give C a function with which it publishes.
PUBLISHING = (
    "emulator_node.real_time_ticks", "emulator_node.answered_ticks", "servo_node.answered_states",
)  # fmt: skip


class Wires:
    """Topics and services by name."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[str, type, bytes]] = deque()  # stated, not delivered yet
        self.listeners: dict[str, list[Callable[[bytes], None]]] = defaultdict(list)
        self.of_bytes: list[Callable[[bytes], None]] = []  # those that nodes take as bytes
        self.published: Counter[str] = Counter()
        self.matched: dict[str, list[Callable[[Any], None]]] = defaultdict(list)
        self.services: dict[str, Callable[[Any, Any], Any]] = {}
        self.timers: list[Timer] = []
        self.newest: dict[str, tuple[str, type, bytes]] = {}  # what was reported last on each topic
        self.record: list[tuple[str, type, bytes]] | None = None  # all that was reported, if wanted
        self.publishers: list[Publisher] = []
        # For code in C that publishes.
        send, publish = "int(ros_message *)", "int(ros_message *, int64_t, int64_t, ros_log *)"
        self.send = MIDDLEWARE.ffi.callback(send)(self._send)  # cffi knows no const
        self.publish = MIDDLEWARE.ffi.callback(publish)(self._publish)

    def _send(self, message: Any) -> int:
        number = int(MIDDLEWARE.ffi.cast("uintptr_t", message.publisher))
        data = bytes(MIDDLEWARE.ffi.buffer(message.data, message.size))
        self.publishers[number - 1].publish(data)
        return 0

    def _publish(self, message: Any, time: int, tick: int, log: Any) -> int:
        get_middleware().ros_fill(message, time, tick, log)
        return self._send(message)

    def join(self, kind: type) -> Any:
        """Return a node of that kind on these wires."""
        wires = self

        class Wired(kind):  # type: ignore[misc]
            def create_publisher(self, kind: type, topic: str, *more: Any, **named: Any) -> Any:
                if topic.startswith("/"):  # rclpy's own
                    return super().create_publisher(kind, topic, *more, **named)
                wires.published[topic] += 1
                for matched in wires.matched[topic]:
                    matched(SimpleNamespace(current_count=wires.published[topic]))
                return Publisher(wires, kind, topic)

            def create_subscription(
                self, kind: type, topic: str, callback: Any, *more: Any, **named: Any
            ) -> SimpleNamespace:
                take = callback if named.get("raw") else _as_message(kind, callback)
                wires.listeners[topic].append(take)
                if take is callback:
                    wires.of_bytes.append(take)
                if "event_callbacks" in named:
                    matched = named["event_callbacks"].matched
                    wires.matched[topic].append(matched)
                    matched(SimpleNamespace(current_count=wires.published[topic]))
                return SimpleNamespace(topic_name=f"/{topic}")

            def create_service(self, kind: type, name: str, callback: Any, **named: Any) -> Any:
                if not name.startswith("~/"):  # rclpy's own
                    return super().create_service(kind, name, callback, **named)
                answer = guard_callback(self, name[2:], callback, refuse_request)
                wires.services[f"{self.get_name()}/{name[2:]}"] = answer
                return None

            def create_timer(self, period: float, callback: Any, **named: Any) -> Any:
                return Timer(wires, callback)

        return Wired()


def _as_message(kind: type, callback: Callable[[Any], None]) -> Callable[[bytes], None]:
    return lambda data: callback(deserialize_message(data, kind))


class Timer:
    """Calls back when a test reports it."""

    def __init__(self, wires: Wires, callback: Callable[[], None]) -> None:
        self.callback, self._canceled = callback, False
        wires.timers.append(self)

    def is_canceled(self) -> bool:
        return self._canceled

    def cancel(self) -> None:
        self._canceled = True

    def reset(self) -> None:
        self._canceled = False


class Handle:
    """A publisher as C knows it, by its number on the wires."""

    def __init__(self, number: int) -> None:
        self.pointer = number

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass


class Publisher:
    """States messages onto the wires."""

    def __init__(self, wires: Wires, kind: type, topic: str) -> None:
        self._wires, self._kind, self._topic = wires, kind, topic
        self.topic_name = f"/{topic}"
        wires.publishers.append(self)
        self.handle = Handle(len(wires.publishers))

    def publish(self, message: Any) -> None:
        data = message if isinstance(message, bytes) else serialize_message(message)
        printed = self._topic, self._kind, data
        self._wires.newest[self._topic] = printed
        if self._wires.record is not None:
            self._wires.record.append(printed)
        if self._topic in self._wires.listeners:
            self._wires.waiting.append(printed)

    def get_subscription_count(self) -> int:
        return len(self._wires.listeners[self._topic])


class InProcess:
    """The three nodes, and what a user of their topics does.

    Attributes:
        states: bits of counts and currents by tick, of the newest run.
        nodes: by name.
    """

    def __init__(self) -> None:
        self._wires = Wires()
        patch = pytest.MonkeyPatch()
        calls = SimpleNamespace(ros_send=self._wires.send, ros_publish=self._wires.publish)
        for module in PUBLISHING:
            patch.setattr(f"{module}.get_middleware", lambda: calls)
        self.states: dict[int, bytes] = {}
        self.tick = -1
        self._heard = _as_message(MotorState, self._on_state)
        self._wires.listeners["motor_states"].append(self._heard)
        # The emulator last: it states tick 0, and its description, at once.
        kinds = {"servo": ServoNode, "motion_controller": MotionControllerNode}
        self.nodes = {name: self._wires.join(kind) for name, kind in kinds.items()}
        self.nodes["emulator"] = self._wires.join(EmulatorNode)
        patch.undo()

    def close(self) -> None:
        for node in self.nodes.values():
            node.close()
            node.destroy_node()

    def deliver(self) -> bool:
        """Deliver the message that was published first; False after the last."""
        if not self._wires.waiting:
            return False
        topic, _, data = self._wires.waiting.popleft()
        for listener in self._wires.listeners[topic]:
            listener(data)
        return True

    def run_to(self, tick: int, between: Callable[[], None] = lambda: None) -> None:
        """Deliver until that tick was reported; `between` any two messages do something else."""
        while self.tick < tick:
            between()
            assert self.deliver(), f"nobody states anything any more at tick {self.tick} of {tick}"

    def send(self, topic: str, message: Any) -> None:
        """Deliver a message of one's own at once, to the nodes alone."""
        self.send_bytes(topic, serialize_message(message))

    def send_bytes(self, topic: str, data: bytes) -> None:
        """Deliver bytes of one's own at once, to the nodes alone."""
        for listener in self._wires.listeners[topic]:
            if listener != self._heard:
                listener(data)

    def take_in_c(self, node: str) -> Counter[int]:
        """Have the messages of a node's hot path taken in C first, Python taking what is left.

        Returns:
            Number of messages by what C did with them, enum ros_taken.
        """
        done: Counter[int] = Counter()
        hot = self.nodes[node].hot
        for message in hot.outgoing:
            message.bind_to_c()
        for subscription, take, argument in hot.takes:
            topic = subscription.topic_name[1:]
            (python,) = (
                listener
                for listener in self._wires.listeners[topic]
                if listener in self._wires.of_bytes
            )

            def both(
                data: bytes, take: Any = take, argument: Any = argument, python: Any = python
            ) -> None:
                hot.begin_in_c()
                result = take(argument, data, len(data))
                hot.end_in_c()
                done[result] += 1
                if result:
                    python(data)

            listeners = self._wires.listeners[topic]
            listeners[listeners.index(python)] = both
        return done

    def stated(self) -> dict[str, bytes]:
        """Return the bytes that were published last, by topic."""
        return {topic: data for topic, (_, _, data) in self._wires.newest.items()}

    def published(self, topics: Collection[str]) -> list[tuple[str, Any]]:
        """Return what was recorded on some topics, in order."""
        return [
            (topic, deserialize_message(data, kind))
            for topic, kind, data in self._wires.record or []
            if topic in topics
        ]

    def listen_alone(self, topic: str, kind: type, callback: Callable[[Any], None]) -> None:
        """Deliver messages on a topic to this callback only."""
        self._wires.listeners[topic] = [_as_message(kind, callback)]

    def forget(self) -> None:
        """Begin a new recording."""
        self.states.clear()
        self.tick = -1

    def call(self, name: str, request: Any = None) -> Any:
        """Call a service, with a request as `question` takes it."""
        kind, message = question(request)
        return self._wires.services[name](message, kind.Response())

    def begin_record(self) -> None:
        """Keep all that is reported from now on, for `write`."""
        self._wires.record = []

    def write(self, bag: Path) -> Path:
        """Write all that was kept into a new bag."""
        numbers: dict[str, int] = {}
        with BagWriter(bag) as writer:
            for at, (topic, kind, data) in enumerate(self._wires.record or []):
                if topic not in numbers:
                    name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
                    numbers[topic] = writer.add_topic(
                        Topic(f"/{topic}", name, read_definition(name))
                    )
                writer.write_message(numbers[topic], at, at, data)
        return bag

    def timers(self) -> None:
        """Call every timer of every node once."""
        for timer in list(self._wires.timers):
            if not timer.is_canceled():
                timer.callback()

    def newest(self, topic: str) -> Any:
        """Return what the nodes stated last on a topic."""
        _, kind, data = self._wires.newest[topic]
        return deserialize_message(data, kind)

    def refused(self, node: str) -> int:
        """Return how many messages a node has refused."""
        return int(self.nodes[node]._diagnostics.refused)

    def _on_state(self, message: MotorState) -> None:
        self.tick = int(message.tick)
        if self.tick == 0:
            self.states.clear()
        self.states[self.tick] = bits_of(message.encoder_counts, message.current)


@contextmanager
def in_process(
    clock: str = "lockstep",
    scene: str = "three_axis",
    file: Path | None = None,
    servo: Path | None = None,
    motion: Path | None = None,
) -> Iterator[InProcess]:
    """Run the three nodes of a scene in this process, from the first answer on.

    `file` is the scene's file if it differs from the named scene in its numbers only. `servo` and
    `motion` are files in the place of the scene's own gains.
    """
    gains = servo or find_config(scene, ".yaml", "servo")
    motion = motion or find_config(scene, ".yaml", "motion")
    arguments = ["--ros-args", "--params-file", str(gains), "--params-file", str(motion)]
    for node, name, value in (
        ("emulator", "scene", file or scene),
        ("emulator", "start", "first_answer"),
        ("emulator", "clock", clock),
        ("emulator", "real_time_factor", 0.0),
        ("servo", "clock", clock),
    ):
        arguments += ["-p", f"{node}:{name}:={value}"]
    with own_domain():
        rclpy.init(args=arguments)
        try:
            inside = InProcess()
            try:
                yield inside
            finally:
                inside.close()
        finally:
            rclpy.try_shutdown()
