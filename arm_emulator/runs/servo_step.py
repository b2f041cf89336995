"""Our servo as control code in a loop with a machine: servo_step.c."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import numpy as np

from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Calls, Unit, address, library
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.control_code import ControlCode
from arm_emulator.machine.firmware_loop import FirmwareLoop
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.drives import Drives

_pointer, _int32 = ctypes.c_void_p, ctypes.c_int32
_CALLS: Calls = {
    "servo_step_step": (None, [_pointer] * 3),
    "servo_step_measure": (None, [_pointer] * 2),
}


class _StepStruct(ctypes.Structure):
    """``servo_step``."""

    _fields_ = (
        ("arm", _pointer),
        ("place", _pointer),
        *((name, _pointer) for name in ("counts", "current", "applied", "q", "voltage")),
        ("measured", _int32),
        ("reserved", _int32),
    )


@cache
def _servo_step() -> ctypes.CDLL:
    return library(servo_step_unit())


def servo_step_unit() -> Unit:
    """Return servo and step as what is compiled."""
    source = '#include "servo.c"\n#include "servo_step.c"\n'
    folders = (FOLDER, BOUNDARY, Path(__file__).resolve().parent)
    about = "the servo for runs without a network"
    return Unit("servo_step", source, C_FLAGS, folders, _CALLS, "servo", about, "servo.c")


class ServoStep(ControlCode):
    """A servo as a step of `arm_emulator.machine.firmware_loop`.

    Attributes:
        name: for refusals.
        step: address of the step.
        with_: address that it gets.

    Args:
        drives: the servo.
        place: of each of its joints among the machine's.
    """

    def __init__(self, drives: Drives, place: list[int]) -> None:
        self.name = "servo"
        self._drives = drives  # must outlive the step
        self._place = np.array(place, np.int32)
        servo = drives.servo
        counts, current, applied, q, *_, voltage = servo.places
        self._struct = _StepStruct(
            ctypes.addressof(servo.arm),
            self._place.ctypes.data,
            counts,
            current,
            applied,
            q,
            voltage,
        )
        self._calls = _servo_step()
        self.step = address(self._calls, "servo_step_step")
        self.with_ = ctypes.addressof(self._struct)

    def measure(self, loop: FirmwareLoop, tick: int) -> None:
        """Take the measurement of a tick before its step, so that a target can follow from it."""
        loop.begin(tick)
        self._calls.servo_step_measure(self.with_, loop.pointer)
