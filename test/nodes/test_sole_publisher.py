"""Topics of one publisher: messages of others change nothing, whatever they contain."""

import random
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from draws import some
from network import JOINTS, SOLE_PUBLISHER, User, network
from node_parameters import Parameters
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.time_stamp import (
    NANOSECONDS,
    convert_to_nanoseconds,
    convert_to_stamp,
)
from arm_emulator.ros.node.node_shell import EVENT_QOS
from arm_emulator.ros.node.sole_publisher import IDENTIFY, KINDS, SolePublisher
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator_msgs.msg import (
    EmulatorStatus,
    MachineEvent,
    MotionStatus,
    MotorCommand,
    MotorState,
    ServoState,
)

SPEED = 0.3  # rad/s, of the trajectories below: 0.6 rad in 3 s, 1.5 times their mean


class Mover:
    """A user who moves the arm by trajectories.

    Attributes:
        heard: reports of motions.
    """

    def __init__(self, user: User) -> None:
        self.user, self.heard = user, list[MotionStatus]()
        user.node.create_subscription(MotionStatus, "motion/status", self.heard.append, EVENT_QOS)
        self._orders = user.node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        user.wait("the run", lambda: user.truth is not None)
        user.wait("a listener", lambda: self._orders.get_subscription_count() > 0)
        user.wait("health", lambda: user.printed("motion_controller", "holding"))

    def state_of(self, number: int) -> int:
        """Return the newest state of a trajectory, 0 for none."""
        return next((report.state for report in self.heard[::-1] if report.number == number), 0)

    def move(self, to: float, seconds: int = 3) -> int:
        """Send all joints to a place; return the number of the trajectory."""
        number = 1 + max((report.number for report in self.heard), default=0)
        point = JointTrajectoryPoint(positions=[to, 0.5 + to, 0.8 + to], velocities=[0.0] * 3)
        point.time_from_start.sec = seconds
        self._orders.publish(JointTrajectory(joint_names=JOINTS, points=[point]))
        moving = MotionStatus.STATE_MOVING
        self.user.wait("the motion", lambda: self.state_of(number) == moving)
        return number


@pytest.fixture(
    scope="module", params=["lockstep", pytest.param("realtime", marks=pytest.mark.slow)]
)
def mover(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Mover]:
    log = tmp_path_factory.mktemp("log")
    with network(log, clock=request.param, start="first_answer") as (user, _):
        # A busy machine may keep the motion controller from computing for seconds of real time.
        refused = Parameters(user).set("servo", hold_after=50.0, cut_after=100.0)
        assert not refused, refused
        yield Mover(user)


def strangers(rng: random.Random, user: User) -> dict[str, Any]:
    """Return a sound message of each topic, of any time."""
    at = convert_to_nanoseconds(user.truth.header.stamp)
    time_ns = rng.choice((0, at // 2, at, at + 50_000_000, at + NANOSECONDS))
    tick = time_ns // 1_000_000
    q = [rng.uniform(-1.0, 1.0) for _ in JOINTS]
    messages = {
        "joint_states": JointState(name=JOINTS, position=q, velocity=q),
        "joint_targets": JointState(name=JOINTS, position=q),
        "servo_states": ServoState(joint_names=JOINTS, movable=[rng.randrange(2) for _ in JOINTS]),
        "motor_states": MotorState(
            tick=tick, joint_names=JOINTS, encoder_counts=[0] * 3, current=[0.0] * 3, powered=True
        ),
        "motor_commands": MotorCommand(tick=tick, joint_names=JOINTS, command=[24.0] * 3),
        "emulator/events": MachineEvent(kind=MachineEvent.KIND_RESET),
        "clock": Clock(clock=convert_to_stamp(time_ns)),
        "robot_description": String(data=user.description.replace("shoulder", "other")),
    }
    for value in messages.values():
        if hasattr(value, "header"):
            value.header.stamp = convert_to_stamp(rng.choice((0, time_ns)))
    return messages


@pytest.mark.slow
def test_messages_of_strangers_do_not_change_a_motion(mover: Mover) -> None:
    """Also none that would reset time: a motion goes on, as slowly as it was commanded."""
    user = mover.user
    rng = random.Random(8)
    stranger = Node("stranger", context=user.node.context)
    user.add(stranger)
    fastest, publishers = 0.0, {}
    try:
        for to in some((0.6, 0.0, 0.6, 0.0), 1):
            number = mover.move(to)
            while mover.state_of(number) == MotionStatus.STATE_MOVING:
                for topic, message in strangers(rng, user).items():
                    if topic not in publishers:
                        qos = EVENT_QOS if "/" in topic or "robot" in topic else QoSProfile(depth=9)
                        publishers[topic] = stranger.create_publisher(type(message), topic, qos)
                    publishers[topic].publish(message)
                user.spin(0.02)
                fastest = max(fastest, *map(abs, user.truth.velocity))
            assert mover.state_of(number) == MotionStatus.STATE_REACHED, mover.heard[-1]
        for topic, owner in SOLE_PUBLISHER.items():
            receivers = user.wait(
                f"a node to refuse {topic}",
                lambda t=topic: [
                    diagnostic for diagnostic in user.diagnostics if user.refused(diagnostic, t)
                ],
            )
            words = f"publisher must be node /{owner}, whose messages are taken, got node /stranger"
            user.wait(
                f"{topic} to be named",
                lambda t=topic, w=words, r=receivers: any(
                    w in user.value(diagnostic, f"other publishers of {t}") for diagnostic in r
                ),
            )
    finally:
        stranger.destroy_node()
    # The true speed of an elastic arm swings a little about the commanded one. In real time a busy
    # machine delays commands, with or without strangers.
    if user.value("emulator", "nice value") == "":
        assert SPEED * 0.9 < fastest < SPEED * 1.2, "the trajectory's largest speed is 0.3 rad/s"


def test_a_reset_by_the_emulator_restarts(mover: Mover) -> None:
    user = mover.user
    number = mover.move(0.6, 600)  # longer than any delay of a busy machine
    assert user.call("emulator/reset").success
    user.wait("the end", lambda: mover.state_of(number) == MotionStatus.STATE_ABORTED)
    assert "the machine began anew" in next(
        report.reason for report in mover.heard[::-1] if report.number == number
    )
    after = mover.move(0.6)
    user.wait("the next", lambda: mover.state_of(after) == MotionStatus.STATE_REACHED)
    running_ = EmulatorStatus.PHASE_RUNNING
    user.wait("the run", lambda: user.status is not None and user.status.phase == running_)


@pytest.mark.slow
def test_a_first_publisher_yields_to_the_servo(tmp_path: Path) -> None:
    """A stranger published joint states before there was a servo."""
    with network(tmp_path, only=("motion_controller",), start="first_answer") as (user, _):
        sent = JointState(name=JOINTS, position=[0.3, 0.3, 0.3])
        user.publish(user.measured, sent)
        others = Bringup("three_axis", only=("emulator", "servo"), log=tmp_path / "others")
        with others:
            user.wait("the run", lambda: user.tick >= 200)
            words = "publisher must be node /servo"

            def refused() -> bool:
                user.measured.publish(sent)  # again: joint states may get lost
                return words in user.value("motion_controller", "newest refusal")

            user.wait("the refusal", refused)
            tick = user.tick
            user.wait("the run to go on", lambda: user.tick >= tick + 200)


class SlowGraph:
    """A node whose graph knows publishers before their nodes."""

    def __init__(self) -> None:
        self.names = dict[str, dict[bytes, str]]()  # by topic and publisher
        self.refusals = list[str]()

    def refuse(self, topic: str, reason: Refusal, times: int = 1) -> None:
        """See `Diagnostics`."""
        self.refusals += [str(reason)] * times

    def count(self, topic: str, times: int = 1) -> None:
        """See `Diagnostics`."""

    def note(self, name: str, value: object) -> None:
        """See `SubscribingNode`."""

    def has_lost(self, kind: str, there: int) -> bool:
        """See `SubscribingNode`."""
        return False

    def resolve_topic_name(self, topic: str) -> str:
        """See `Node`."""
        return f"/{topic}"

    def get_publishers_info_by_topic(self, topic_name: str) -> list[Any]:
        """See `Node`."""
        return [
            SimpleNamespace(endpoint_gid=gid, node_namespace="/", node_name=name)
            for gid, name in self.names.get(topic_name, {}).items()
        ]


def test_a_refusal_waits_for_the_names_of_its_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A single message, which a busy machine's graph gets before it has any name."""
    graph, unknown = SlowGraph(), "_NODE_NAME_UNKNOWN_"
    size = len(bytes(SolePublisher(graph, "joint_states", "servo", keeps=False).owner.id))
    servo, stranger = b"s" * size, b"t" * size
    sole = SolePublisher(graph, "joint_states", "servo", keeps=False)
    graph.names["/joint_states"] = {servo: unknown}
    assert sole.is_admitted(servo), "it is the first one"
    graph.names["/joint_states"][stranger] = unknown
    assert not sole.is_admitted(stranger)
    sole.report_dropped()
    assert graph.refusals == [], "it names nobody yet"
    for topic in KINDS["servo"]:
        graph.names[f"/{topic}"] = {servo: "servo"}
    graph.names["/joint_states"][stranger] = "stranger"
    sole.report_dropped()
    assert len(graph.refusals) == 1
    assert "must be node /servo, whose messages are taken, got node /stranger" in graph.refusals[0]
    # A publisher that stays unknown is reported nevertheless, after some time.
    graph.names["/joint_states"][stranger] = unknown
    unnamed = b"o" * size
    assert not sole.is_admitted(unnamed)
    sole.report_dropped()
    assert len(graph.refusals) == 1
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + IDENTIFY)
    sole.report_dropped()
    assert len(graph.refusals) == 2 and "does not have yet" in graph.refusals[1]
