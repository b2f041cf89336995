"""Messages in real time in C (c/real_time_ticks.h): states are published, commands are held."""

from contextlib import ExitStack

import numpy as np
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from arm_emulator.machine.plant.call_arguments import make_commands
from arm_emulator.machine.plant.compiler import load_real_time
from arm_emulator.machine.plant.measured import MeasuredPlace
from arm_emulator.machine.session.phase import Phase
from arm_emulator.machine.session.real_time import RealTimeLoop
from arm_emulator.ros.messages.middleware import Outgoing, get_middleware
from arm_emulator.toolchain.c_header import CData
from arm_emulator.toolchain.compile_unit import compile_once
from emulator_node.c import REAL_TIME_TICKS, make_real_time_ticks_unit
from emulator_node.command_reader import CommandReader
from emulator_node.context import Context
from emulator_node.log_of_c import compute_log_room, record_log
from emulator_node.reports import TRUTH, Reports

READERS, READER = 2, 1  # of the loop: the session is the first
LOGGED = 8192  # ticks of which the messages have room in a log

real_time_ticks = compile_once(make_real_time_ticks_unit)


class RealTimeTicks:
    """Publishes the ticks of a loop in C, and gives commands to the loop.

    Attributes:
        at: ``real_time_ticks *``.

    Args:
        own: context with machine and record.
        reports: publishes the same from Python.
    """

    def __init__(self, own: Context, reports: Reports) -> None:
        self._own, self._session = own, own.session
        scene, clock = own.session.scene, own.session.clock
        assert isinstance(clock, RealTimeLoop)
        N = len(scene.joints)
        self._calls, loop = real_time_ticks(), load_real_time()
        place, rows = MeasuredPlace(scene), np.zeros((len(TRUTH), N))
        self._snapshot = REAL_TIME_TICKS.make_struct("arm_snapshot", **place.arrays)
        truth = REAL_TIME_TICKS.ffi.addressof(self._snapshot, "truth")
        q, v, gear_torque = rows
        REAL_TIME_TICKS.fill_struct(truth, q=q, v=v, gear_torque=gear_torque)
        self._messages = reports.create_messages(place.make_view(), rows)
        motor_state, joint_state, time = self._messages
        self._joint, self._stack = make_commands(scene), ExitStack()
        self._command = REAL_TIME_TICKS.make_struct("arm_command", tick=-1, joint=self._joint)
        self._logs: list[CData] = []  # of C, and another one in exchange for it
        self.at = REAL_TIME_TICKS.make_struct(
            "real_time_ticks",
            loop=clock.handle,
            at=own.session.plant.ticks,
            take=loop.arm_real_time_take,
            give=loop.arm_real_time_command,
            descriptor=clock.descriptor,
            reader=READER,
            send=get_middleware().ros_send,
            snapshot=self._snapshot,
            motor_state=motor_state.struct,
            joint_state=joint_state.struct,
            clock=time.struct,
            report_ticks=reports.ticks,
            joint=REAL_TIME_TICKS.ffi.cast("arm_joint_command *", self._joint.ctypes.data),
            command=self._command,
            answers=own.session.command_buffer,
        )
        commands = REAL_TIME_TICKS.ffi.addressof(self.at, "commands")
        self._commands = CommandReader(scene, commands, len(self._messages))
        if not self._calls.real_time_ticks_begin(self.at):
            raise MemoryError

    def __del__(self) -> None:
        if hasattr(self, "at"):  # a signal may end the compiler before
            self._calls.real_time_ticks_end(self.at)

    def begin_publishing(self) -> None:
        """Let `publish_ticks` publish from now on."""
        for message in self._messages:
            self._stack.enter_context(message.bind_to_c())
        self.at.closing = 0
        if self._own.outgoing.record is not None and not self._logs:
            room = compute_log_room(LOGGED, self._messages, self._commands.largest)
            ffi = REAL_TIME_TICKS.ffi
            self._logs = [ffi.new("uint8_t[]", room) for _ in range(2)]
            self.at.log.data, self.at.log.room = self._logs[0], room
            self._log = REAL_TIME_TICKS.make_struct("ros_log", data=self._logs[1], room=room)
        self.set_machine()

    def publish_ticks(self) -> bool:
        """Publish what the loop reaches; True if Python has to look, False once it is closing."""
        return bool(self._calls.real_time_ticks_run(self.at))

    def stop_publishing(self) -> None:
        """Let `publish_ticks` return."""
        self.at.closing = 1

    def release_publishers(self) -> None:
        """Release the publishers; nothing may run any more."""
        self._stack.close()

    def catch_up(self) -> None:
        """Publish all that the loop has reached."""
        self._calls.real_time_ticks_catch_up(self.at)

    def set_machine(self) -> None:
        """Take over the tick and the power of a machine that stands; all ticks are published."""
        message = self._messages[0].layout
        message.message.powered = self._session.powered
        message.write_numbers()
        self._calls.real_time_ticks_set_tick(self.at, self._session.tick)

    def record_messages(self, topic: str) -> None:
        """Write what C has published and taken into the record; `topic`: of the commands."""
        record = self._own.outgoing.record
        if record is None or not self._logs:
            return
        log = self._log
        log.used = log.dropped = 0
        self._calls.real_time_ticks_exchange_log(self.at, log)
        record_log(record, log, self._messages, topic)


class RealTimeCommands:
    """The hot path of the emulator in real time: commands without further inputs.

    Attributes:
        takes, outgoing, beside: see `HotPath`.

    Args:
        own: context with the machine.
        ticks: gives commands to the loop.
        subscription: to motor commands.
    """

    def __init__(self, own: Context, ticks: RealTimeTicks, subscription: Subscription) -> None:
        self._session, self._ticks, self._node = own.session, ticks, own.node
        ffi = REAL_TIME_TICKS.ffi
        take = real_time_ticks().real_time_ticks_receive
        self.takes = [(subscription, take, ffi.cast("void *", ticks.at))]
        self.outgoing: tuple[Outgoing, ...] = ()

    @property
    def beside(self) -> list[Timer]:
        """All timers: none of them changes the machine."""
        return [*self._node.timers]

    def begin_in_c(self) -> None:
        """Prepare, see `HotPath`."""
        running = self._session.phase is Phase.RUNNING
        self._ticks.at.open = running and not self._session.zoh_rows[1:].any()

    def end_in_c(self) -> None:
        """Leave commands to Python, see `HotPath`."""
        self._ticks.at.open = 0
