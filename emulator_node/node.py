"""ROS node `emulator`: wires a `Session` to topics, services and a clock."""

if __name__ == "__main__":  # before slow imports
    import os
    import sys

    # Nothing is imported from the working folder, which -P leaves out by itself.
    if not sys.flags.safe_path and sys.path[0] != os.path.dirname(os.path.dirname(__file__)):
        sys.path[:] = [folder for folder in sys.path[1:] if folder != sys.path[0]]

    from arm_emulator.base.required_package import refuse_missing_modules
    from arm_emulator.ros.process.ctrl_c import end_at_once

    end_at_once(0)
    refuse_missing_modules("emulator")

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.publisher import Publisher

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.address import LOCAL
from arm_emulator.base.validation.parameters import parameter
from arm_emulator.machine.plant.build_facts import build_facts
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.session.pace import LARGEST, SMALLEST, Pace
from arm_emulator.machine.session.real_time import open_real_time_session
from arm_emulator.machine.session.session import CLOCKS, STARTS, Session
from arm_emulator.page.page_process import PageProcess
from arm_emulator.ros.node.duplicate_nodes import DuplicateNodes
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_parameters import (
    accept_changes,
    declare_parameters,
    refuse_unknown_parameters,
    replace_parameters,
)
from arm_emulator.ros.node.node_shell import Diagnostics, create_wall_timer, run_node
from arm_emulator.ros.process.ctrl_c import CtrlC
from arm_emulator.ros.process.priority import raise_priority
from arm_emulator.ros.recording.recorder_presence import list_recorders
from emulator_node.answered_ticks import AnsweredTicks
from emulator_node.breakpoints import Breakpoints
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.health import Health, Status
from emulator_node.outgoing_messages import (
    OutgoingMessages,
    create_record,
    subscribe_to_others,
    take_rest,
)
from emulator_node.pacer import REPEAT_AFTER, LockstepPacer, LoopPacer, Pacer, Retransmitter
from emulator_node.real_time_ticks import READERS, RealTimeCommands
from emulator_node.recorder_gate import RecorderGate
from emulator_node.reports import Reports
from emulator_node.services import Services
from emulator_node.simulation_services import SimulationServices, is_installed
from emulator_node.subscriptions import Subscriptions
from emulator_node.time_control import TickStepper, TimeControl
from emulator_node.view import MachineView

STATUS_PERIOD = 0.5  # s, wall


@dataclass(frozen=True)
class EmulatorParameters:
    """Parameters of the node."""

    scene: str = parameter("three_axis", "scene file, or name of a shipped scene")
    clock: str = parameter(
        "lockstep",
        "lockstep: each tick waits for its command; realtime: ticks follow the wall clock",
        choices=CLOCKS,
    )
    start: str = parameter("free_run", "behaviour until the first motor command", choices=STARTS)
    timeout: float = parameter(
        2.0,
        "wall time without a command after which diagnostics report it",
        unit="s",
        ends=(0.1, 3600.0),
        settable=True,
    )
    real_time_factor: float = parameter(
        1.0,
        f"in lock-step: logical time per wall time, at most, {SMALLEST:g} and more; "
        "0: as fast as possible",
        ends=(0.0, LARGEST),
        settable=True,
    )
    alone: bool = parameter(
        False, "whether to end where another emulator was started before, not to wait in silence"
    )
    report_period: float = parameter(
        0.01,
        "logical time between messages on emulator/joint_states and clock; 0: every tick",
        unit="s",
        ends=(0.0, 10.0),
    )
    record: str = parameter("", "folder of a new bag of the emulator's messages")
    rerun_file: str = parameter("", "Rerun recording to write")
    rerun_port: int = parameter(0, "local port for a Rerun viewer; 0: none", ends=(0, 65535))
    page_port: int = parameter(
        -1, "port of a page in the browser; 0: any that is free, -1: no page", ends=(-1, 65535)
    )
    page_host: str = parameter(LOCAL, "address of this machine at which the page is served")


class EmulatorNode(ManagedNode):
    """The machine as a ROS node: creates its objects, and ends them."""

    def __init__(self) -> None:
        super().__init__("emulator")
        self._config = declare_parameters(self, EmulatorParameters)
        refuse_unknown_parameters(self, self._config)
        accept_changes(self, self._check_changes, self._take_parameters)
        self._diagnostics = Diagnostics(self, "machine")
        self._duplicate_nodes = DuplicateNodes(
            self, self._diagnostics, "emulator", "motor_states", "the one started first rules"
        )
        self.start_lifecycle()

    def create_entities(self) -> None:
        """Create the machine, which stands, and its topics and services."""
        config = self._config
        check_pace(config)
        outgoing = OutgoingMessages()
        self.cleanup.callback(outgoing.close)
        diagnostics = self._diagnostics
        self._session = session = self._open_session()
        scene = session.scene
        page = self._open_page(session)
        self.cleanup.callback(page.close)
        view = MachineView(session, config.rerun_file, config.rerun_port)
        self.cleanup.callback(view.close)
        self.cleanup.callback(session.close)
        recorders = partial(list_recorders, self.resolve_topic_name("motor_states"))
        gate = RecorderGate(recorders, session.lockstep, self._report_recorder)
        pace = Pace(scene.servo_period)
        pace.factor = config.real_time_factor
        self._own = own = Context(self, session, diagnostics, gate, outgoing, view, pace)
        self._reports = reports = Reports(own, config.report_period)
        self._status = status = Status(own, reports)
        health = Health(own, lambda: self._config.timeout, lambda: page.trouble)
        breaks = Breakpoints(own, lambda: self._pacer.catch_up())  # noqa: PLW0108 - it is made below
        loop = LoopPacer(own, reports, health, breaks) if session.is_self_clocked else None
        self._pacer: Pacer = loop or LockstepPacer(own, reports, health, breaks)
        self.cleanup.callback(self._pacer.close)
        changes = Changes(session, self._pacer, reports, page, breaks)
        subscriptions = Subscriptions(own, self._pacer, changes, breaks)
        if config.record:
            publishers = [*reports.publishers, status.publisher, diagnostics.publisher]
            self._begin_record(outgoing, publishers, subscriptions.commands.topic_name)
        self.hot = (
            RealTimeCommands(own, loop.ticks, subscriptions.commands)
            if loop
            else AnsweredTicks(own, subscriptions.commands, reports, health, breaks)
        )
        control = TimeControl(own, changes, health, status)
        Services(own, control, changes, breaks)
        if is_installed():
            stepper = TickStepper(own, control)
            subscriptions.answered = stepper.go_on
            SimulationServices(self, own, changes, control, stepper)
            self.housekeeping = 0.02  # s, wall: bounds the delay of steps and actions
        self._repeater = Retransmitter(own, self._pacer, reports, health)
        create_wall_timer(self, REPEAT_AFTER, self._handle_repeat)
        create_wall_timer(self, STATUS_PERIOD, self._handle_status)
        self.get_logger().info(
            f"scene {scene.name}: {len(scene.joints)} joints, {scene.integrator.scheme} at "
            f"{scene.integrator.dt:g} s, servo period {scene.servo_period:g} s, "
            f"clock {config.clock}"
        )
        diagnostics.report_ok("inactive: the machine stands")

    def _open_session(self) -> Session:
        """Return the machine under its clock, which stands."""
        config = self._config
        scene = load_scene(config.scene)
        for line in scene.warnings:
            self.get_logger().warning(line)
        self._diagnostics.hardware_id = scene.name
        session = (
            open_real_time_session(scene, config.start, inactive=True, readers=READERS)
            if config.clock == "realtime"
            else Session(scene, config.clock, config.start, inactive=True)
        )
        self._diagnostics.values |= build_facts(session.plant)
        if session.is_self_clocked:
            self._diagnostics.values["nice value"] = raise_priority()
        return session

    def _begin_record(
        self, outgoing: OutgoingMessages, publishers: list[Publisher], commands: str
    ) -> None:
        """Record what is published, commands, and messages between others, until the node ends."""
        folder, diagnostics = Path(self._config.record), self._diagnostics
        self._others = subscribe_to_others(self, outgoing.record_message_of_others)
        taken = [commands, *(subscription.topic_name for subscription in self._others)]
        with CtrlC.delay_interrupt():  # or the new bag would have no end
            outgoing.record = create_record(self, folder, publishers, taken, self._session.lockstep)
        diagnostics.send = lambda message: outgoing.publish_message(diagnostics.publisher, message)
        self.cleanup.callback(self._end_record)

    def _open_page(self, session: Session) -> PageProcess:
        """Return the machine with a page, or without one."""
        host, port = self._config.page_host, self._config.page_port
        if port < 0:
            return PageProcess(session.plant, None)
        # Not imported without a page: it takes messages of other nodes.
        from emulator_node.page_controls import RosControls

        of_run = session.scene.servo_period, session.lockstep, self._config.real_time_factor
        controls = partial(RosControls, self.get_namespace(), *of_run)
        page = PageProcess(session.plant, f"{host}:{port}", controls)
        print(f"page: {page.url}", flush=True)
        return page

    def begin_work(self) -> None:
        """Publish this tick, and let time pass."""
        self._duplicate_nodes.announce_node()
        self._duplicate_nodes.wait_until_first("emulator/status", alone=self._config.alone)
        with self._own.lock:
            self._reports.publish_description()
            self._reports.publish_tick()
            self._session.inactive = False
            self._pacer.start()

    def stop_work(self) -> None:
        """Let the machine stand at this tick, once it is published."""
        with self._own.lock:
            self._session.inactive = True
            self._pacer.catch_up()
        self._pacer.close()
        self._duplicate_nodes.withdraw_node()
        self._diagnostics.report_ok("inactive: the machine stands")

    def _end_record(self) -> None:
        take_rest(self._others)  # of a busy machine's last periods
        self._diagnostics.send = self._diagnostics.publisher.publish

    def _check_changes(self, changes: Mapping[str, Any]) -> EmulatorParameters:
        config = replace_parameters(self, self._config, changes)
        check_pace(config)
        return config

    def _take_parameters(self, config: EmulatorParameters) -> None:
        before, self._config = self._config, config
        if self.configured and config.real_time_factor != before.real_time_factor:
            with self._own.lock:
                self._own.pace.factor = config.real_time_factor
                self._pacer.check_time()

    def _report_recorder(self, event: str) -> None:
        self.get_logger().warning(event)
        self._diagnostics.values["newest of recorders"] = event

    def _handle_repeat(self) -> None:
        with self._own.lock:
            self._repeater.check_answer()

    def _handle_status(self) -> None:
        with self._own.lock:
            self._pacer.check_time()
            self._status.publish_status()
            if time.monotonic() - self._reports.published_at >= STATUS_PERIOD:
                self._reports.repeat_time()


def check_pace(config: EmulatorParameters) -> None:
    """Refuse another pace than that of the wall clock in real time, and one without an end."""
    if 0.0 < config.real_time_factor < SMALLEST:
        rule = f"be 0, or at least {SMALLEST:g} times real time"
        raise Refusal("emulator", "parameter real_time_factor", rule, config.real_time_factor)
    if config.clock == "realtime" and config.real_time_factor not in (0.0, 1.0):
        rule = "be 0 or 1 with clock realtime, which is never faster or slower"
        actual = config.real_time_factor
        raise Refusal("emulator", "parameter real_time_factor", rule, actual)


def main() -> None:
    """Entry point of `ros2 run arm_emulator emulator_node`."""
    run_node(EmulatorNode)


if __name__ == "__main__":
    main()
