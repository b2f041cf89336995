"""Our servo as control code in a loop with a machine: servo_step.c."""

import pickle
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.control_code import ControlCode
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator.tick import c as tick
from arm_emulator.toolchain.c_header import Header
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit

HERE = Path(__file__).resolve().parent
STEP = Header(HERE / "servo_step.h", (*tick.FOLDERS, FOLDER))


def make_servo_step_unit() -> Unit:
    """Return servo and step as what is compiled."""
    source = '#include "tick.c"\n#include "servo.c"\n#include "servo_step.c"\n'
    folders = (FOLDER, *tick.FOLDERS, HERE)
    about = "the servo for runs without a network"
    return Unit("servo_step", source, C_FLAGS, folders, (STEP,), "servo", about, "servo.c")


_servo_step = compile_once(make_servo_step_unit)


class ServoStep(ControlCode):
    """A servo as a step of `arm_emulator.machine.session.firmware_loop`.

    Attributes:
        name: for refusals.
        step: the function of the step.
        with_: pointer that it gets.

    Args:
        drives: the servo.
        place: of each of its joints among the machine's.
    """

    def __init__(self, drives: ServoArm, place: list[int]) -> None:
        self.name = "servo"
        self._drives = drives  # must outlive the step
        self._place = np.array(place, np.int32)
        servo = drives.servo
        counts, current, applied, q, *_, command = servo.places
        self._closed = np.zeros(len(place), np.int64)
        self.with_ = STEP.make_struct(
            "servo_step",
            arm=servo.arm,
            place=self._place,
            counts=counts,
            closed=self._closed,
            current=current,
            applied=applied,
            q=q,
            command=command,
        )
        self._calls = _servo_step()
        self.step = self._calls.servo_step_step

    def compute_commands(self, powered: bool) -> NDArray[np.float64]:
        """Return the commands for the tick that was measured, in the machine's order (N,)."""
        self.with_.measured = 0
        rows = np.zeros(len(self._place))
        rows[self._place] = self._drives.compute_commands(powered)
        return rows

    def save(self) -> bytes:
        """Return the servo as it is now."""
        now = self._drives.save(), self._closed, int(self.with_.measured)
        return pickle.dumps(now, pickle.HIGHEST_PROTOCOL)

    def restore(self, saved: bytes) -> None:
        """Go on from what `save` has returned."""
        drives, self._closed[:], self.with_.measured = pickle.loads(saved)
        self._drives.restore(drives)

    def take_measurement(self, plant: Plant) -> None:
        """Take the measurement of this tick before its step, for a target that follows from it."""
        self._calls.servo_step_measure(self.with_, plant.ticks)
