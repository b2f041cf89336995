"""A microcontroller with firmware as control code of a `FirmwareLoop`: core/runner.h."""

import socket
import zlib
from functools import cache

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    SHARED_FLAGS,
    CData,
    Library,
    Unit,
    c_text,
    compiled_library,
)
from arm_emulator.extension.machine import ControlCode, Scene
from arm_emulator_firmware import CORE_FOLDER
from arm_emulator_firmware.board import RUNNER, Board, make_board_struct
from arm_emulator_firmware.elf_image import ElfImage
from arm_emulator_firmware.unicorn_library import (
    find_headers,
    load_unicorn,
    read_version,
)

FLAGS = (*"-std=c++20 -O2 -fvisibility=hidden -ffp-contract=off".split(), *SHARED_FLAGS)


class FirmwareEnd(RuntimeError):
    """Raised when the firmware cannot continue, or a debugger has ended it; one line."""


def make_runner_unit() -> Unit:
    """Return the runner as a unit to compile.

    Raises:
        Refusal: Unicorn is not installed.
    """
    source = f'#include "runner.cpp"\n// with Unicorn {read_version()}\n'
    folders = (CORE_FOLDER, BOUNDARY_FOLDER, find_headers())
    about, part = "the microcontroller's runner", "runner.cpp"
    headers, where = (RUNNER,), "microcontroller"
    return Unit("microcontroller", source, FLAGS, folders, headers, where, about, part)


@cache
def _load_runner() -> Library:
    load_unicorn()
    return compiled_library(make_runner_unit())


class Microcontroller(ControlCode):
    """Firmware on a board, wired to a scene's machine.

    Attributes:
        name: of the firmware's file, for refusals.
        step: the function of the step.
        with_: pointer that it gets.
        stop: where the loop reads that the firmware has ended.

    Args:
        board: wiring of its registers.
        image: the firmware.
        scene: the machine.
        uarts: file descriptors to write to and to read from, of each serial line that has some.

    Raises:
        Refusal: the firmware does not fit into the board's memory, or Unicorn is missing.
    """

    def __init__(
        self,
        board: Board,
        image: ElfImage,
        scene: Scene,
        uarts: dict[str, tuple[int, int]] | None = None,
    ) -> None:
        self.name = image.name
        self._image = image
        self._calls = _load_runner()
        reported, self._referenced = make_board_struct(board, scene, uarts or {})
        why = RUNNER.ffi.new("char[]", 120)
        self.with_ = self._calls.mcu_new(reported, why)
        if not self.with_:
            raise Refusal(board.where, "board", "be one that Unicorn runs", c_text(why))
        for at, piece in image.pieces:
            if not self._calls.mcu_load(self.with_, at, piece, len(piece)):
                regions = ", ".join(
                    f"{region.name} {region.at:#x} to {region.at + region.size:#x}"
                    for region in board.regions
                    if region.kind != "registers"
                )
                size = f"{len(piece)} bytes at {at:#x}"
                raise Refusal(image.name, "what is loaded", "fit into the memory", size, regions)
        self.step = self._calls.mcu_step
        self.stop = self._calls.mcu_stopped(self.with_)

    def __del__(self) -> None:
        if getattr(self, "with_", None):
            self._calls.mcu_delete(self.with_)

    def save(self) -> bytes:
        """Return the chip as it is now: processor, memory and devices, compressed.

        Raises:
            Refusal: a debugger is connected, or bytes of a serial line go in or out.
        """
        if refusal := self._calls.mcu_unkept(self.with_):
            rule, valid = "be one that can be saved: without debugger and wired serial lines", ""
            raise Refusal(self.name, "the chip", rule, c_text(refusal), valid)
        size = RUNNER.ffi.new("int64_t *")
        saved = self._calls.mcu_save(self.with_, size)
        return zlib.compress(RUNNER.ffi.buffer(saved, size[0]), 1)

    def restore(self, saved: bytes) -> None:
        """Go on from what `save` of this chip has returned, to the last bit."""
        self._calls.mcu_restore(self.with_, zlib.decompress(saved))

    def wait_for_debugger(self, listening: socket.socket) -> None:
        """Wait for gdb at a socket that listens, and let it halt the processor."""
        self._calls.mcu_debug(self.with_, listening.fileno())

    def break_at(self, flag: CData) -> None:
        """Let gdb halt the processor when an ``int32_t`` in C is not 0, which must outlive it."""
        self._calls.mcu_break(self.with_, flag)

    @property
    def ended(self) -> FirmwareEnd | None:
        """Reason for the end of the firmware, None while it runs."""
        if not self.stop[0]:
            return None
        return FirmwareEnd(f"{self.name}: {self.fault or 'ended by the debugger'}")

    @property
    def fault(self) -> str:
        """The fault that ended the firmware, or the first one it handled itself; "" for none."""
        fault = RUNNER.make_struct("mcu_fault")
        self._calls.mcu_get_fault(self.with_, fault)
        if not c_text(fault.what):
            return ""
        symbol = self._image.find_symbol(fault.pc)
        at = f"{fault.pc:#010x}" + (f" in {symbol}" if symbol else "")
        return f"{c_text(fault.what)}, pc {at}, at {fault.time:.9g} s"

    @property
    def figures(self) -> CData:
        """Counters of the processor so far, as ``mcu_figures``."""
        figures = RUNNER.make_struct("mcu_figures")
        self._calls.mcu_get_figures(self.with_, figures)
        return figures
