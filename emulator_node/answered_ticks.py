"""Lock-step in C (c/answered_ticks.h): Python gets a tick when something else is due."""

import time

from rclpy.subscription import Subscription

from arm_emulator.ros.c import MIDDLEWARE
from arm_emulator.ros.messages.middleware import get_middleware
from arm_emulator.toolchain.c_header import NULL, CData
from arm_emulator.toolchain.compile_unit import compile_once
from emulator_node.breakpoints import Breakpoints
from emulator_node.c import ANSWERED_TICKS, make_answered_ticks_unit
from emulator_node.command_reader import CommandReader
from emulator_node.context import Context
from emulator_node.health import Health
from emulator_node.log_of_c import compute_log_room, record_log
from emulator_node.reports import Reports

LOGGED = 200  # ticks of which the messages have room in the log: some 20 ms

answered_ticks = compile_once(make_answered_ticks_unit)


class AnsweredTicks:
    """The hot path of the emulator in lock-step.

    A command that answers the present tick leads to the next state. Python takes all other
    commands. It takes all commands while the machine waits for anything else, has further inputs
    that are not 0, or a viewer is shown every tick.

    Attributes:
        takes, outgoing: see `HotPath`.

    Args:
        own: context with machine, recorders and record.
        subscription: to motor commands.
        reports: what is published.
        health: of the node.
        breaks: what stops it.
    """

    def __init__(
        self,
        own: Context,
        subscription: Subscription,
        reports: Reports,
        health: Health,
        breaks: Breakpoints,
    ) -> None:
        self._breaks = breaks
        self._session, self._gate, self._view, self._outgoing = (
            own.session, own.gate, own.view, own.outgoing,
        )  # fmt: skip
        self._reports, self._health = reports, health
        self._pace = own.pace
        self._topic = subscription.topic_name
        plant, scene = own.session.plant, own.session.scene
        self._log = MIDDLEWARE.make_struct("ros_log")
        self._logged: CData = NULL
        code = answered_ticks()
        self._struct = ANSWERED_TICKS.make_struct(
            "answered_ticks",
            at=plant.ticks,
            answers=own.session.command_buffer,
            joint=plant.command.joint,
            command=plant.command,
            truth=reports.truth,
            publish=get_middleware().ros_publish,
            motor_state=reports.motor_state.struct,
            joint_state=reports.joint_state.struct,
            clock=reports.clock.struct,
            report_ticks=reports.ticks,
            log=self._log,
        )
        struct = ANSWERED_TICKS.ffi.addressof(self._struct, "commands")
        self._commands = CommandReader(scene, struct, len(reports.outgoing))
        argument = ANSWERED_TICKS.ffi.cast("void *", self._struct)
        self.takes = [(subscription, code.answered_ticks_receive, argument)]
        self.outgoing = reports.outgoing

    def begin_in_c(self) -> None:
        """Prepare, see `HotPath`."""
        ticks, session = self._struct, self._session
        ticks.last = self._begun = session.tick
        ticks.result = 0
        if self._view.is_open or session.last_tick == session.tick or session.zoh_rows[1:].any():
            return
        room = min(self._gate.count_free_ticks(), self._pace.count_ticks_left(session.tick))
        ticks.last = min(session.last_tick, session.tick + room)
        self._reports.refresh_messages()
        if self._outgoing.record is not None:
            self._begin_log()

    def end_in_c(self) -> None:
        """Take over the results of C, see `HotPath`."""
        passed = self._session.tick - self._begun
        if not passed and not self._struct.result:
            return
        self._session.take_note()
        self._gate.published += passed
        self._reports.published_at = self._reports.repeated_at = time.monotonic()
        if self._outgoing.record is not None:
            record_log(self._outgoing.record, self._log, self.outgoing, self._topic)
        self._health.report_fault()
        self._breaks.check_condition()

    def _begin_log(self) -> None:
        """Let C keep the messages of some ticks."""
        room = compute_log_room(LOGGED, self.outgoing, self._commands.largest)
        if self._log.room != room:
            self._logged = MIDDLEWARE.ffi.new("uint8_t[]", room)
            self._log.data, self._log.room = self._logged, room
        self._log.used = 0
        self._struct.last = min(self._struct.last, self._session.tick + LOGGED)
