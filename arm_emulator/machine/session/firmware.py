"""A user's shared library with control code, checked against firmware.h."""

import contextlib
import ctypes
import enum
import mmap
import os
from collections.abc import Iterator
from pathlib import Path

from arm_emulator.base.io.text_file import read_bytes
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.core_calls import ARM, FIRMWARE
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.control_code import ControlCode
from arm_emulator.tick.c import FIRMWARE_CONTROLLER, tick_calls
from arm_emulator.toolchain.c_header import CData, Library, read_text
from arm_emulator.toolchain.elf import (
    explain_no_library,
    find_address,
    list_called_functions,
    list_written_memory,
)

ENTRY = "arm_firmware"
VERSION = FIRMWARE.get_constant("FIRMWARE_VERSION")
LARGEST = 2**28  # bytes of a library


class RunningCode(enum.IntEnum):
    """The code that runs, and its function."""

    OURS = 0
    LOADING = 1
    ENTRY = 2
    START = 3
    STEP = 4
    ENDING = 5
    ENDED = 6

    @property
    def must(self) -> tuple[str, str]:
        """Quantity and rule of the refusal if the process ends there."""
        return {
            RunningCode.OURS: ("a thread of it", "let the process go on"),
            RunningCode.LOADING: ("file", "be loaded by the system"),
            RunningCode.ENTRY: (ENTRY, "return"),
            RunningCode.START: ("start", "return"),
            RunningCode.STEP: ("step", "return"),
            RunningCode.ENDING: ("what runs at its end", "return"),
            RunningCode.ENDED: ("a thread of it", "let the process go on"),
        }[self]


def make_progress(memory: mmap.mmap | None = None) -> CData:
    """Return a ``firmware_progress``, in memory that others share if some is given."""
    if memory is None:
        return FIRMWARE_CONTROLLER.make_struct("firmware_progress")
    return FIRMWARE_CONTROLLER.ffi.from_buffer("firmware_progress *", memory)


class Firmware(ControlCode):
    """Control code of a user's, as a step of `FirmwareLoop`.

    Attributes:
        name: of its file, for refusals.
        step: the function of the step.
        with_: pointer that it gets.

    Args:
        file: the shared library.
        progress: gets what of the library runs.

    Raises:
        Refusal: no such file, no shared library for this machine, one without the entry point, of
            another version, or without a step.
    """

    def __init__(self, file: Path, progress: CData | None = None) -> None:
        self.name = file.name
        self.progress = progress or make_progress()
        content = read_bytes(file, LARGEST)
        reason = explain_no_library(content, (ENTRY,))
        if reason:
            raise Refusal(self.name, "file", f"be a shared library with {ENTRY}", reason)
        self.progress.doing = RunningCode.LOADING
        self._threads = _count_threads()
        try:
            self._library = Library(file.resolve(), (FIRMWARE,), unload=True)
        except OSError as error:
            raise Refusal(self.name, "file", "be loaded by the system", error) from None
        entry = int(FIRMWARE.ffi.cast("uintptr_t", self._library.arm_firmware))
        self._memory = LibraryMemory(self.name, content, ENTRY, entry)
        self.progress.doing = RunningCode.ENTRY
        at = self._library.arm_firmware()
        self.progress.doing = RunningCode.OURS
        if not at:
            raise Refusal(self.name, ENTRY, "return the library's functions", "a null pointer")
        if at.version != VERSION:
            raise Refusal(self.name, "version", f"be {VERSION}, that of firmware.h", at.version)
        if not at.step:
            raise Refusal(self.name, "step", "be a function", "a null pointer")
        self.step = tick_calls().firmware_controller_step
        self._firmware, self.with_ = at, FIRMWARE.ffi.cast("void *", at)
        self.struct = FIRMWARE_CONTROLLER.ffi.addressof(self.progress, "controller")

    def start_on(self, plant: Plant, period_ns: int) -> None:
        """Pass the machine's description to the code.

        Raises:
            Refusal: it cannot drive this machine, by its own statement.
        """
        if not self._firmware.start:
            return
        N = len(plant.scene.joints)
        self._joints = ARM.make_rows("arm_joint_description", N)  # the code may keep a pointer
        self._joints["size"] = ARM.get_size("arm_joint_description")
        described = ARM.make_pointer("arm_joint_description", self._joints)
        for index in range(N):
            plant.core.arm_describe_joint(index, described + index)
        self._machine = FIRMWARE.make_struct(
            "firmware_machine",
            joints=N,
            period=period_ns,
            supply_voltage=plant.scene.supply_voltage,
            joint=self._joints,
        )
        self.progress.doing = RunningCode.START
        reason = self._firmware.start(self._machine)
        self.progress.doing = RunningCode.OURS
        if reason:
            raise Refusal(self.name, "start", f"take scene {plant.scene.name}", read_text(reason))

    def save(self) -> bytes:
        """Return the variables of the library.

        Raises:
            Refusal: see `LibraryMemory.save`.
        """
        return self._memory.save()

    def restore(self, saved: bytes) -> None:
        """Set the variables of the library to what `save` has returned."""
        self._memory.restore(saved)

    @contextlib.contextmanager
    def mark_steps(self) -> Iterator[None]:
        """Context that shows an observer that the library runs its steps."""
        self.progress.doing = RunningCode.STEP
        try:
            yield
        finally:
            self.progress.doing = RunningCode.OURS

    def close(self) -> None:
        """Unload the library, unless threads of it still run."""
        if _count_threads() > self._threads:
            return
        self.progress.doing = RunningCode.ENDING
        self._library.close()
        self.progress.doing = RunningCode.OURS


def _count_threads() -> int:
    return len(os.listdir("/proc/self/task"))


# Functions of others that remember nothing.
_MATHEMATICS = """acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp
    exp2 expm1 fabs fdim floor fma fmax fmin fmod frexp hypot ilogb ldexp llrint llround log log10
    log1p log2 logb lrint lround modf nearbyint nextafter pow remainder remquo rint round scalbln
    scalbn sin sincos sinh sqrt tan tanh tgamma trunc""".split()
_FORGETFUL = {
    *(f"{name}{kind}" for name in _MATHEMATICS for kind in ("", "f", "l")),
    *"abs labs llabs memchr memcmp memcpy memmove memset strcmp strlen strncmp".split(),
    *"__memcpy_chk __memmove_chk __memset_chk __stack_chk_fail".split(),
    *"__cxa_atexit __cxa_guard_acquire __cxa_guard_release __cxa_pure_virtual".split(),
}


class LibraryMemory:
    """Variables of a loaded library, in functions and outside of them.

    Args:
        name: of its file, for refusals.
        content: of the file.
        known: name of one of its functions.
        at: address of that in memory.
    """

    def __init__(self, name: str, content: bytes, symbol: str, at: int) -> None:
        self._name = name
        base = at - find_address(content, symbol)
        self._pieces = [(base + begin, size) for begin, size in list_written_memory(content)]
        self._others = list_called_functions(content) - _FORGETFUL

    def save(self) -> bytes:
        """Return the variables as they are now.

        Raises:
            Refusal: the library may remember more than its variables.
        """
        if self._others or not self._pieces:
            actual = ", ".join(sorted(self._others)) if self._pieces else "variables of threads"
            rule = "remember nothing but its variables, to be saved"
            valid = "control code that calls mathematics and memcpy alone; or a run from its start"
            raise Refusal(self._name, "the library", rule, actual, valid)
        return b"".join(ctypes.string_at(begin, size) for begin, size in self._pieces)

    def restore(self, saved: bytes) -> None:
        """Set the variables to what `save` has returned."""
        for begin, size in self._pieces:
            ctypes.memmove(begin, saved[:size], size)
            saved = saved[size:]
