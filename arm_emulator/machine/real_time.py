"""A session in real time: a compiled thread owns the clock (core/boundary/real_time.h)."""

from __future__ import annotations

import ctypes
import os
import select
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from arm_emulator.base.bound import VOLTAGE
from arm_emulator.base.count import LARGEST, check_count
from arm_emulator.build.unit import address
from arm_emulator.machine.chain import Array
from arm_emulator.machine.compiler import real_time_library
from arm_emulator.machine.core_calls import (
    JOINT_COMMAND,
    MODES,
    Command,
    RealTimeOptions,
    Snapshot,
    Truth,
)
from arm_emulator.machine.measured import Measured, MeasuredPlace
from arm_emulator.machine.outputs import readings_of
from arm_emulator.machine.plant import LARGEST_STEPS, ROWS, Plant, PlantState
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.session import Session

LONGEST_PERIOD = 10**12  # ns; a quarter of an hour, so that sums of periods fit
LARGEST_CORE = 1023


@dataclass(frozen=True)
class RealTimeFigures:
    """How punctual the loop is, since it was reset; times in ns."""

    tick: int
    lost_periods: int  # deadlines missed by whole periods, which logical time has lost
    old_commands: int  # periods under a command that answers a state more than two periods old
    worst_lateness: int
    median_lateness: int
    p99_lateness: int
    unread: int  # snapshots that nobody fetched in time
    fifo: int  # 1: the core's threads run under SCHED_FIFO
    locked: int  # 1: memory is locked


@dataclass(frozen=True)
class Reached:
    """The machine at a tick that the loop has reached."""

    tick: int
    spent: int  # ns, on the period that led there
    fault: int  # joint that diverged; -1: none
    energy: float  # J
    rows: Array  # (len(ROWS), N), see `PlantState`
    measured: Measured


class RealTimeLoop:
    """The core's real-time thread, through its C interface.

    Args:
        plant: the machine. While the loop runs nobody else may touch it.
        period_ns: servo period [ns].
        steps: integration steps in a period.
        core: processor core for the thread, -1 for any.

    Raises:
        Refusal: no such counts.
    """

    def __init__(self, plant: Plant, period_ns: int, steps: int, core: int) -> None:
        for quantity, value, least, largest in (
            ("period_ns", period_ns, 1, LONGEST_PERIOD),
            ("steps", steps, 1, LARGEST_STEPS),
            ("core", core, -1, LARGEST_CORE),
        ):
            check_count("RealTimeLoop", quantity, value, least, largest)
        self._period_ns = period_ns
        self._plant = plant  # must outlive the loop
        self._N = N = len(plant.scene.joints)
        self._calls = real_time_library()
        options = RealTimeOptions(
            joints=N,
            machine=plant.machine,
            exchange=address(plant.core, "arm_exchange"),
            get_truth=address(plant.core, "arm_get_truth"),
            join_schedule=address(plant.core, "arm_join_schedule"),
            period=period_ns,
            core=core,
            imus=len(plant.scene.imus),
            readings=len(readings_of(plant.scene)),
        )
        self._loop = self._calls.arm_real_time_new(ctypes.byref(options))
        self._bell = self._calls.arm_real_time_descriptor(self._loop)
        self._energy, self._rows = np.zeros(1), np.zeros((len(ROWS), N))
        self._place = MeasuredPlace(plant.scene)
        places = {name: row.ctypes.data for name, row in zip(ROWS, self._rows, strict=True)}
        self._snapshot = Snapshot(
            truth=Truth(energy=self._energy.ctypes.data, **places),
            **self._place.addresses,
        )
        self._commands = np.zeros(N, JOINT_COMMAND)
        self._commands["mode"] = [MODES[joint.command] for joint in plant.scene.joints]
        self._commands["enable"] = 1
        self._command = Command(tick=-1, joint=self._commands.ctypes.data)

    def __del__(self) -> None:
        loop, self._loop = getattr(self, "_loop", None), None
        if loop:
            self._calls.arm_real_time_delete(loop)

    def start(self, tick: int) -> None:
        """Run from `tick` on, until `stop` or a fault.

        Raises:
            Refusal: no count.
        """
        check_count("RealTimeLoop.start", "tick", tick, 0, LARGEST // (2 * self._period_ns))
        self._calls.arm_real_time_start(self._loop, tick)

    def stop(self) -> None:
        """Stop within a period. Snapshots not taken yet stay."""
        self._calls.arm_real_time_stop(self._loop)

    def go_on(self) -> None:
        """Go on as if it had not been stopped; what was missed is lateness, and lost periods."""
        self._calls.arm_real_time_go_on(self._loop)

    def command(self, answered: int, voltage: Array) -> None:
        """Set the voltages (N,) [V] for the periods to come; -1 answers no tick.

        Raises:
            Refusal: wrong shape, not finite, or no count.
        """
        where = "RealTimeLoop.command"
        check_count(where, "answered", answered, -1)
        self._commands["value"] = VOLTAGE.vector(where, voltage, self._N)
        self._command.tick = answered
        self._calls.arm_real_time_command(self._loop, ctypes.byref(self._command))

    def wait(self, timeout: float) -> bool:
        """Wait for a snapshot, at most `timeout` [s], without Python's lock."""
        if not select.select([self._bell], [], [], timeout)[0]:
            return False
        os.read(self._bell, 8)
        return True

    def take(self) -> Reached | None:
        """Return the oldest tick not taken yet, None if there is none."""
        if not self._calls.arm_real_time_take(self._loop, ctypes.byref(self._snapshot)):
            return None
        return Reached(
            self._snapshot.tick,
            self._snapshot.spent,
            self._snapshot.truth.fault,
            float(self._energy[0]),
            self._rows.copy(),
            self._place.read(),
        )

    def figures(self) -> RealTimeFigures:
        """Return the loop's figures."""
        values = np.zeros(len(fields(RealTimeFigures)), dtype=np.int64)
        self._calls.arm_real_time_get_figures(self._loop, values.ctypes.data_as(ctypes.c_void_p))
        return RealTimeFigures(*values.tolist())

    def clear_figures(self) -> None:
        """Count from now on."""
        self._calls.arm_real_time_clear_figures(self._loop)


class RealTimeSession(Session):
    """A session whose ticks come from the real-time loop: `wait`, then `take` until it is False.

    The loop runs exactly while the phase allows to advance.
    """

    def __init__(self, scene: Scene, start: str) -> None:
        self._loop: RealTimeLoop | None = None
        self._spent_ns = 0  # on exchanges
        self._running = False
        self._held = False  # between two ticks,
        self._goes_on = False  # after which the loop goes on where it was
        super().__init__(scene, "realtime", start)
        self._loop = RealTimeLoop(
            self.plant, self.period_ns, scene.steps_per_period, scene.cores[0]
        )
        self._look()
        self._loop.command(-1, self._zero)
        self._follow_phase()

    def reset(self) -> None:
        """Begin anew at tick 0."""
        if self._loop is None:  # within the base's constructor
            super().reset()
            return
        with self.between_ticks():
            while self._loop.take() is not None:
                pass
            super().reset()
            self._look()
            self._loop.command(-1, self._zero)
            self._loop.clear_figures()
            self._goes_on = False

    def close(self) -> None:
        """Stop the loop for good."""
        self._halt()

    @property
    def figures(self) -> RealTimeFigures:
        """How punctual the loop is."""
        assert self._loop is not None
        return self._loop.figures()

    @property
    def energy(self) -> float:
        """Energy of the machine at this tick [J]."""
        return self._energy

    @property
    def paused(self) -> bool:
        """Whether logical time stands still on request."""
        return self._paused

    @paused.setter
    def paused(self, value: bool) -> None:
        self._paused = value
        self._follow_phase()

    @contextmanager
    def between_ticks(self) -> Iterator[None]:
        """Within, the loop stands still: take what it has reached, then change the machine.

        Afterwards it goes on as if it had not been stopped: periods that it has missed are counted.
        """
        assert self._loop is not None
        if self._held:
            yield
            return
        self._goes_on = self._running
        self._halt()
        self._held = True
        try:
            yield
        finally:
            self._held = False
            if self._goes_on and self.may_advance:
                self._running = True
                self._loop.go_on()
            else:
                self._follow_phase()

    def _take_machine(self) -> None:
        super()._take_machine()
        self._look()

    def _look(self) -> None:
        """Take what there is at this tick, while the loop stands still."""
        self._state, self._measured = self.plant.state, self.plant.measured
        self._energy = self.plant.energy

    def offer(self, tick: int, joint_names: Any, voltage: Any) -> None:
        """Take a motor command, see `Session.offer`."""
        super().offer(tick, joint_names, voltage)
        assert self._loop is not None and self._commanded is not None
        self._loop.command(tick, self._commanded)
        self._follow_phase()

    @property
    def step_wall_ns(self) -> int:
        """Wall time that the loop's exchanges have taken so far [ns]."""
        return self._spent_ns

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` [s] for a tick."""
        assert self._loop is not None
        return self._loop.wait(timeout)

    def take(self) -> bool:
        """Go on to the next tick that the loop has reached; False if there is none."""
        assert self._loop is not None
        reached = self._loop.take()
        if reached is None:
            return False
        self.tick, self._energy, self._measured = reached.tick, reached.energy, reached.measured
        self.voltage = reached.measured.applied
        self._spent_ns += reached.spent
        t = reached.tick * self.scene.servo_period
        current, theta_m, omega_m, q, v, gear_torque = reached.rows
        counts = reached.measured.encoder_counts
        self._state = PlantState(t, current, theta_m, omega_m, q, v, gear_torque, counts)
        if reached.fault >= 0:
            self.fault = self.plant.fault(reached.fault, t, q, v, self.voltage)
            self._running = False
        return True

    def step(self) -> str:
        """Advance a paused session by one tick, see `Session.step`."""
        said = super().step()
        if not said:
            self._energy = self.plant.energy
        return said

    def _halt(self) -> None:
        if self._running and self._loop is not None:
            self._loop.stop()
        self._running = False

    def _follow_phase(self) -> None:
        if self._loop is None or self._held:
            return
        if self.may_advance and not self._running:
            while self.take():  # ticks that were reached before the loop was halted
                pass
            self._running = True
            self._loop.start(self.tick)
        elif not self.may_advance:
            self._halt()
