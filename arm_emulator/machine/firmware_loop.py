"""A machine and control code in C, servo period by servo period, without Python in between."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, compiled_once
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.chain import Array
from arm_emulator.machine.control_code import ControlCode
from arm_emulator.machine.core_calls import ARM, FIRMWARE_LOOP
from arm_emulator.machine.plant import Plant


def firmware_loop_unit() -> Unit:
    """Return the loop as what is compiled."""
    source, about = '#include "firmware_loop.c"\n', "the loop of control code"
    headers, part = (FIRMWARE_LOOP,), "firmware_loop.c"
    return Unit("firmware_loop", source, C_FLAGS, (BOUNDARY,), headers, "firmware", about, part)


firmware_loop = compiled_once(firmware_loop_unit)


class FirmwareLoop:
    """Control code and a machine.

    Attributes:
        pointer: to ``firmware_loop``.

    Args:
        plant: the machine.
        period_ns: servo period [ns].
        code: gives the commands. It must outlive the loop.
        targets: ticks, ascending from 0, and joint targets (N,) that hold from each on; None: the
            control code knows them.
    """

    def __init__(
        self,
        plant: Plant,
        period_ns: int,
        code: ControlCode,
        targets: tuple[Sequence[int], Array] | None = None,
    ) -> None:
        self._plant = plant
        self._calls = firmware_loop()
        self.pointer = code.struct or FIRMWARE_LOOP.new("firmware_loop")
        FIRMWARE_LOOP.fill(
            self.pointer,
            joints=len(plant.scene.joints),
            machine=plant.machine,
            measure=plant.core.arm_measure,
            exchange=plant.core.arm_exchange,
            step=code.step,
            period=period_ns,
            joint=plant.command.joint,
            further=plant.command.further,
            command=plant.command,
            measurement=plant.measurement,
            stop=code.stop,
            **{"with": code.with_},
        )
        self.aim(targets or ((), np.zeros((0, len(plant.scene.joints)))))

    def aim(self, targets: tuple[Sequence[int], Array]) -> None:
        """Begin anew with other targets, see above."""
        ticks, rows = targets
        self._row_tick = np.array(ticks, np.int64)
        self._rows = np.array(rows, np.float64, order="C")
        FIRMWARE_LOOP.fill(
            self.pointer,
            row_tick=self._row_tick,
            rows=self._rows,
            row_count=len(self._row_tick),
            row=0,
        )

    def save(self) -> tuple[Any, ...]:
        """Return targets and commands as they are now, for `restore` of this loop."""
        at, commands = self.pointer, tuple(bytes(one) for one in self._commands())
        return at.tick, at.row, self._row_tick, self._rows, commands

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Go on from what `save` has returned."""
        tick, row, self._row_tick, self._rows, commands = saved
        FIRMWARE_LOOP.fill(
            self.pointer,
            row_tick=self._row_tick,
            rows=self._rows,
            row_count=len(self._row_tick),
            row=row,
            tick=tick,
        )
        for now, then in zip(self._commands(), commands, strict=True):
            now[:] = then

    def _commands(self) -> tuple[Any, Any]:
        """Return what the control code has written last, which holds until it writes again."""
        command, joints = self._plant.command, self.pointer.joints
        room = FIRMWARE_LOOP.ffi.buffer
        further = 8 * self._plant.commanded[1:].size
        return (
            room(command.joint, joints * ARM.sizeof("arm_joint_command")),
            room(command.further, further),
        )

    @property
    def tick(self) -> int:
        """Number of the present tick."""
        return int(self.pointer.tick)

    def run(self, tick: int, ticks: int) -> None:
        """Run so many periods from a tick on.

        Raises:
            Refusal: a command was refused; the machine is at `tick`, where it was then.
            Diverged: see `Plant.exchange`.
        """
        self.begin(tick)
        self._plant.exchange_in(lambda: int(self._calls.firmware_loop_run(self.pointer, ticks)))

    def begin(self, tick: int) -> None:
        """Report where the machine is."""
        self.pointer.tick = tick
