"""A network in lock-step under test: targets that are acknowledged, waits by logical time."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.event_words import STATES
from arm_emulator.ros.messages.time_stamp import (
    NANOSECONDS,
    convert_to_nanoseconds,
    convert_to_stamp,
)
from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.node.node_shell import (
    COMMAND_QOS,
    EVENT_QOS,
    NO_DESCRIPTION,
    STATE_PUB_QOS,
)
from arm_emulator_msgs.msg import EmulatorStatus, MotionStatus
from arm_emulator_msgs.srv import SetVaried

PATIENCE = 120.0  # s, wall: for what takes below a second on an idle machine
AHEAD = 0.25  # s, logical: a target arrives before it holds
HEALTH_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
UNFINISHED = ("accepted", "moving")


class NetworkUnderTest:
    """A running network, as a test uses it. All waits end with an AssertionError after 120 s.

    A network that was started with ``start="paused"`` stands at tick 0 until `go_on`: targets that
    are sent before, with their logical times, act at the same ticks on every run. What is sent to a
    running network acts at the tick at which it arrives; its bag has that tick.

    Attributes:
        statuses: all of motion/status so far.

    Args:
        ended: names a node that has ended; None while all run.
        ours: names of the nodes that are not the user's own.
    """

    def __init__(self, context: Context, ended: Callable[[], object], ours: Sequence[str]) -> None:
        self._ended, self._ours = ended, ours
        self._health: dict[str, DiagnosticStatus] = {}
        self._client = client = NetworkClient("test", "", context)
        self.statuses: list[MotionStatus] = []
        self._targets: list[tuple[int, int]] = []  # kind and time [ns] of each target sent
        client.listen_to("emulator/joint_states", JointState, STATE_PUB_QOS)
        client.listen_to("emulator/status", EmulatorStatus, STATE_PUB_QOS)
        client.create_subscription(MotionStatus, "motion/status", self.statuses.append, EVENT_QOS)
        client.create_subscription(DiagnosticArray, "diagnostics", self._take_health, HEALTH_QOS)
        create = client.create_publisher
        self._tool_targets = create(PoseStamped, "tool_target", COMMAND_QOS)
        self._trajectories = create(JointTrajectory, "joint_trajectory", COMMAND_QOS)

    def close(self) -> None:
        """Leave the network."""
        self._client.destroy_node()

    @property
    def status(self) -> EmulatorStatus:
        """The newest emulator/status."""
        self._wait_until("emulator/status", lambda: "emulator/status" in self._client.newest)
        newest: EmulatorStatus = self._client.newest["emulator/status"]
        return newest

    @property
    def truth(self) -> JointState:
        """The newest true angles, speeds and torques of the links."""
        self._wait_until(
            "true joint states", lambda: "emulator/joint_states" in self._client.newest
        )
        newest: JointState = self._client.newest["emulator/joint_states"]
        return newest

    @property
    def time(self) -> float:
        """Logical time of `truth` [s]."""
        return convert_to_nanoseconds(self.truth.header.stamp) / NANOSECONDS

    def go_on(self, paused: bool = False) -> None:
        """Let logical time pass, or pause it. Tick 0 is left when it was answered."""
        if not paused:
            self._wait_until(
                "answer to tick 0", lambda: self.status.tick > 0 or self.status.answered
            )
        self._switch_state("emulator/pause", paused)

    def power(self, on: bool) -> None:
        """Switch the power of all drives."""
        self._switch_state("emulator/power", on)

    def set_fault(self, name: str, magnitude: float = 1.0) -> None:
        """Set a fault that the scene lists, 0 for none, from this tick on.

        ``joint.controller_restarts`` cuts one motor's torque: its drive is disabled.

        Raises:
            Refusal: the scene does not list it, or another magnitude.
        """
        request = SetVaried.Request(name=f"faults.{name}", value=float(magnitude))
        answer = self._call_service(SetVaried, "emulator/set_varied", request)
        if not answer.success:
            raise Refusal("testing.network", f"fault {name}", "be settable", answer.message)

    def wait_until(self, t: float) -> None:
        """Wait until a logical time [s]."""
        self._wait_until(f"t = {t:g} s", lambda: self.time >= t)

    def send_tool_target(
        self,
        position: tuple[float, float, float],
        quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
        at: float | None = None,
    ) -> int:
        """Send a target for the tool, and wait until it is acknowledged.

        Args:
            position: x, y, z in the world [m].
            quaternion: x, y, z, w.
            at: logical time from which it holds [s]; None: 0.25 s from now.

        Returns:
            Its number, for `get_state` and `wait_for`.
        """
        message = PoseStamped()
        p, o = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = map(float, position)
        o.x, o.y, o.z, o.w = map(float, quaternion)
        return self._send_message(self._tool_targets, message, MotionStatus.KIND_TOOL_TARGET, at)

    def send_joint_target(
        self, angles: Mapping[str, float], seconds: float, at: float | None = None
    ) -> int:
        """Send a trajectory of one point, and wait until it is acknowledged.

        Args:
            angles: of all joints, by name [rad or m].
            seconds: its logical time [s].
            at: see `send_tool_target`.

        Returns:
            Its number, for `get_state` and `wait_for`.
        """
        if not (math.isfinite(seconds) and seconds > 0.0):
            raise Refusal("testing.network", "seconds", "be > 0 and finite", seconds)
        point = JointTrajectoryPoint(positions=[float(value) for value in angles.values()])
        total_ns = round(seconds * NANOSECONDS)
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(total_ns, NANOSECONDS)
        message = JointTrajectory(joint_names=list(angles), points=[point])
        return self._send_message(
            self._trajectories, message, MotionStatus.KIND_JOINT_TRAJECTORY, at
        )

    def state_of(self, number: int) -> str:
        """Return the newest state of a target: "accepted", "moving", "reached", ...; "": none."""
        kind, time_ns = self._targets[number]
        states = [
            STATES.get(status.state, f"state {status.state}")
            for status in self.statuses
            if status.kind == kind and convert_to_nanoseconds(status.stamp) == time_ns
        ]
        return states[-1] if states else ""

    def wait_for(self, number: int, state: str = "reached") -> None:
        """Wait until a target has a state.

        Raises:
            AssertionError: it has come to an end in another one.
        """
        self._wait_until(f"an end of target {number}", lambda: self._is_settled(number, state))
        actual = self.state_of(number)
        assert actual == state, (
            f"target {number} is {actual}, not {state}: {self._find_reason(number)}"
        )

    def _is_settled(self, number: int, state: str) -> bool:
        actual = self.state_of(number)
        return actual == state or actual not in ("", *UNFINISHED)

    def _find_reason(self, number: int) -> str:
        kind, time_ns = self._targets[number]
        of = [status for status in self.statuses if status.kind == kind]
        return next((o.reason for o in of[::-1] if convert_to_nanoseconds(o.stamp) == time_ns), "")

    def _send_message(self, publisher: Publisher, message: Any, kind: int, at: float | None) -> int:
        self._wait_until(
            f"listeners to {publisher.topic_name}",
            lambda: self._client.is_heard(publisher, "motion/status"),
        )
        # Until then trajectories are refused.
        self._wait_until("a motion controller that knows the arm", self._has_arm)
        number = len(self._targets)
        # The nanoseconds distinguish targets of one time.
        time_ns = round((self.time + AHEAD if at is None else at) * NANOSECONDS) + number
        self._targets.append((kind, time_ns))
        message.header.stamp = convert_to_stamp(time_ns)
        publisher.publish(message)
        self._wait_until(f"an answer to target {number}", lambda: self.state_of(number) != "")
        return number

    def _take_health(self, array: DiagnosticArray) -> None:
        self._health |= {status.name: status for status in array.status}

    def _has_arm(self) -> bool:
        health = self._health.get("motion_controller")
        return "motion_controller" not in self._ours or (
            health is not None and health.message not in ("starting", NO_DESCRIPTION)
        )

    def _switch_state(self, service: str, on: bool) -> None:
        self._call_service(SetBool, service, SetBool.Request(data=on))

    def _call_service(self, kind: Any, service: str, request: Any) -> Any:
        client = self._client.create_client(kind, service)
        self._wait_until(f"service {service}", client.service_is_ready)
        # Until then requests are refused: the emulator first looks whether it is the only one.
        self._wait_until("an active emulator", lambda: "emulator/status" in self._client.newest)
        answer = self._client.call_service(client, request, PATIENCE)
        assert answer is not None, f"no answer of {service} within {PATIENCE:g} s of wall time"
        self._client.destroy_client(client)
        return answer

    def _wait_until(self, event: str, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not self._client.spin_until(condition, 0.5):
            assert (ended := self._ended()) is None, f"{ended} ended, no {event}"
            assert time.monotonic() < deadline, f"no {event} within {PATIENCE:g} s of wall time"
