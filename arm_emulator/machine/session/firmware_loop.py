"""A machine and control code in C, servo period by servo period, without Python in between."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.control_code import ControlCode
from arm_emulator.tick.c import FIRMWARE_CONTROLLER, TICK, tick_calls


class FirmwareLoop:
    """Control code and a machine.

    Attributes:
        pointer: to ``firmware_controller``.

    Args:
        plant: the machine.
        code: gives the commands. It must outlive the loop.
        targets: ticks, ascending from 0, and joint targets (N,) that hold from each on; None: the
            control code knows them.
    """

    def __init__(
        self,
        plant: Plant,
        code: ControlCode,
        targets: tuple[Sequence[int], Array] | None = None,
    ) -> None:
        self._plant = plant
        calls = tick_calls()
        self._run, self._stops = calls.tick_run, calls.tick_stops
        self.pointer = code.struct or FIRMWARE_CONTROLLER.make_struct("firmware_controller")
        FIRMWARE_CONTROLLER.fill_struct(
            self.pointer,
            step=code.step,
            joint=plant.command.joint,
            further=plant.command.further,
            command=plant.command,
            stop=code.stop,
            **{"with": code.with_},
        )
        with_ = {"with": TICK.ffi.cast("void *", self.pointer)}
        answer = calls.firmware_controller_answer
        self._controller = TICK.make_struct("tick_controller", answer=answer, **with_)
        self.set_targets(targets or ((), np.zeros((0, len(plant.scene.joints)))))

    def set_targets(self, targets: tuple[Sequence[int], Array]) -> None:
        """Restart with other targets, see above."""
        ticks, rows = targets
        self._set_rows(np.array(ticks, np.int64), np.array(rows, np.float64, order="C"), -1)

    def _set_rows(self, row_tick: NDArray[np.int64], rows: Array, row: int) -> None:
        """Let these rows be the targets, which stay where they are, from one of them on."""
        self._row_tick, self._rows = row_tick, rows
        FIRMWARE_CONTROLLER.fill_struct(
            self.pointer, row_tick=row_tick, rows=rows, row_count=len(row_tick), row=row
        )

    def save(self) -> tuple[Any, ...]:
        """Return targets and commands as they are now, for `restore` of this loop."""
        commands = tuple(bytes(command) for command in self._read_commands())
        return self._row_tick, self._rows, int(self.pointer.row), commands

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Go on from what `save` has returned."""
        *targets, commands = saved
        self._set_rows(*targets)
        for now, then in zip(self._read_commands(), commands, strict=True):
            now[:] = then

    def _read_commands(self) -> tuple[Any, Any]:
        """Return what the control code has written last, which holds until it writes again."""
        command, joints = self._plant.command, self._plant.ticks.joints
        room = FIRMWARE_CONTROLLER.ffi.buffer
        further = 8 * self._plant.commanded[1:].size
        return (
            room(command.joint, joints * ARM.get_size("arm_joint_command")),
            room(command.further, further),
        )

    @property
    def is_stopped(self) -> bool:
        """Whether a breakpoint ends runs now."""
        return bool(self._stops(self._plant.ticks))

    def run_periods(self, ticks: int) -> None:
        """Run so many periods, or fewer up to a breakpoint.

        Raises:
            Refusal: a command was refused; the machine is where it was then.
            Diverged: see `Plant.exchange`.
        """
        at, controller = self._plant.ticks, self._controller
        self._plant.exchange_in(lambda: int(self._run(at, controller, ticks)))
