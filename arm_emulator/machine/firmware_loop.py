"""A machine and control code in C, servo period by servo period, without Python in between."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache

import numpy as np

from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Calls, Unit, address, library
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.chain import Array
from arm_emulator.machine.control_code import ControlCode
from arm_emulator.machine.plant import Plant

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64
_CALLS: Calls = {
    "firmware_loop_run": (ctypes.c_int, [_pointer, _int64]),
    "firmware_loop_step": (None, [_pointer] * 3),
}


class LoopStruct(ctypes.Structure):
    """``firmware_loop``."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("joints", ctypes.c_int32),
        *((name, _pointer) for name in ("machine", "measure", "exchange", "step", "with_")),
        ("period", _int64),
        *((name, _pointer) for name in ("row_tick", "rows")),
        *((name, _int64) for name in ("row_count", "row")),
        *((name, _pointer) for name in ("joint", "value_d", "command", "measurement")),
        ("tick", _int64),
        ("stop", _pointer),
    )


@cache
def firmware_loop() -> ctypes.CDLL:
    """Return the compiled loop of firmware_loop.h, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(firmware_loop_unit())


def firmware_loop_unit() -> Unit:
    """Return the loop as what is compiled."""
    source, about = '#include "firmware_loop.c"\n', "the loop of control code"
    return Unit(
        "firmware_loop", source, C_FLAGS, (BOUNDARY,), _CALLS, "firmware", about, "firmware_loop.c"
    )


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
        ticks, rows = targets or ((), np.zeros((0, len(plant.scene.joints))))
        self._row_tick = np.array(ticks, np.int64)
        self._rows = np.array(rows, np.float64, order="C")
        self._loop = code.struct or LoopStruct()
        LoopStruct.__init__(
            self._loop,
            size=ctypes.sizeof(LoopStruct),
            joints=len(plant.scene.joints),
            machine=plant.machine,
            measure=address(plant.core, "arm_measure"),
            exchange=address(plant.core, "arm_exchange"),
            step=code.step,
            with_=code.with_,
            period=period_ns,
            row_tick=self._row_tick.ctypes.data,
            rows=self._rows.ctypes.data,
            row_count=len(self._row_tick),
            joint=plant.command.joint,
            value_d=plant.command.value_d,
            command=ctypes.addressof(plant.command),
            measurement=ctypes.addressof(plant.measurement),
            stop=code.stop,
        )
        self.pointer = ctypes.byref(self._loop)

    @property
    def tick(self) -> int:
        """Where the machine is."""
        return int(self._loop.tick)

    def run(self, tick: int, ticks: int) -> None:
        """Go through so many periods from a tick on.

        Raises:
            Refusal: a command was refused; the machine is at `tick`, where it was then.
            Diverged: see `Plant.exchange`.
        """
        self.begin(tick)
        self._plant.exchange_in(lambda: int(self._calls.firmware_loop_run(self.pointer, ticks)))

    def begin(self, tick: int) -> None:
        """Tell where the machine is."""
        self._loop.tick = tick
