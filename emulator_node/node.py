"""ROS node `emulator`: wires a `Session` to topics, services and a clock."""

from __future__ import annotations

if __name__ == "__main__":  # before what takes long to import
    import os
    import sys

    # Nothing of the user's folder is imported, whatever its files are called.
    if sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
        sys.path[:] = [folder for folder in sys.path[1:] if folder != sys.path[0]]

    from arm_emulator.ros.ctrl_c import end_at_once

    end_at_once(0)

import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from arm_emulator.analysis.stability import explain
from arm_emulator.base.parameters import parameter
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.machine.loop_clock import real_time_session
from arm_emulator.machine.measured_fields import MeasuredFields
from arm_emulator.machine.outputs import reported_by_parts
from arm_emulator.machine.plant import Diverged
from arm_emulator.machine.scene import example_robot_data, load_scene
from arm_emulator.machine.session import CLOCKS, STARTS, EndOfTime, Needless, Phase, Session
from arm_emulator.ros.doubles import STARTED, Doubles
from arm_emulator.ros.fixed_layout import FixedLayout, taking
from arm_emulator.ros.node_shell import (
    COMMAND_SUB_QOS,
    DESCRIPTION_QOS,
    EVENT_QOS,
    KEPT,
    NANOSECONDS,
    STATE_PUB_QOS,
    Diagnostics,
    accept_changes,
    declare_parameters,
    nanoseconds_of,
    refuse_other_parameters,
    replaced,
    run_node,
    set_stamp,
    stamp,
    wall_timer,
)
from arm_emulator.ros.recorder_presence import recorders_of
from arm_emulator.ros.recorders import Recorders
from arm_emulator.view.rerun_stream import RerunStream
from arm_emulator_msgs.msg import (
    EmulatorStatus,
    MachineEvent,
    MotorCommand,
    MotorState,
    RecorderReport,
)
from arm_emulator_msgs.srv import RestoreState, SaveState, SetState, SetVaried

if TYPE_CHECKING:
    from arm_emulator.ros.run_record import RunRecord

AT_ONCE = 10  # ticks in real time that are taken, and messages that are published, at a time
UNPUBLISHED = 1000  # messages in real time that may wait: a controller needs the newest ones
STATUS_PERIOD = 0.5  # s, wall
MOST_SAVED = 1000  # states that are kept by name
REPEAT_AFTER = (
    0.2  # s, wall: a state without an answer is published again, for partners that come late
)


# Topics of what acts on links, and whose axes force and moment have.
EXTERNAL_WRENCHES = {"external_wrench": "link", "external_wrench_in_world": "world"}


@dataclass(frozen=True)
class EmulatorParameters:
    """Parameters of the node."""

    scene: str = parameter("three_axis", "scene file, or name of a scene that comes along")
    clock: str = parameter("lockstep", "who owns time", choices=CLOCKS)
    start: str = parameter(
        "free_run", "what the machine does until the first motor command", choices=STARTS
    )
    timeout: float = parameter(
        2.0,
        "wall time without an answer that is reported",
        unit="s",
        minimum=0.1,
        maximum=3600.0,
        settable=True,
    )
    report_period: float = parameter(
        0.01,
        "logical time between messages on emulator/joint_states and clock, 0 for every tick",
        unit="s",
        minimum=0.0,
        maximum=10.0,
    )
    record: str = parameter("", "new bag of what the emulator publishes and takes, none if empty")
    rerun_file: str = parameter("", "Rerun recording to write, none if empty")
    rerun_port: int = parameter(
        0, "local port where a Rerun viewer may connect, 0 for none", minimum=0, maximum=65535
    )


class EmulatorNode(Node):
    """The machine as a ROS node."""

    def __init__(self) -> None:
        super().__init__("emulator", automatically_declare_parameters_from_overrides=True)
        self._config = declare_parameters(self, EmulatorParameters)
        refuse_other_parameters(self, self._config)
        accept_changes(self, self._changed, self._take_parameters)
        scene = load_scene(self._config.scene)
        for line in scene.warnings:
            self.get_logger().warn(line)
        self._diagnostics = Diagnostics(self, scene.name)
        self._doubles = Doubles(
            self, self._diagnostics, "emulator", "motor_states", "the one started first rules"
        )
        self._doubles.wait_until_first("emulator/status")
        self._session = (
            real_time_session(scene, self._config.start)
            if self._config.clock == "realtime"
            else Session(scene, self._config.clock, self._config.start)
        )
        # Between the executor, which serves topics and services, and the thread that publishes
        # the ticks of a real-time session.
        self._lock = threading.RLock()
        self._shown = [one for one in reported_by_parts(scene) if not one.per_unit]
        robots = example_robot_data()
        self._stream = RerunStream(
            scene.urdf,
            scene.joint_names,
            q_start=scene.start,
            tool=scene.tool,
            package_dirs=[robots.parents[1]] if robots else [],
            file=self._config.rerun_file or None,
            port=self._config.rerun_port or None,
            further={one.name: one.unit for one in self._shown},
        )
        self._report_ticks = max(1, round(self._config.report_period / scene.servo_period))

        names = list(scene.joint_names)
        self._fields = MeasuredFields(scene, MotorState.get_fields_and_field_types())
        self._motor_state = FixedLayout(self._empty_motor_state())
        self._truth = JointState(name=names)
        self._motor_states = self.create_publisher(MotorState, "motor_states", STATE_PUB_QOS)
        self._truths = self.create_publisher(JointState, "emulator/joint_states", STATE_PUB_QOS)
        self._clocks = self.create_publisher(Clock, "clock", STATE_PUB_QOS)
        self._statuses = self.create_publisher(EmulatorStatus, "emulator/status", STATE_PUB_QOS)
        self._descriptions = self.create_publisher(String, "robot_description", DESCRIPTION_QOS)
        self._events = self.create_publisher(MachineEvent, "emulator/events", EVENT_QOS)
        self._changes = 0  # by hand
        self._saved: dict[str, bytes] = {}  # machines by name

        refuse = self._diagnostics.refuse
        take = taking("motor_commands", MotorCommand, self._on_command, refuse)
        self.create_subscription(MotorCommand, "motor_commands", take, COMMAND_SUB_QOS, raw=True)
        self.create_subscription(PoseStamped, "tool_target", self._on_tool_target, COMMAND_SUB_QOS)
        for topic, axes in EXTERNAL_WRENCHES.items():
            push = partial(self._on_external_wrench, topic, axes)
            self.create_subscription(WrenchStamped, topic, push, COMMAND_SUB_QOS)
        self._recorders = Recorders(partial(recorders_of, self._motor_states.topic_name))
        self._waited_for = ""  # the recorder that has to catch up before the machine goes on
        self.create_subscription(
            RecorderReport, "emulator/recorders", self._on_recorder, COMMAND_SUB_QOS
        )
        self._record: RunRecord | None = None
        self._unpublished: deque[tuple[Publisher, bytes]] = deque()  # of the publishing thread
        self._teller: threading.Thread | None = None
        self._too_late = 0  # messages that the publishing thread dropped for newer ones
        if self._config.record:
            self._begin_record(Path(self._config.record))
        self._publish(self._descriptions, String(data=scene.urdf))
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/power", self._on_power)
        self.create_service(SaveState, "~/save_state", self._on_save_state)
        self.create_service(RestoreState, "~/restore_state", self._on_restore_state)
        self.create_service(SetState, "~/set_state", self._on_set_state)
        self.create_service(SetVaried, "~/set_varied", self._on_set_varied)

        self._published_at = time.monotonic()  # when this tick's state was first published
        self._repeated_at = self._published_at
        self._reported: Diverged | EndOfTime | None = None  # the fault that was published last
        self._status_mark = (time.monotonic_ns(), 0, 0)
        wall_timer(self, REPEAT_AFTER, self._on_repeat)
        wall_timer(self, STATUS_PERIOD, self._on_status)
        self._tell()
        self.get_logger().info(
            f"scene {scene.name}: {len(names)} joints, {scene.integrator.scheme} at "
            f"{scene.integrator.dt:g} s, servo period {scene.servo_period:g} s, "
            f"clock {self._config.clock}"
        )
        self._closing = False
        if self._session.by_itself:
            self._teller = threading.Thread(
                target=self._tell_ticks, args=(self._session,), name="teller"
            )
            self._teller.start()
        else:
            self._pace = wall_timer(self, scene.servo_period, self._on_free_run)

    def _changed(self, changes: Mapping[str, Any]) -> EmulatorParameters:
        return replaced(self, self._config, changes)

    def _take_parameters(self, config: EmulatorParameters) -> None:
        self._config = config

    def close(self) -> None:
        """Stop the machine and finish the Rerun recording."""
        self._closing = True
        if self._teller is not None:
            self._teller.join()
        self._session.close()
        self._stream.close()
        if self._record is not None:
            self._record.close()

    # Time

    def _on_command(self, command: Any, data: bytes) -> None:
        with self._lock:
            if command.machine not in (0, STARTED):
                self._diagnostics.count("motor_commands for another emulator")
                return
            try:
                self._session.offer(command.tick, command.joint_names, command.voltage)
            except Needless as reason:
                self._diagnostics.count(f"motor_commands {reason.kind}")
                return
            except Refusal as reason:
                self._diagnostics.refuse("motor_commands", reason)
                return
            if self._record is not None:
                self._record.put(self._commands, data)
            if self._session.lockstep:
                self._go_on()

    def _go_on(self) -> None:
        """Leave this tick in lock-step if that is allowed, and every recorder has kept up."""
        if self._session.may_advance and not self._recorder_behind():
            self._advance()

    def _recorder_behind(self) -> bool:
        session, recorders = self._session, self._recorders
        self._waited_for = ""
        if session.lockstep:
            self._waited_for = recorders.behind(session.tick == 0, time.monotonic())
        for sentence in recorders.news:
            self.get_logger().warn(sentence)
            self._diagnostics.values["newest of recorders"] = sentence
        recorders.news.clear()
        return bool(self._waited_for)

    def _on_recorder(self, report: RecorderReport) -> None:
        with self._lock:
            try:
                self._recorders.report(report.recorder, report.written, report.leaving)
            except Refusal as reason:
                self._diagnostics.refuse("emulator/recorders", reason)
                return
            self._diagnostics.values["recorders"] = len(self._recorders.names)
            if self._waited_for and self._session.answered:
                self._go_on()

    def _on_free_run(self) -> None:
        """Pace the free run of lock-step; who waits needs no pace, `_on_repeat` begins it anew."""
        with self._lock:
            if self._session.phase is Phase.FREE_RUNNING:
                self._go_on()
            else:
                self._pace.cancel()

    def _tell_ticks(self, session: Session) -> None:
        """Publish the ticks of real time as they come, in a thread of its own."""
        while not self._closing and rclpy.ok():
            if session.wait(timeout=0.1):
                try:
                    while self._catch_up(session) and not self._closing:
                        pass
                except RuntimeError:  # of rclpy, when a signal has ended it in between
                    if rclpy.ok():
                        raise

    def _catch_up(self, session: Session) -> bool:
        """Take some ticks, publish some of what waits; return whether there is more of either.

        On a machine that is too slow there is always more: topics and services come in between.
        """
        with self._lock:
            taken = 0
            while taken < AT_ONCE and self._take(session):
                taken += 1
            self._report_fault()
            for _ in range(min(AT_ONCE, len(self._unpublished))):
                publisher, data = self._unpublished.popleft()
                publisher.publish(data)
            return taken == AT_ONCE or bool(self._unpublished)

    def _take(self, session: Session) -> bool:
        """Take a tick and tell its state; False if there is none."""
        if not session.take():
            return False
        if session.fault is None:  # else it has not come to another tick
            self._tell()
        return True

    def _advance(self) -> None:
        self._session.advance()
        if self._session.fault is None:
            self._tell()
        self._report_fault()

    def _report_fault(self) -> None:
        fault = self._session.fault
        if fault is not None and fault is not self._reported:
            self._reported = fault
            explain(fault)
            self._diagnostics.error(str(fault))
            self.get_logger().error(str(fault))

    # Publishing

    def _begin_record(self, folder: Path) -> None:
        # Imported only when needed: a stock ROS 2 machine may have no package for bags.
        from arm_emulator.ros.bag import Topic
        from arm_emulator.ros.message_types import definition_of
        from arm_emulator.ros.run_record import RunRecord

        said = (
            self._motor_states, self._truths, self._clocks, self._statuses, self._descriptions,
            self._events, self._diagnostics.publisher,
        )  # fmt: skip
        publishers = [
            (one.topic_name, self.get_publishers_info_by_topic(one.topic_name)) for one in said
        ]
        self._commands = self.resolve_topic_name("motor_commands")
        taken = (self._commands, self.get_subscriptions_info_by_topic(self._commands))
        topics = []
        for name, known in (*publishers, taken):
            kind, offered = known[0].topic_type, tuple(one.qos_profile for one in known)
            kind_hash = str(known[0].topic_type_hash)
            topics.append(Topic(name, kind, definition_of(kind), offered, kind_hash))
        self._record = RunRecord(folder, topics, self._session.lockstep)
        self._diagnostics.send = partial(self._publish, self._diagnostics.publisher)

    def _publish(self, publisher: Publisher, message: Any) -> None:
        """Publish a message, or the bytes of one, and write it into the emulator's own record."""
        if self._record is None and self._teller is None:
            publisher.publish(message)
            return
        data = message if isinstance(message, bytes) else serialize_message(message)
        if self._record is not None:
            self._record.put(publisher.topic_name, data)
        if threading.current_thread() is not self._teller:
            publisher.publish(data)
            return
        # The next ticks are taken and written first: to publish takes longer.
        if len(self._unpublished) >= UNPUBLISHED:
            self._unpublished.popleft()
            self._too_late += 1
            self._diagnostics.values["messages too late to publish"] = self._too_late
        self._unpublished.append((publisher, data))

    def _tell(self) -> None:
        """Publish this tick's state."""
        self._published_at = self._repeated_at = time.monotonic()
        session = self._session
        self._say_motor_state()
        if session.tick % self._report_ticks == 0:
            self._say_truth()
            self._newest_time = Clock(clock=stamp(session.logical_ns))
            self._publish(self._clocks, self._newest_time)
        self._show()

    def _tell_change(self) -> None:
        """Tell this tick's state once more, as it is after a change by hand."""
        self._repeated_at = time.monotonic()
        self._say_motor_state()
        self._say_truth()
        self._show()

    def _show(self) -> None:
        if not self._stream.open:
            return
        session, state = self._session, self._session.state
        self._stream.offer(
            session.logical_ns,
            state.q,
            state.v,
            state.gear_torque,
            state.current,
            session.voltage,
            (state.encoder_counts + 0.5) * session.plant.link_angle_per_count,
            [getattr(session.measured, one.name) for one in self._shown],
        )

    def _say_truth(self) -> None:
        state, truth = self._session.state, self._truth
        truth.header.stamp = stamp(self._session.logical_ns)
        truth.position = array("d", state.q.tobytes())
        truth.velocity = array("d", state.v.tobytes())
        truth.effort = array("d", state.gear_torque.tobytes())
        self._publish(self._truths, truth)

    def _empty_motor_state(self) -> MotorState:
        """Return a motor state with all its names and lengths."""
        scene, measured = self._session.scene, self._session.measured
        message = MotorState(
            joint_names=list(scene.joint_names),
            machine=STARTED,
            imu_names=[one.name for one in scene.imus],
            voltage=array("d", bytes(8 * len(scene.joints))),
        )
        self._fields.begin(message, measured)
        return message

    def _say_motor_state(self) -> None:
        session, message = self._session, self._motor_state.message
        set_stamp(message.header.stamp, session.logical_ns)
        message.tick = session.tick
        message.powered = session.powered
        message.voltage[:] = session.voltage
        self._fields.fill(message, session.measured)
        self._recorders.published += 1
        if self._record is not None:
            self._record.count(session.tick)
        self._publish(self._motor_states, self._motor_state.data())

    def _on_repeat(self) -> None:
        """Publish an unanswered state again; report a partner that stays silent."""
        with self._lock:
            self._repeat()
            if self._session.lockstep and self._pace.is_canceled():
                if self._session.phase is Phase.FREE_RUNNING:
                    self._pace.reset()

    def _repeat(self) -> None:
        session, now = self._session, time.monotonic()
        unanswered = session.phase in (Phase.WAITING, Phase.PAUSED) and not session.answered
        if session.lockstep and (self._waited_for or session.tick == 0):
            # A recorder may have ended meanwhile, or have come to a machine that is paused.
            if self._recorder_behind():
                unanswered = unanswered or session.tick == 0  # it may not have this state yet
            elif session.answered:
                self._go_on()
        if unanswered and now - self._repeated_at >= REPEAT_AFTER and not self._without_room():
            self._repeated_at = now
            self._say_motor_state()
            if session.tick == 0:
                self._say_truth()
        self._say_health(waited=now - self._published_at)

    def _without_room(self) -> str:
        """Return the recorder that would lose one more motor state, empty if none would."""
        return self._recorders.without_room(KEPT) if self._session.lockstep else ""

    def _say_health(self, waited: float) -> None:
        session, say = self._session, self._diagnostics
        if session.phase is Phase.STOPPED:
            say.error(str(session.fault))
        elif session.phase is Phase.PAUSED:
            say.ok(f"paused at tick {session.tick}")
        elif session.phase is Phase.FREE_RUNNING:
            say.warn("no motor command yet, running free at 0 V")
        elif session.phase is Phase.WAITING and waited > self._config.timeout:
            # In whole seconds, so that the words change, and are published, once a second.
            say.warn(
                f"waiting for the motor command that answers tick {session.tick}, "
                f"for {waited:.0f} s"
            )
        elif self._waited_for and waited > self._config.timeout:
            say.warn(
                f"waiting for recorder {self._waited_for} to write what led to tick "
                f"{session.tick}, for {waited:.0f} s"
            )
        elif self._record is not None and self._record.trouble:
            say.warn(f"the record is not complete: {self._record.trouble}")
        elif not session.powered:
            say.warn("the drives' power is off, motors at 0 V")
        else:
            say.ok("running")

    def _on_tool_target(self, target: PoseStamped) -> None:
        """Show the target beside the arm; the machine itself knows nothing of it."""
        p = target.pose.position
        self._stream.offer_target(nanoseconds_of(target.header.stamp), (p.x, p.y, p.z))

    def _on_external_wrench(self, topic: str, axes: str, message: WrenchStamped) -> None:
        """Let a wrench act from this tick on, at the origin of the link that it names."""
        f, n = message.wrench.force, message.wrench.torque
        wrench = ExternalWrench((f.x, f.y, f.z), (n.x, n.y, n.z), axes=axes)
        with self._lock:
            session, link = self._session, message.header.frame_id
            try:
                if session.acts_already(link, wrench):
                    return
                if behind := self._without_room():
                    rule = f"come when recorder {behind} has caught up"
                    raise Refusal(topic, "message", rule, f"at tick {session.tick}")
                push = partial(session.set_external_wrench, link, wrench)
                self._by_hand(MachineEvent.KIND_EXTERNAL_WRENCH, push)
            except Refusal as reason:
                self._diagnostics.refuse(topic, reason)

    def _on_status(self) -> None:
        with self._lock:
            self._say_status()
            if time.monotonic() - self._published_at >= STATUS_PERIOD:
                # Read with best effort: who lost the newest time, or came after it, has it now.
                self._clocks.publish(self._newest_time)

    def _say_status(self) -> None:
        session = self._session
        now = time.monotonic_ns()
        since, ticks, core_ns = self._status_mark
        new_ticks = max(0, session.tick - ticks)
        steps = new_ticks * session.scene.steps_per_period
        self._status_mark = (now, session.tick, session.step_wall_ns)
        # In lock-step every tick waits a moment for its answer; a machine that goes on is running.
        phase = Phase.RUNNING if session.phase is Phase.WAITING and new_ticks else session.phase
        status = EmulatorStatus(
            tick=session.tick,
            phase=int(phase),
            answered=session.answered,
            powered=session.powered,
            logical_time=session.logical_ns / NANOSECONDS,
            real_time_factor=new_ticks * session.period_ns / (now - since),
            step_time=max(0, session.step_wall_ns - core_ns) / steps if steps else 0.0,
            energy=session.energy,
            commands_refused=self._diagnostics.refused,
            samples_dropped=self._stream.dropped,
            waiting_time=time.monotonic() - self._published_at if phase is Phase.WAITING else 0.0,
        )
        status.header.stamp = stamp(session.logical_ns)
        if session.by_itself:
            figures = session.figures
            status.overruns = figures.lost_periods
            status.old_commands = figures.old_commands
            status.worst_lateness = figures.worst_lateness / NANOSECONDS
            status.median_lateness = figures.median_lateness / NANOSECONDS
            status.p99_lateness = figures.p99_lateness / NANOSECONDS
            status.real_time_priority = bool(figures.fifo)
            status.memory_locked = bool(figures.locked)
        self._publish(self._statuses, status)

    # Services

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            session = self._session
            session.paused = request.data
            if request.data:
                self._tell_reached()
            response.success = True
            response.message = f"{'paused' if request.data else 'going on'} at tick {session.tick}"
            if session.lockstep and session.answered:
                self._go_on()
            return response

    def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            response.message = self._step()
            response.success = not response.message
            if response.success:
                self._tell()
                response.message = f"at tick {self._session.tick}"
            self._report_fault()
            return response

    def _step(self) -> str:
        if self._session.paused:
            at_start = self._session.tick == 0 and self._recorder_behind()
            behind = self._waited_for if at_start else self._without_room()
            if behind:
                return f"recorder {behind} has to catch up first, step again then"
        return self._session.step()

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._by_hand(MachineEvent.KIND_RESET, self._session.reset)
            self._recorders.begin()
            self._status_mark = (time.monotonic_ns(), 0, 0)
            self._diagnostics.ok("reset")
            self._tell()
            response.success, response.message = True, "at tick 0"
            return response

    def _on_power(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            switch = partial(setattr, self._session, "powered", request.data)
            self._by_hand(MachineEvent.KIND_POWER, switch)
        response.success = True
        response.message = (
            "power on" if request.data else "power off: motors at 0 V, windings shorted"
        )
        return response

    def _on_save_state(
        self, request: SaveState.Request, response: SaveState.Response
    ) -> SaveState.Response:
        with self._lock, self._session.between_ticks():
            self._tell_reached()
            if len(self._saved) >= MOST_SAVED and request.name not in {"", *self._saved}:
                rule = f"be one of the {MOST_SAVED} that are kept already"
                response.message = str(Refusal("save_state", "name", rule, request.name))
                return response
            saved = self._session.plant.save()
            if request.name:
                self._saved[request.name] = saved
            response.success, response.state = True, array("B", saved)
            response.message = f"at tick {self._session.tick}"
            return response

    def _on_restore_state(
        self, request: RestoreState.Request, response: RestoreState.Response
    ) -> RestoreState.Response:
        def restore() -> None:
            if bool(request.name) == bool(request.state):
                got = "both" if request.name else "neither"
                raise Refusal("restore_state", "what is restored", "be a name or a state", got)
            if request.name and request.name not in self._saved:
                known = ", ".join(self._saved) or "none"
                raise Refusal("restore_state", "name", "be a saved one", request.name, known)
            self._session.restore(self._saved.get(request.name, bytes(request.state)))

        self._put(MachineEvent.KIND_RESTORE, restore, response)
        return response

    def _on_set_state(
        self, request: SetState.Request, response: SetState.Response
    ) -> SetState.Response:
        given = {
            "current": request.current,
            "theta_m": request.motor_position,
            "omega_m": request.motor_velocity,
            "q": request.position,
            "v": request.velocity,
        }
        change = partial(self._session.set_state, request.joint_names, given)
        self._put(MachineEvent.KIND_SET_STATE, change, response)
        return response

    def _on_set_varied(
        self, request: SetVaried.Request, response: SetVaried.Response
    ) -> SetVaried.Response:
        change = partial(self._session.set_varied, request.name, request.value)
        self._put(MachineEvent.KIND_SET_VARIED, change, response)
        return response

    def _put(
        self,
        kind: int,
        change: Callable[[], None],
        response: RestoreState.Response | SetState.Response | SetVaried.Response,
    ) -> None:
        """Change the machine, publish its state as it is now, and go on from there."""
        with self._lock:
            behind = self._without_room()
            if behind:
                response.message = f"recorder {behind} has to catch up first, ask again then"
                return
            try:
                self._by_hand(kind, change)
            except Refusal as reason:
                response.message = str(reason)
                return
            session = self._session
            response.success, response.message = True, f"at tick {session.tick}"
            self._tell_change()
            if session.lockstep and session.answered:
                self._go_on()

    def _by_hand(self, kind: int, change: Callable[[], None]) -> None:
        """Change the machine between two ticks, and publish what is needed to repeat that."""
        session = self._session
        with session.between_ticks():
            self._tell_reached()
            change()
            saved = session.plant.save()
        self._changes += 1
        event = MachineEvent(
            tick=session.tick,
            number=self._changes,
            kind=kind,
            powered=session.powered,
            state=array("B", saved),
            machine=STARTED,
        )
        event.header.stamp = stamp(session.logical_ns)
        self._publish(self._events, event)

    def _tell_reached(self) -> None:
        """Publish all that waits, and tell the ticks that a loop in real time has reached.

        In order, so that a change comes behind the ticks before it. The loop must stand still.
        """
        while self._unpublished:
            publisher, data = self._unpublished.popleft()
            publisher.publish(data)
        if self._session.by_itself:
            while self._take(self._session):
                pass
        self._report_fault()


def main() -> None:
    """Entry point of `ros2 run arm_emulator emulator_node`."""
    run_node(EmulatorNode)


if __name__ == "__main__":
    main()
