"""A shared library of a user's with control code: what core/firmware.h asks of it, checked."""

from __future__ import annotations

import ctypes
from pathlib import Path

from compiled.elf import why_no_library
from compiled.unit import address
from emulator_node.core_calls import JointDescription
from emulator_node.firmware_loop import firmware_loop
from emulator_node.plant import Plant
from words.refusal import Refusal
from words.text_file import read_bytes

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


class Firmware:
    """Control code of a user's, as a step of `FirmwareLoop`.

    Attributes:
        name: of its file, for refusals.
        step: address of the step.
        with_: address that it gets.

    Args:
        file: the shared library.

    Raises:
        Refusal: no such file, no shared library for this machine, one without the entry point, of
            another version, or without a step.
    """

    def __init__(self, file: Path) -> None:
        self.name = file.name
        reason = why_no_library(read_bytes(file, LARGEST), (ENTRY,))
        if reason:
            raise Refusal(self.name, "file", f"be a shared library with {ENTRY}", reason)
        try:
            self._library = ctypes.CDLL(str(file.resolve()))
        except OSError as error:
            raise Refusal(self.name, "file", "be loaded by the system", error) from None
        entry = getattr(self._library, ENTRY)
        entry.restype, entry.argtypes = ctypes.c_void_p, []
        at = entry()
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
        reason = start(ctypes.addressof(self._machine))
        if reason is not None:
            said = reason.decode(errors="replace")
            raise Refusal(self.name, "start", f"take scene {plant.scene.name}", said)
