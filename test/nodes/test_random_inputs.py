"""Random values in all fields of all services, topics and parameters of a network that runs.

No node ends, each refusal has its answer, and the network works afterwards. Where no order asks
for it and no service changes the machine, no joint exceeds its limits.
"""

import itertools
import os
import random
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from draws import some
from network import ALL_THREE, ASK_AGAIN, JOINTS, PATIENCE, SOLE_PUBLISHER, User, logs, network
from random_fields import class_of, fill
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.ros.messages.time_stamp import NANOSECONDS, convert_to_nanoseconds
from arm_emulator.ros.node.node_shell import EVENT_QOS
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator_msgs.msg import EmulatorStatus, MachineEvent, MotionStatus, ServoState
from emulator_node.page_controls import RosControls

WORDS = (
    *JOINTS, "world", "tool", "base", "abs(v.elbow) > 1", "q.waist > 0.1", "clock", "period",
    "max_speed", "joints.waist.kp", "use_sim_time", "real_time_factor", "nobody", "",
)  # fmt: skip
# A client may request a final shutdown, which ends the work of a node.
PERSISTENT = ("change_state",)
PUSHES = ("external_wrench", "external_wrench_in_world")  # move the arm by force
OUTSTANDING = 20  # calls
FREE_PATH_DRAWS = 20  # of a trajectory; links touch on some 1 in 6 of these ways
IGNORED = ("/parameter_events", "/rosout", "/diagnostics")
COUNT = some(range(int(os.environ.get("COUNT", "10000"))), 400)  # of each of the two tests
SEED = os.environ.get("SEED", "19")


class Strangers:
    """A node that publishes and calls everything.

    Args:
        user: of the network.
        rng: draws.
    """

    def __init__(self, user: User, rng: random.Random) -> None:
        self._user, self._rng = user, rng
        self.node = Node("stranger", context=user.node.context)
        user.add(self.node)
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._futures: list[Any] = []
        self.answered = 0
        # More than 30 services and 9 topics when discovery has all of them.
        user.wait("topics", lambda: len(self._found()[0]) > 9 and len(self._found()[1]) > 40)
        self.topics, self.services = self._found()
        self.parameters = {
            name: self._call_now(f"/{name}/list_parameters", "ListParameters").result.names
            for name in ALL_THREE
        }

    def _found(self) -> tuple[dict[str, str], dict[str, str]]:
        topics: dict[str, str] = {}
        services: dict[str, str] = {}
        for name in ALL_THREE:
            if name in self.node.get_node_names():
                topics |= {
                    topic: kinds[0]
                    for topic, kinds in self.node.get_subscriber_names_and_types_by_node(name, "/")
                }
                services |= {
                    service: kinds[0]
                    for service, kinds in self.node.get_service_names_and_types_by_node(name, "/")
                }
        return {t: k for t, k in topics.items() if t not in IGNORED}, services

    def _call_now(self, service: str, kind: str) -> Any:
        client = self.node.create_client(class_of(f"rcl_interfaces/srv/{kind}"), service)
        answer = self._user.node.call_service(
            client, class_of(f"rcl_interfaces/srv/{kind}").Request(), PATIENCE
        )
        assert answer is not None, service
        return answer

    def publish(self, topic: str, message: Any = None) -> None:
        """Publish a message, a random one if it is None."""
        kind = class_of(self.topics[topic])
        if topic not in self._publishers:
            is_latched = topic in ("/robot_description", "/emulator/events")
            qos = QoSProfile(depth=10)
            if is_latched:
                qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        self._publishers[topic].publish(
            fill(self._rng, kind(), WORDS) if message is None else message
        )

    def listeners(self, topic: str) -> int:
        """Return how many listeners the publisher of a topic has found."""
        count: int = self._publishers[topic].get_subscription_count()
        return count

    def call(self, service: str) -> None:
        """Call a service with a random request; parameters are those of its node, most often."""
        kind = class_of(self.services[service])
        request = fill(self._rng, kind.Request(), WORDS)
        if kind is SetParameters:
            names = self.parameters[service.split("/")[1]]
            request.parameters = [
                Parameter(
                    name=self._rng.choice(names), value=fill(self._rng, ParameterValue(), WORDS)
                )
                for _ in range(3)
            ]
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
            self._user.wait(service, self._clients[service].service_is_ready)
        future = self._clients[service].call_async(request)
        future.service = service
        self._futures.append(future)
        self._user.wait("answers", lambda: len(self.waiting()) < OUTSTANDING)

    def waiting(self) -> list[str]:
        """Return services that have not answered yet."""
        self.answered += sum(future.done() for future in self._futures)
        self._futures = [future for future in self._futures if not future.done()]
        return [future.service for future in self._futures]

    def settle(self) -> None:
        """Wait for all answers.

        A server that has not found its client yet loses the answer: such services are called again.
        """
        self._user.node.spin_until(lambda: not self.waiting(), ASK_AGAIN)
        for service in set(self.waiting()):
            self.call(service)
            self._user.wait(f"an answer of {service}", self._futures[-1].done)
        self._futures.clear()


def assert_alive(nodes: Bringup, log: Path) -> None:
    ended = nodes.find_ended()
    assert ended is None, f"{ended} ended by itself: {logs(log)}"


@pytest.mark.slow
def test_random_values_of_every_service_topic_and_parameter_end_no_node(tmp_path: Path) -> None:
    rng = random.Random(f"values {SEED}")
    with network(tmp_path, start="first_answer", forked=False) as (user, nodes):
        user.wait("the run", lambda: user.tick > 100)
        strangers = Strangers(user, rng)
        services = [service for service in strangers.services if not service.endswith(PERSISTENT)]
        assert len(services) > 30 and len(strangers.topics) > 9, strangers.topics
        for number, _ in enumerate(COUNT):
            if rng.random() < 0.5:
                strangers.publish(rng.choice([*strangers.topics]))
                user.spin(0.001)
            else:
                strangers.call(rng.choice(services))
            if number % 50 == 0:
                assert_alive(nodes, tmp_path)
        strangers.settle()
        assert_alive(nodes, tmp_path)
        assert strangers.answered > len(COUNT) / 3
        # The machine may be paused, without power, with other gains; its nodes serve.
        for name in ALL_THREE:
            strangers._call_now(f"/{name}/list_parameters", "ListParameters")
        strangers.node.destroy_node()


@pytest.mark.slow
def test_strangers_orders_and_stamps_keep_a_moving_arm_within_its_limits(tmp_path: Path) -> None:
    """Joints move to and fro, and every topic gets messages of strangers, of any time and content.

    Measured are the true speeds of links; their gears are elastic, so 5 % are allowed beside
    the limits of the description.
    """
    rng = random.Random(f"orders {SEED}")
    scene = load_scene("ur5")
    names = list(scene.joint_names)
    elements = ElementTree.fromstring(scene.urdf).findall("joint")
    limits = {element.get("name", ""): element.find("limit") for element in elements}
    with network(tmp_path, scene="ur5", start="first_answer", forked=False) as (user, nodes):
        user.wait("the run", lambda: user.tick > 100)
        strangers = Strangers(user, rng)
        topics = [topic for topic in strangers.topics if topic.strip("/") not in PUSHES]
        user.wait("true states", lambda: user.truth is not None)
        strangers.publish("/joint_trajectory", swing(rng, names))
        user.wait("a listener", lambda: strangers.listeners("/joint_trajectory") > 0)
        fastest, reports = 0.0, list[MotionStatus]()
        user.node.create_subscription(MotionStatus, "motion/status", reports.append, EVENT_QOS)
        until = time.monotonic() + PATIENCE
        for number in itertools.count():
            # Orders of strangers replace each other: after COUNT messages they send states alone,
            # until the arm has moved.
            if number == len(COUNT):
                topics = [topic for topic in topics if topic.strip("/") in SOLE_PUBLISHER]
            if number >= len(COUNT) and (fastest > 0.05 or time.monotonic() > until):
                break
            topic = rng.choice(topics)
            message = fill(rng, class_of(strangers.topics[topic])(), WORDS)
            if hasattr(message, "header") and rng.random() < 0.7:
                at = user.truth.header.stamp
                message.header.stamp.sec = rng.choice((0, at.sec, at.sec + 1, at.sec // 2))
                message.header.stamp.nanosec = rng.choice((0, at.nanosec, 50_000_000))
            if isinstance(message, JointState | ServoState) and rng.random() < 0.7:
                sound(rng, message, names)
            strangers.publish(topic, message)
            if number % (100 if number < len(COUNT) else 1000) == 0:
                strangers.publish("/joint_trajectory", swing(rng, names))
                assert_alive(nodes, tmp_path)
            user.spin(0.002)
            assert_within(user, limits)
            fastest = max([fastest, *map(abs, user.truth.velocity)])
        assert_alive(nodes, tmp_path)
        assert fastest > 0.05, "rad/s: the arm has moved"
        # Its reports are true: a trajectory that nothing disturbs has ended where it was to end.
        own = user.node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        user.wait("a listener", lambda: own.get_subscription_count() > 0)
        strangers.node.destroy_node()
        heard = -1
        while heard < len(reports):  # orders that were under way, until none is reported any more
            heard = len(reports)
            user.node.spin_until(lambda: False, 2.0)
        assert user.call("motion_controller/reset").success
        kind = MotionStatus.KIND_JOINT_TRAJECTORY
        moving = (MotionStatus.STATE_ACCEPTED, MotionStatus.STATE_MOVING)
        # A trajectory on whose way links touch each other is refused: another one is drawn.
        for _ in range(FREE_PATH_DRAWS):
            heard, goal = len(reports), swing(rng, names)
            # The reset is answered before the reports of orders that it gave up are heard.
            last = max((report.number for report in reports if report.kind == kind), default=0)
            own.publish(goal)
            end = user.wait(
                "its end",
                lambda heard=heard, last=last: next(
                    (
                        report
                        for report in reports[heard:]
                        if report.kind == kind
                        and report.number > last
                        and report.state not in moving
                    ),
                    None,
                ),
            )
            if end.state != MotionStatus.STATE_REFUSED:
                break
            assert "would touch" in end.reason, end
        assert end.state == MotionStatus.STATE_REACHED, end
        # The truth received so far may be older than the report: its own stamp counts.
        later = convert_to_nanoseconds(end.header.stamp) + NANOSECONDS // 2
        user.wait("a newer state", lambda: convert_to_nanoseconds(user.truth.header.stamp) > later)
        at = dict(zip(user.truth.name, user.truth.position, strict=True))
        off = np.subtract([at[name] for name in names], goal.points[0].positions)
        assert np.abs(off).max() < 0.02, f"{off} rad, more than gears wind up: {reports[heard:]}"


def test_the_page_survives_foreign_publications() -> None:
    """Diagnostics with a breakpoint of another form, phases that do not exist, any field."""
    rng = random.Random(f"page {SEED}")
    with own_domain() as domain:
        user = User(domain)
        controls = RosControls("/", 1e-3, lockstep=True)
        try:
            kinds = (EmulatorStatus, MachineEvent, MotionStatus, DiagnosticArray)
            topics = ("emulator/status", "emulator/events", "motion/status", "diagnostics")
            publishers = [
                user.node.create_publisher(kind, topic, EVENT_QOS)
                for kind, topic in zip(kinds, topics, strict=True)
            ]
            user.wait("the page", lambda: all(p.get_subscription_count() for p in publishers))
            pairs = [KeyValue(key="newest breakpoint", value="stopped at tick x: why")]
            publishers[3].publish(DiagnosticArray(status=[DiagnosticStatus(values=pairs)]))
            publishers[0].publish(EmulatorStatus(phase=200))
            for _ in range(300):
                kind, publisher = rng.choice([*zip(kinds, publishers, strict=True)])
                publisher.publish(fill(rng, kind(), WORDS))
                user.spin(0.001)
            end = EmulatorStatus(phase=EmulatorStatus.PHASE_RUNNING, powered=True)
            publishers[0].publish(end)
            user.wait("the newest state", lambda: controls.news().state == "running")
            controls.news()
        finally:
            controls.close()
            user.close()


def sound(rng: random.Random, message: Any, names: list[str]) -> None:
    """Make a message one that a receiver could take."""
    if isinstance(message, JointState):
        message.name, message.velocity, message.effort = names, [], []
        message.position = [rng.uniform(-1.0, 1.0) for _ in names]
    else:
        message.joint_names, message.movable = names, [rng.randrange(2) for _ in names]


def swing(rng: random.Random, names: list[str]) -> JointTrajectory:
    """Return a trajectory of all joints to somewhere, as quick as they may."""
    point = JointTrajectoryPoint(positions=[rng.uniform(-1.5, 1.5) for _ in names])
    point.time_from_start.sec = 1
    return JointTrajectory(joint_names=names, points=[point])


def assert_within(user: User, limits: dict[str, Any]) -> None:
    for name, q, v in zip(user.truth.name, user.truth.position, user.truth.velocity, strict=True):
        lower, upper, largest = (
            float(limits[name].get(key)) for key in ("lower", "upper", "velocity")
        )
        assert abs(v) <= 1.05 * largest, f"{name} moves at {v:.3g} rad/s, of {largest:g}"
        assert 1.05 * lower <= q <= 1.05 * upper, f"{name} is at {q:.3g} rad"
