"""A shared library of a user's with control code, checked for what firmware.h asks of it."""

from __future__ import annotations

import contextlib
import ctypes
import enum
import os
from collections.abc import Iterator
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.text_file import read_bytes
from arm_emulator.build.elf import why_no_library
from arm_emulator.build.unit import address
from arm_emulator.machine.control_code import ControlCode
from arm_emulator.machine.core_calls import JointDescription
from arm_emulator.machine.firmware_loop import LoopStruct, firmware_loop
from arm_emulator.machine.plant import Plant

ENTRY = "arm_firmware"
VERSION = 1  # of firmware.h
LARGEST = 2**28  # bytes of a library


class _MachineStruct(ctypes.Structure):
    """``firmware_machine``."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("joints", ctypes.c_int32),
        ("period", ctypes.c_int64),
        ("supply_voltage", ctypes.c_double),
        ("joint", ctypes.c_void_p),
    )


class _FirmwareStruct(ctypes.Structure):
    """``firmware``."""

    _fields_ = (
        ("version", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("start", ctypes.c_void_p),
        ("step", ctypes.c_void_p),
    )


class Doing(enum.IntEnum):
    """Whose code runs, and what of it."""

    OURS = 0
    LOADING = 1
    ENTRY = 2
    START = 3
    STEP = 4
    ENDING = 5
    ENDED = 6

    @property
    def must(self) -> tuple[str, str]:
        """What must do what, where the process ends there."""
        return {
            Doing.OURS: ("a thread of it", "let the process go on"),
            Doing.LOADING: ("file", "be loaded by the system"),
            Doing.ENTRY: (ENTRY, "return"),
            Doing.START: ("start", "return"),
            Doing.STEP: ("step", "return"),
            Doing.ENDING: ("what runs at its end", "return"),
            Doing.ENDED: ("a thread of it", "let the process go on"),
        }[self]


class Progress(ctypes.Structure):
    """Where a run with a library is, for whoever watches it."""

    _fields_ = (("doing", ctypes.c_int32), ("code", ctypes.c_int32), ("loop", LoopStruct))


class Firmware(ControlCode):
    """Control code of a user's, as a step of `FirmwareLoop`.

    Attributes:
        name: of its file, for refusals.
        step: address of the step.
        with_: address that it gets.

    Args:
        file: the shared library.
        progress: gets what of the library runs.

    Raises:
        Refusal: no such file, no shared library for this machine, one without the entry point, of
            another version, or without a step.
    """

    def __init__(self, file: Path, progress: Progress | None = None) -> None:
        self.name = file.name
        self.progress = progress or Progress()
        reason = why_no_library(read_bytes(file, LARGEST), (ENTRY,))
        if reason:
            raise Refusal(self.name, "file", f"be a shared library with {ENTRY}", reason)
        self.progress.doing = Doing.LOADING
        self._threads = _threads()
        try:
            self._library = ctypes.CDLL(str(file.resolve()))
        except OSError as error:
            raise Refusal(self.name, "file", "be loaded by the system", error) from None
        entry = getattr(self._library, ENTRY)
        entry.restype, entry.argtypes = ctypes.c_void_p, []
        self.progress.doing = Doing.ENTRY
        at = entry()
        self.progress.doing = Doing.OURS
        if not at:
            raise Refusal(self.name, ENTRY, "return what the library does", "a null pointer")
        version = ctypes.c_uint32.from_address(at).value
        if version != VERSION:
            raise Refusal(self.name, "version", f"be {VERSION}, that of firmware.h", version)
        self._firmware = _FirmwareStruct.from_address(at)
        if not self._firmware.step:
            raise Refusal(self.name, "step", "be a function", "a null pointer")
        self.step = address(firmware_loop(), "firmware_loop_step")
        self.with_ = at
        self.struct = self.progress.loop

    def start(self, plant: Plant, period_ns: int) -> None:
        """Tell the code which machine it is to drive.

        Raises:
            Refusal: it says that this machine is none for it.
        """
        if not self._firmware.start:
            return
        N = len(plant.scene.joints)
        self._joints = (JointDescription * N)()  # the code may keep a pointer
        for index, joint in enumerate(self._joints):
            joint.size = ctypes.sizeof(joint)
            plant.core.arm_describe_joint(index, ctypes.byref(joint))
        self._machine = _MachineStruct(
            ctypes.sizeof(_MachineStruct),
            N,
            period_ns,
            plant.scene.supply_voltage,
            ctypes.addressof(self._joints),
        )
        start = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_void_p)(self._firmware.start)
        self.progress.doing = Doing.START
        reason = start(ctypes.addressof(self._machine))
        self.progress.doing = Doing.OURS
        if reason is not None:
            said = reason.decode(errors="replace")
            raise Refusal(self.name, "start", f"take scene {plant.scene.name}", said)

    @contextlib.contextmanager
    def stepping(self) -> Iterator[None]:
        """Within, whoever watches the library knows that it is in its steps."""
        self.progress.doing = Doing.STEP
        try:
            yield
        finally:
            self.progress.doing = Doing.OURS

    def close(self) -> None:
        """Run what the library does at its end, unless threads of it still run; it is gone then."""
        if _threads() > self._threads:
            return
        self.progress.doing = Doing.ENDING
        ctypes.CDLL(None).dlclose(ctypes.c_void_p(self._library._handle))
        self.progress.doing = Doing.OURS


def _threads() -> int:
    return len(os.listdir("/proc/self/task"))
