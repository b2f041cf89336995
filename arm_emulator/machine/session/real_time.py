"""The thread that owns time in real time: tick/c/real_time.h, called from Python."""

import os
import select
from dataclasses import fields

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.synchronized import Synchronized
from arm_emulator.base.validation.bound import COMMAND
from arm_emulator.base.validation.count import LARGEST, check_count
from arm_emulator.machine.plant.call_arguments import make_commands
from arm_emulator.machine.plant.compiler import load_real_time
from arm_emulator.machine.plant.core_calls import ARM, PLACES
from arm_emulator.machine.plant.inputs import list_further_inputs
from arm_emulator.machine.plant.measured import MeasuredPlace
from arm_emulator.machine.plant.outputs import list_readings
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import ROWS
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.session.clock import Clock, ReachedTick, RealTimeFigures
from arm_emulator.machine.session.session import Session
from arm_emulator.tick.c import REAL_TIME
from arm_emulator.toolchain.c_header import NULL

LONGEST_PERIOD = 10**12  # ns; a quarter of an hour, so that sums of periods fit
LARGEST_CORE = 1023


class RealTimeLoop(Clock, Synchronized):
    """The real-time thread, which lets servo periods pass by itself. A forked child has none.

    Args:
        plant: the machine. While the loop runs no other code may use it.
        period_ns: wall time of a servo period [ns].
        core: processor core for the thread, -1 for any.
        readers: who takes its snapshots: 1, `take_tick` alone; 2, code in C beside it.

    Attributes:
        handle: ``arm_real_time *``.
        descriptor: see ``arm_real_time_descriptor``.

    Raises:
        Refusal: no such counts.
    """

    is_self_clocked = True

    def __init__(self, plant: Plant, period_ns: int, core: int, readers: int = 1) -> None:
        Synchronized.__init__(self)
        for quantity, value, smallest, largest in (
            ("period_ns", period_ns, 1, LONGEST_PERIOD),
            ("core", core, -1, LARGEST_CORE),
            ("readers", readers, 1, 2),
        ):
            check_count("RealTimeLoop", quantity, value, smallest, largest)
        self._period_ns = period_ns
        super().__init__(plant)  # which must outlive the loop
        self.running, self._spent_ns = False, 0
        self._N = N = len(plant.scene.joints)
        self._calls = load_real_time()
        options = REAL_TIME.make_struct(
            "arm_real_time_options",
            at=plant.ticks,
            join_schedule=plant.core.arm_join_schedule,
            period=period_ns,
            core=core,
            imus=len(plant.scene.imus),
            readings=len(list_readings(plant.scene)),
            inputs=len(list_further_inputs(plant.scene)),
            readers=readers,
        )
        self.handle = self._calls.arm_real_time_new(options)
        self.descriptor = self._calls.arm_real_time_descriptor(self.handle)
        self._energy, self._rows = np.zeros(1), np.zeros((len(ROWS), N))
        self._place = MeasuredPlace(plant.scene)
        self._snapshot = REAL_TIME.make_struct("arm_snapshot", **self._place.arrays)
        places = {PLACES.get(name, name): row for name, row in zip(ROWS, self._rows, strict=True)}
        truth = ARM.ffi.addressof(self._snapshot, "truth")
        ARM.fill_struct(truth, energy=self._energy, **places)
        self._commands = make_commands(plant.scene)
        self._further = np.zeros((len(list_further_inputs(plant.scene)), N))
        places = {"joint": self._commands, "further": self._further}
        self._command = ARM.make_struct("arm_command", tick=-1, **places)

    def __del__(self) -> None:
        loop, self.handle = getattr(self, "handle", None), None
        if loop:
            self._calls.arm_real_time_delete(loop)

    def restart_threads(self) -> None:  # noqa: D102
        self.handle = NULL  # the thread is the parent's, and the machine may be within a period

    @property
    def spent_ns(self) -> int:
        """Wall time that the exchanges of the ticks taken have needed so far [ns]."""
        return self._spent_ns

    @property
    def figures(self) -> RealTimeFigures:
        """Punctuality."""
        figures = REAL_TIME.make_struct("arm_real_time_figures")
        self._calls.arm_real_time_get_figures(self.handle, figures)
        return RealTimeFigures(
            **{field.name: getattr(figures, field.name) for field in fields(RealTimeFigures)}
        )

    def restart_clock(self) -> None:
        """Restart at tick 0, see `Clock.restart_clock`."""
        while self.take_tick() is not None:
            pass
        self.hold_command(-1, np.zeros(self._N))
        self._calls.arm_real_time_clear_figures(self.handle)

    def start_time(self, tick: int) -> None:
        """Run from `tick` on, until `stop_time` or a fault.

        Raises:
            Refusal: no count, or a forked child.
        """
        where = "RealTimeLoop.start_time"
        check_count(where, "tick", tick, 0, LARGEST // (2 * self._period_ns))
        if not self.handle:
            raise Refusal(where, "the process", "be the one that made it", "a forked child")
        self.running = True
        self._calls.arm_real_time_start(self.handle, tick)

    def stop_time(self) -> None:
        """Stop within a period. Ticks not taken yet stay."""
        self._calls.arm_real_time_stop(self.handle)
        self.running = False

    def go_on(self) -> None:
        """Continue as if it had not stopped; missed deadlines are lateness and lost periods."""
        self.running = True
        self._calls.arm_real_time_go_on(self.handle)

    def hold_command(self, answered: int, command: Array, further: Array | None = None) -> None:
        """Hold commands for the periods to come, see `Clock.hold_command`; -1 answers no tick.

        Raises:
            Refusal: wrong shape, not finite, or no count.
        """
        where = "RealTimeLoop.hold_command"
        check_count(where, "answered", answered, -1)
        self._commands["value"] = COMMAND.check_row(where, command, self._N)
        self._further[:] = 0.0 if further is None else further
        self._command.tick = answered
        self._calls.arm_real_time_command(self.handle, self._command)

    def wait_for_tick(self, timeout: float) -> bool:
        """Wait for a snapshot, at most `timeout` [s], without Python's lock."""
        if not select.select([self.descriptor], [], [], timeout)[0]:
            return False
        os.read(self.descriptor, 8)
        return True

    def take_tick(self, *, newest: bool = False) -> ReachedTick | None:
        """Return the oldest tick not taken yet, or the newest; None after the last."""
        skipped = self._calls.arm_real_time_skip(self.handle, 0) if newest else 0
        if not self._calls.arm_real_time_take(self.handle, 0, self._snapshot):
            return None
        reached = ReachedTick(
            self._snapshot.tick,
            self._snapshot.lateness,
            self._snapshot.spent + skipped,
            self._snapshot.truth.fault,
            float(self._energy[0]),
            self._rows.copy(),
            self._place.read_values(),
        )
        self._spent_ns += reached.spent
        if reached.fault >= 0:
            self.running = False  # the loop has ended there
        return reached


def open_real_time_session(
    scene: Scene, start: str, *, inactive: bool = False, readers: int = 1
) -> Session:
    """Return a session whose ticks come from the real-time loop, see `Session`."""

    def make_loop(plant: Plant) -> RealTimeLoop:
        return RealTimeLoop(plant, int(plant.ticks.period), scene.cores[0], readers)

    return Session(scene, "realtime", start, make_loop, inactive=inactive)
