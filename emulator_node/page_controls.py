"""Actions of a page on the network, by the services and topics that anybody has."""

import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool, Trigger

from arm_emulator.base.refusal import Refusal
from arm_emulator.page.controls import Controls, News, Vector
from arm_emulator.ros.messages.event_words import describe_change, describe_motion
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator.ros.node.barrier import guard_callback
from arm_emulator.ros.node.node_parameters import SETTABLE
from arm_emulator.ros.node.node_shell import EVENT_QOS, STATE_SUB_QOS
from arm_emulator_msgs.msg import EmulatorStatus, MachineEvent, MotionStatus
from arm_emulator_msgs.srv import BreakWhen, RestoreState, SaveState, SetVaried

PATIENCE = 5.0  # s, wall: for an answer
ASK_AGAIN = 1.0  # s, wall, after which a node that is to be met is asked once more
PHASES = ("running free", "waiting", "running", "paused", "stopped")


class RosControls(Controls):
    """A node that calls services and publishes topics.

    Args:
        namespace: of all nodes.
        period: servo period [s].
        lockstep: whether time follows answers, and may be slowed down.
        factor: of the pace, as it is now.
    """

    def __init__(self, namespace: str, period: float, lockstep: bool, factor: float = 0.0) -> None:
        self.factor = factor
        rclpy.init(args=[], domain_id=None, signal_handler_options=rclpy.SignalHandlerOptions.NO)
        self._node = node = rclpy.create_node("page", namespace=namespace)
        self._period, self._lock, self._news = period, threading.Lock(), News()
        self._lockstep = lockstep
        self._refusals: dict[str, str] = {}
        self._phase = -1
        self._clients: dict[str, Any] = {}
        self._met: set[str] = set()  # services whose nodes know the client
        self._targets = node.create_publisher(PoseStamped, "tool_target", 1)
        self._pushes = node.create_publisher(WrenchStamped, "external_wrench_in_world", 1)
        for kind, topic, callback, qos in (
            (EmulatorStatus, "emulator/status", self._handle_status, STATE_SUB_QOS),
            (MachineEvent, "emulator/events", self._handle_event, EVENT_QOS),
            (MotionStatus, "motion/status", self._handle_motion, EVENT_QOS),
            (DiagnosticArray, "diagnostics", self._handle_diagnostics, 10),
        ):
            node.create_subscription(kind, topic, guard_callback(self, topic, callback), qos)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._executor.spin, name="hands", daemon=True)
        self._thread.start()

    @property
    def context(self) -> Context:
        """See `Guarded`."""
        return self._node.context

    def get_logger(self) -> Any:
        """See `Guarded`."""
        return self._node.get_logger()

    def refuse(self, where: str, reason: Refusal, times: int = 1) -> None:
        """Log a message that cannot be shown; anyone can publish on these topics."""
        self._node.get_logger().warning(f"{where}: refused: {reason}", throttle_duration_sec=5.0)

    def can(self) -> frozenset[str]:
        """Return all, without the rate in real time, which passes by the clock."""
        return super().can() - (frozenset() if self._lockstep else {"rate"})

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.try_shutdown()

    # News

    def news(self) -> News:
        """Return what has happened since the last call."""
        with self._lock:
            news, self._news = self._news, News()
        return news

    def _add_event(self, tick: int, text: str) -> None:
        with self._lock:
            self._news.events.append((tick, text))

    def _handle_status(self, status: EmulatorStatus) -> None:
        power = "" if status.powered else ", **no power**"
        with self._lock:
            self._news.state = PHASES[status.phase] + power
            self._news.paused = status.phase == EmulatorStatus.PHASE_PAUSED
            self._news.powered = status.powered
        if status.phase != self._phase:
            if status.phase == EmulatorStatus.PHASE_STOPPED:
                self._add_event(status.tick, "stopped: the motion diverged")
            self._phase = status.phase

    def _handle_event(self, event: MachineEvent) -> None:
        self._add_event(event.tick, describe_change(event.kind, event.powered))

    def _handle_motion(self, status: MotionStatus) -> None:
        self._add_event(self._tick_at(status.header.stamp), describe_motion(status))

    def _handle_diagnostics(self, message: DiagnosticArray) -> None:
        for diagnostic in message.status:
            for pair in diagnostic.values:
                if pair.key == "newest breakpoint" and self._refusals.get(pair.key) != pair.value:
                    self._refusals[pair.key] = pair.value
                    tick, _, why = pair.value.removeprefix("stopped at tick ").partition(": ")
                    self._add_event(int(tick), f"stopped: {why}")
                if (
                    pair.key == "newest refusal"
                    and self._refusals.get(diagnostic.name) != pair.value
                ):
                    self._refusals[diagnostic.name] = pair.value
                    tick = self._tick_at(message.header.stamp)
                    self._add_event(tick, f"{diagnostic.name} refused: {pair.value}")

    def _tick_at(self, stamp: Time) -> int:
        return round(1e-9 * convert_to_nanoseconds(stamp) / self._period)

    # Actions

    def pause(self, on: bool) -> str:
        """Let time stand still, or go on."""
        return self._request_service("emulator/pause", SetBool, SetBool.Request(data=on))

    def step(self, ticks: int) -> str:
        """Let so many servo periods pass, each of which needs its command in lock-step."""
        answer = ""
        for _ in range(ticks):
            answer = self._call_patiently(
                lambda: self._request_service("emulator/step", Trigger, Trigger.Request())
            )
        return answer

    def rate(self, factor: float) -> str:
        """Let logical time pass so fast, 1 being real time; 0: as fast as possible."""
        self._set_parameter("emulator", "real_time_factor", factor)
        return f"{factor:g} times real time" if factor else "as fast as possible"

    def reset(self) -> str:
        """Reset emulator, servo and motion controller to tick 0."""
        answer = self._request_service("emulator/reset", Trigger, Trigger.Request())
        for name in ("servo/reset", "motion_controller/reset"):
            if self._get_client(name, Trigger).service_is_ready():
                self._request_service(name, Trigger, Trigger.Request())
        return answer

    def power(self, on: bool) -> str:
        """Switch the drives' power."""
        return self._request_service("emulator/power", SetBool, SetBool.Request(data=on))

    def set_varied(self, name: str, value: float) -> str:
        """Set a number that the scene lists as varied."""
        request = SetVaried.Request(name=name, value=value)
        return f"{name} = {value:g} " + self._request_service(
            "emulator/set_varied", SetVaried, request
        )

    def push(self, link: str, force: Vector, moment: Vector) -> str:
        """Let a force and a moment act on a link from now on."""
        message = WrenchStamped()
        message.header.frame_id = link
        f, n = message.wrench.force, message.wrench.torque
        f.x, f.y, f.z = force
        n.x, n.y, n.z = moment
        self._pushes.publish(message)
        return f"{link} is pushed with {_format_vector(force)} N, {_format_vector(moment)} N m"

    def aim(self, p_WT: Vector, wxyz: tuple[float, float, float, float]) -> str:
        """Send the tool to a place and an orientation."""
        message = PoseStamped()
        p, turned = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = p_WT
        turned.w, turned.x, turned.y, turned.z = wxyz
        self._targets.publish(message)
        return f"the tool is sent to {_format_vector(p_WT)} m"

    def save(self, name: str) -> str:
        """Keep the whole machine under a name."""
        request = SaveState.Request(name=name)
        return f"{name} kept, " + self._request_service("emulator/save_state", SaveState, request)

    def restore(self, name: str) -> str:
        """Go on from a machine that was kept."""
        request = RestoreState.Request(name=name)
        return f"{name} restored, " + self._request_service(
            "emulator/restore_state", RestoreState, request
        )

    def gains(self) -> dict[str, float]:
        """Return the numbers of the servo's joints that can be changed."""
        request = ListParameters.Request(prefixes=["joints"])
        listed = self._call_service("servo/list_parameters", ListParameters, request)
        names = list(listed.result.names)
        request = GetParameters.Request(names=names)
        values = self._call_service("servo/get_parameters", GetParameters, request).values
        describe = DescribeParameters.Request(names=names)
        about = self._call_service(
            "servo/describe_parameters", DescribeParameters, describe
        ).descriptors
        return {
            name: value.double_value
            for name, value, descriptor in zip(names, values, about, strict=True)
            if value.type == ParameterType.PARAMETER_DOUBLE
            and SETTABLE in descriptor.additional_constraints
        }

    def set_gain(self, name: str, value: float) -> str:
        """Change one of them."""
        self._set_parameter("servo", name, value)
        return f"{name} = {value:g}"

    def break_when(self, condition: str) -> str:
        """Let time stand still as soon as a condition holds."""
        request = BreakWhen.Request(condition=condition)
        answer = self._request_service("emulator/break_when", BreakWhen, request)
        return f"stops where {condition}, set {answer}" if condition else "stops nowhere"

    def _set_parameter(self, node: str, name: str, value: float) -> None:
        """Set a parameter.

        Raises:
            Refusal: the node does not take it.
        """
        kind = ParameterType.PARAMETER_DOUBLE
        parameter = Parameter(name=name, value=ParameterValue(type=kind, double_value=value))
        request = SetParametersAtomically.Request(parameters=[parameter])
        service = f"{node}/set_parameters_atomically"
        result = self._call_service(service, SetParametersAtomically, request).result
        if not result.successful:
            raise Refusal("page", name, f"be taken by the {node}", value, result.reason)

    def _get_client(self, name: str, kind: Any) -> Any:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
        return self._clients[name]

    def _wait_for_discovery(self, node: str) -> None:
        """Wait until a node knows all clients made so far: else it may lose its answers to them."""
        client = self._node.create_client(GetParameters, f"{node}/get_parameters")
        until, met = time.monotonic() + PATIENCE, threading.Event()
        while not met.is_set() and time.monotonic() < until:
            if client.wait_for_service(timeout_sec=ASK_AGAIN):
                client.call_async(GetParameters.Request()).add_done_callback(lambda _: met.set())
                met.wait(ASK_AGAIN)
        self._node.destroy_client(client)

    def _call_service(self, name: str, kind: Any, request: Any) -> Any:
        """Return what a service answers.

        Raises:
            Refusal: it does not answer.
        """
        client, done = self._get_client(name, kind), threading.Event()
        if not client.wait_for_service(timeout_sec=PATIENCE):
            raise Refusal("page", f"service {name}", "be there", "no answer")
        if name not in self._met:
            self._wait_for_discovery(name.rpartition("/")[0])
            self._met.add(name)
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        if not done.wait(PATIENCE):
            raise Refusal("page", f"service {name}", f"answer within {PATIENCE:g} s", "no answer")
        return future.result()

    def _request_service(self, name: str, kind: Any, request: Any) -> str:
        """Return the message of a service that has succeeded.

        Raises:
            Refusal: it has not.
        """
        answer = self._call_service(name, kind, request)
        if not answer.success:
            raise Refusal(name, "request", "be possible now", answer.message)
        return str(answer.message)

    def _call_patiently(self, call: Callable[[], str]) -> str:
        """Call again while the command that answers the tick is under way."""
        for _ in range(100):
            try:
                return call()
            except Refusal as no:
                if "no motor command answers" not in str(no):
                    raise
                threading.Event().wait(0.01)
        return call()


def _format_vector(vector: Vector) -> str:
    return ", ".join(f"{component:.4g}" for component in vector)
