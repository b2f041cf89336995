"""Lock-step in C (c/answered_ticks.h): Python gets a tick when something else is due."""

from __future__ import annotations

import time
from functools import cache

import numpy as np
from rclpy.subscription import Subscription

from arm_emulator.base.bound import COMMAND
from arm_emulator.build.c_header import NULL, CData, Library
from arm_emulator.build.unit import library
from arm_emulator.ros.c import MIDDLEWARE
from arm_emulator.ros.doubles import STARTED
from arm_emulator.ros.fixed_layout import FixedLayout, Taking
from arm_emulator.ros.middleware import middleware, pattern_of
from emulator_node.breaks import Breaks
from emulator_node.c import ANSWERED_TICKS, answered_ticks_unit
from emulator_node.context import Context
from emulator_node.health import Health
from emulator_node.reports import Reports

PADDING = ANSWERED_TICKS.constant("ROS_PADDING")
LOGGED = 200  # ticks of which the messages have room in the log: some 20 ms


@cache
def answered_ticks() -> Library:
    """Return the compiled answered_ticks.h, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(answered_ticks_unit())


class AnsweredTicks:
    """The hot path of the emulator in lock-step.

    A command that answers the present tick, in the form that Python has taken before, leads to the
    next state. All others are Python's, and so are all while the machine waits for anything else,
    or a viewer is shown every tick.

    Attributes:
        takes, outgoing: see `HotPath`.

    Args:
        own: context with machine, recorders and record.
        subscription: to motor commands.
        commands: the commands that Python has taken.
        reports: what is published.
        health: of the node.
        breaks: what stops it.
    """

    def __init__(
        self,
        own: Context,
        subscription: Subscription,
        commands: Taking,
        reports: Reports,
        health: Health,
        breaks: Breaks,
    ) -> None:
        self._breaks = breaks
        self._session, self._gate, self._view, self._outbox = (
            own.session, own.gate, own.view, own.outbox,
        )  # fmt: skip
        self._commands, self._reports, self._health = commands, reports, health
        self._pace = own.pace
        self._topic = subscription.topic_name
        self._keep: list[object] = []
        self._layout: FixedLayout | None = None  # that C knows
        plant, scene = own.session.plant, own.session.scene
        N = len(scene.joints)
        self._place = np.zeros(N, np.int64)
        self._most = np.full(N, float(COMMAND.most))
        self._came, self._before = np.zeros(N), np.zeros(N)
        self._log = MIDDLEWARE.new("ros_log")
        self._logged: CData = NULL
        code = answered_ticks()
        self._struct = ANSWERED_TICKS.new(
            "answered_ticks",
            joints=N,
            machine=plant.machine,
            exchange=plant.core.arm_exchange,
            get_truth=plant.core.arm_get_truth,
            joint=plant.command.joint,
            command=plant.command,
            measurement=plant.measurement,
            truth=reports.truth,
            place=self._place,
            most=self._most,
            came=self._came,
            before=self._before,
            emulator=STARTED,
            number=len(reports.outgoing),
            publish=middleware().ros_publish,
            motor_state=reports.motor_state.struct,
            joint_state=reports.joint_state.struct,
            clock=reports.clock.struct,
            report_ticks=reports.ticks,
            log=self._log,
            period=own.session.period_ns,
        )
        argument = ANSWERED_TICKS.ffi.cast("void *", self._struct)
        self.takes = [(subscription, code.answered_ticks_take, argument)]
        self.outgoing = reports.outgoing

    def begin(self) -> None:
        """Prepare, see `HotPath`."""
        ticks, session = self._struct, self._session
        ticks.tick = ticks.last = session.tick
        ticks.result, ticks.stop = 0, self._breaks.stop
        if self._view.open or session.last_tick == session.tick or not self._knows_commands():
            return
        room = min(self._gate.room(), self._pace.room(session.tick))
        ticks.last = min(session.last_tick, session.tick + room)
        self._reports.refresh()
        if self._outbox.record is not None:
            self._begin_log()

    def end(self) -> None:
        """Take over the results of C, see `HotPath`."""
        ticks, before = self._struct, self._session.tick
        if ticks.tick == before and not ticks.result:
            return
        self._session.take_over(ticks.tick, self._before)
        self._gate.count(ticks.tick - before)
        self._reports.published_at = self._reports.repeated_at = time.monotonic()
        if self._outbox.record is not None:
            self._record(before)
        self._health.report_fault()
        self._breaks.look()

    def _knows_commands(self) -> bool:
        """Return whether the newest commands have the form that C can take."""
        layout = self._commands.layout
        if layout is not self._layout:
            self._layout, self._keep = layout, []
            assert layout is not None
            names, known = layout.message.joint_names, self._session.scene.joint_names
            fits = sorted(names) == sorted(known) and not len(layout.message.inputs)
            fits = fits and len(layout.message.command) == len(known)
            self._struct.pattern = pattern_of(layout, self._keep)[0]
            self._struct.pattern.size *= fits
            if fits:
                self._place[:] = [known.index(name) for name in names]
                places = layout.places
                self._struct.tick_at, self._struct.machine_at = places["tick"], places["machine"]
                self._struct.command_at = places["command"]
        return bool(self._struct.pattern.size)

    def _begin_log(self) -> None:
        """Let C keep the messages of some ticks."""
        sizes = [self._struct.pattern.size + PADDING]
        sizes += [one.layout.size for one in self.outgoing]
        room = LOGGED * sum(16 + size for size in sizes)
        if self._log.room != room:
            self._logged = MIDDLEWARE.ffi.new("uint8_t[]", room)
            self._log.data, self._log.room = self._logged, room
        self._log.used = 0
        self._struct.last = min(self._struct.last, self._session.tick + LOGGED)

    def _record(self, before: int) -> None:
        """Write into the record what was taken and published since a tick."""
        record, log = self._outbox.record, MIDDLEWARE.ffi.buffer(self._log.data, self._log.used)
        assert record is not None
        topics = [*(one.publisher.topic_name for one in self.outgoing), self._topic]
        at = 0
        while at < len(log):
            number, size = np.frombuffer(log[at : at + 16], np.int64)
            record.put(topics[number], log[at + 16 : at + 16 + size])
            at += 16 + int(size)
        for tick in range(before + 1, self._struct.tick + 1):
            record.count(tick)
