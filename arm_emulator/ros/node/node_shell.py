"""Common parts of the three nodes: QoS, time, diagnostics, and `main`."""

import contextlib
import re
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage

from arm_emulator.base.memory import is_out_of_memory
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.time_stamp import check_time
from arm_emulator.ros.node.barrier import Restart
from arm_emulator.ros.node.lean_executor import LeanExecutor
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.process.ctrl_c import CtrlC, ignore_signals, suppress_shutdown_errors
from arm_emulator.ros.process.end_with_parent import end_with_parent
from arm_emulator.workarounds.exit_watchdog import start_exit_watchdog
from arm_emulator.workarounds.fastdds_shared_memory import clear_left_over
from arm_emulator.workarounds.rclpy_internals import replace_clock_callback

# Commands: nothing is lost, and the newest counts. Receivers read all of them: with a depth of 1
# a bad command would displace a good one that is not read yet. States: a reliable publisher
# serves reliable and best-effort subscribers alike. Descriptions: late subscribers get the last
# one. Publishers keep messages that a reliable subscriber, such as a recorder, has not taken yet:
# a subscriber more than `QUEUE_DEPTH` behind loses messages without notice.
QUEUE_DEPTH = 1000  # messages: seconds of a busy machine, and ten times what an emulator runs ahead
COMMAND_QOS = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
COMMAND_SUB_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
STATE_PUB_QOS = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
STATE_SUB_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
# Answers to states, which come again if one is lost: acknowledgements would take a quarter of the
# processor time of a tick.
ANSWER_SUB_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
DESCRIPTION_QOS = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
# Changes by hand: late subscribers get the earlier ones, on which the later ones depend.
EVENT_QOS = QoSProfile(depth=QUEUE_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# A late subscriber learns at once which nodes run.
DIAGNOSTICS_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

NO_DESCRIPTION = "waiting for robot_description"  # diagnostics of a node that needs it first

ENDING = 5.0  # s, wall: time for the middleware to end


def guard_clock(node: Node, refuse: Callable[[str, Refusal], None]) -> None:
    """Refuse times on `clock` that rclpy's own subscription (`use_sim_time`) would fail at."""

    def take_clock(follow: Callable[[ClockMessage], None], message: ClockMessage) -> None:
        try:
            check_time("clock", message.clock)
        except Refusal as reason:
            refuse("clock", reason)
            return
        follow(message)

    replace_clock_callback(node, take_clock)


def create_wall_timer(node: Node, period: float, callback: Callable[[], None]) -> Timer:
    """Call back every `period` [s] of wall time, for any clock of the node."""
    return node.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


class Diagnostics:
    """The node's health as text, on `diagnostics`: every second, and at once when it changes.

    It is published in every state of a managed node.

    A message of which only figures have changed waits for its second.

    Refused input is counted by kind, and the newest refusal is published in full. Stamps are of the
    node's clock: wall time, or logical time with `use_sim_time`.

    Attributes:
        hardware_id: of what the node serves, without its namespace.
        values: more to publish, by name.
        duplicates: values and warnings while another node does the same.
        log: takes refusals, and what else the node reports; throttled.
        send: publishes; a node with its own record replaces it.
    """

    def __init__(self, node: Node, hardware_id: str) -> None:
        # Several arms may publish their health on one topic: names begin with the namespace.
        self._name = node.get_fully_qualified_name().strip("/")
        self._namespace = node.get_namespace().strip("/")
        self.hardware_id = hardware_id
        self._clock = node.get_clock()
        self.log = NodeLog(node.get_logger())
        self.publisher = node.create_publisher(DiagnosticArray, "diagnostics", DIAGNOSTICS_QOS)
        self.send: Callable[[DiagnosticArray], None] = self.publisher.publish
        self._refused: Counter[str] = Counter()
        self._newest_refusal = ""
        self._level, self._message = DiagnosticStatus.OK, "starting"
        self.values: dict[str, object] = {}
        self._node = node
        self.duplicates: dict[str, str] = {}
        guard_clock(node, self.refuse_input)
        if isinstance(node, ManagedNode):
            node.refuse, node.count = self.refuse_input, self.count_input
            node.note = self.values.__setitem__
        # With `use_sim_time` too: health is needed when logical time stands still.
        create_wall_timer(node, 1.0, self.publish_now)

    @property
    def refused(self) -> int:
        """Number of inputs refused so far."""
        return self._refused.total()

    def refuse_input(self, topic: str, reason: Refusal, times: int = 1) -> None:
        """Count and log a refused input, which came several times."""
        first = self._refused[topic] == 0
        self._refused[topic] += times
        self._newest_refusal = str(reason)
        self.log.warn_about(f"{topic}: {_strip_figures(reason.rule)}", f"refused: {reason}")
        if first:
            self.publish_now()

    def count_input(self, counter: str, times: int = 1) -> None:
        """Count under `counter` an input that was not needed, without a warning."""
        before = self.values.get(counter, 0)
        assert isinstance(before, int)
        self.values[counter] = before + times
        if not before:
            self.publish_now()

    def report_ok(self, message: str) -> None:
        """Report normal operation, and the present activity."""
        self._report_message(DiagnosticStatus.OK, message)

    def report_warning(self, message: str) -> None:
        """Report an impediment; the node continues."""
        self._report_message(DiagnosticStatus.WARN, message)

    def report_error(self, message: str) -> None:
        """Report the reason why the node's work stopped."""
        self._report_message(DiagnosticStatus.ERROR, message)

    def publish_now(self) -> None:
        """Publish now."""
        level = self._level
        if level == DiagnosticStatus.OK and (self._refused or self.duplicates):
            level = DiagnosticStatus.WARN
        values = {f"refused {topic}": count for topic, count in self._refused.items()}
        if self._newest_refusal:
            values["newest refusal"] = self._newest_refusal  # type: ignore[assignment]
        figures = self._node.figures if isinstance(self._node, ManagedNode) else {}
        status = DiagnosticStatus(
            level=level,
            name=self._name,
            message=self._message,
            hardware_id=f"{self._namespace}/{self.hardware_id}".lstrip("/"),
            values=[
                KeyValue(key=key, value=str(value))
                for key, value in {**values, **self.values, **figures, **self.duplicates}.items()
            ],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._clock.now().to_msg()
        self.send(array)

    def _report_message(self, level: bytes, message: str) -> None:
        changed = level != self._level or _strip_figures(message) != _strip_figures(self._message)
        self._level, self._message = level, message
        if changed:
            self.publish_now()


def _strip_figures(message: str) -> str:
    """Return a message without its figures."""
    return re.sub(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", message)


def _init_ros() -> None:
    clear_left_over()
    try:
        rclpy.init()
    except RuntimeError as error:  # rcl's, of the arguments after --ros-args
        actual = str(error).removeprefix("failed to initialize rcl: ")
        raise Refusal("command line", "the ROS arguments", "be well-formed", actual) from None


def _spin_node(node: ManagedNode) -> None:
    """Let a node work until a signal ends it."""
    while not CtrlC.signal:
        CtrlC.leave_to_rclpy()
        try:
            LeanExecutor(node).spin()
        except Restart:
            CtrlC.break_off_again()
            node.restart_lifecycle()


def run_node(create: Callable[[], ManagedNode]) -> None:
    """Run one node until it is stopped; exit code 2 and one line if its set-up is refused."""
    node: ManagedNode | None = None
    ctrl_c = CtrlC()
    end_with_parent()
    try:
        with ctrl_c, suppress_shutdown_errors():
            try:
                _init_ros()
                node = create()
                _spin_node(node)
            finally:
                # Another Ctrl-C, from the terminal beside the launcher's, must not break off the
                # ending.
                CtrlC.leave_to_rclpy()
    except (Refusal, ParameterException) as refusal:
        print(refusal, file=sys.stderr)
        sys.exit(2)
    except Exception as error:
        if not is_out_of_memory(error):
            raise
        print(Refusal("node", "memory", "suffice", repr(error)), file=sys.stderr)
        sys.exit(2)
    finally:
        code = 0 if sys.exc_info()[0] is None else 1
        node = node or ManagedNode.starting
        if node is not None:
            try:
                node.close()
            except Refusal as refusal:  # its outputs are incomplete
                print(refusal, file=sys.stderr)
                code = 1
        with start_exit_watchdog(ENDING, code):
            if node is not None:
                # Not left to the garbage collector: the middleware may leave its shared memory.
                node.destroy_node()
            with contextlib.suppress(RuntimeError):  # the signal's own shutdown may come between
                rclpy.try_shutdown()
        ignore_signals()
    if code:
        sys.exit(code)


PAUSE = 5.0  # s, wall: between two lines of one kind


@dataclass
class _Written:
    """The newest line of one kind."""

    at: float
    left_out: int = 0


class NodeLog:
    """Lines of several kinds; of each at most one every `PAUSE`.

    A line counts those that were left out before it.

    Args:
        logger: of the node.
        now: clock [s].
    """

    def __init__(self, logger: Any, now: Callable[[], float] = time.monotonic) -> None:
        self._logger, self._now = logger, now
        self._written: dict[str, _Written] = {}

    def warn_about(self, kind: str, line: str) -> None:
        """Log a warning of a kind."""
        if due := self._get_due_line(kind, line):
            self._logger.warning(due)

    def log_info(self, kind: str, line: str) -> None:
        """Log a regular outcome of a kind."""
        if due := self._get_due_line(kind, line):
            self._logger.info(due)

    def _get_due_line(self, kind: str, line: str) -> str:
        """Return the line as it is to be written, nothing if it is too early for it."""
        now, last = self._now(), self._written.get(kind)
        if last is not None and now - last.at < PAUSE:
            last.left_out += 1
            return ""
        more = f" (and {last.left_out} more before)" if last is not None and last.left_out else ""
        self._written[kind] = _Written(now)
        return line + more
