"""The processor in the place of a card: kernels are loops over threads in a shared library."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.extension.base import Refusal, check_count
from arm_emulator_fleet.device import LARGEST_MEMORY, Device, Memory, Module
from arm_emulator_fleet.work_threads import WorkThreads

ALIGNMENT = 256  # bytes, as a card aligns memory
PROCESSOR = 1, 0  # kDLCPU
MOST_COUNTS = 8  # numbers of threads whose shares are remembered
SYMBOL_ENTRY = 1  # RTLD_DL_SYMENT of <dlfcn.h>


class ProcessorDevice(Device):
    """The processor. A launch has been done when it returns.

    Args:
        workers: threads; None: as many as there are processor cores for this process.

    Raises:
        Refusal: no such number of threads.
    """

    def __init__(self, workers: int | None = None) -> None:
        if workers is None:
            workers = len(os.sched_getaffinity(0))
        self.units = check_count("ProcessorDevice", "workers", workers, 1, 4096)
        self.name, self.architecture, self.dlpack = "processor", "native", PROCESSOR
        self._shares: dict[tuple[int, int], WorkThreads] = {}

    def load(self, image: bytes | Path) -> Module:  # noqa: D102
        return ProcessorModule(self, image)

    def set_stack(self, size: int) -> None:  # noqa: D102
        check_count("Device.set_stack", "size", size, 0, LARGEST_MEMORY)  # threads have megabytes

    def set_heap(self, size: int) -> None:  # noqa: D102
        check_count("Device.set_heap", "size", size, 0, LARGEST_MEMORY)

    def synchronize(self, stream: int | None = None) -> None:  # noqa: D102
        pass

    def has_address(self, pointer: int) -> bool:  # noqa: D102
        return True

    def free(self, pointer: int) -> None:  # noqa: D102
        raise AssertionError("memory of the processor is NumPy's")

    def share(self, threads: int) -> WorkThreads:
        """Return the division of a launch among cores, which learns from earlier launches."""
        key = os.getpid(), threads  # a fork has none of its parent's threads
        if key not in self._shares:
            while len(self._shares) >= MOST_COUNTS:
                self._shares.pop(next(iter(self._shares))).end()
            self._shares[key] = WorkThreads(threads, 1, self.units)
        return self._shares[key]

    def _allocate(self, size: int) -> Memory:
        try:
            array = np.empty(size + ALIGNMENT, np.uint8)
        except (MemoryError, ValueError):
            raise Refusal("Device.allocate", "size", "fit into memory [byte]", size) from None
        address = array.ctypes.data
        return Memory(self, address + -address % ALIGNMENT, size, array)

    def _copy_in(self, target: int, host: int, size: int) -> None:
        ctypes.memmove(target, host, size)

    def _copy_out(self, host: int, source: int, size: int) -> None:
        ctypes.memmove(host, source, size)

    def _copy_within(self, target: int, source: int, size: int) -> None:
        ctypes.memmove(target, source, size)

    def _fill(self, target: int, byte: int, size: int) -> None:
        ctypes.memset(target, byte, size)


class ProcessorModule(Module):
    """A shared library of kernels. It stays loaded.

    Args:
        device: the processor.
        image: see `Device.load`.

    Raises:
        Refusal: see there.
    """

    def __init__(self, device: ProcessorDevice, image: bytes | Path) -> None:
        super().__init__(device)
        self._processor = device
        if isinstance(image, bytes):
            # It stays open: libraries are known by their path, which holds its number.
            opened = os.memfd_create("kernels")
            with open(opened, "wb", closefd=False) as file:
                file.write(image)
            image = Path(f"/proc/self/fd/{opened}")
        try:
            self._library = ctypes.CDLL(str(image))
        except OSError as error:
            rule = "be a shared library of kernels"
            raise Refusal("Device.load", "image", rule, error) from None

    def global_memory(self, name: str) -> Memory:  # noqa: D102
        try:
            found = ctypes.addressof(ctypes.c_char.in_dll(self._library, name))
        except ValueError:
            raise Refusal("Module.global_memory", "name", "be in the module", name) from None
        return Memory(self.device, found, _measure_symbol(found), self)

    def _look_up(self, kernel: str) -> Any:
        try:
            found = self._library[kernel]
        except AttributeError:
            return None
        found.restype = None
        found.argtypes = ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
        return found

    def _launch(
        self, found: Any, threads: int, packed: ctypes.Array[Any], block: int, shared: int
    ) -> None:
        self._processor.share(threads).do(
            threads, lambda first, count: found(first, count, ctypes.addressof(packed))
        )


class _Symbol(ctypes.Structure):
    """Elf64_Sym of <elf.h>."""

    _fields_ = (
        ("name", ctypes.c_uint32),
        ("info", ctypes.c_uint8),
        ("other", ctypes.c_uint8),
        ("section", ctypes.c_uint16),
        ("value", ctypes.c_uint64),
        ("size", ctypes.c_uint64),
    )


def _measure_symbol(address: int) -> int:
    """Return the size of a variable of a loaded library [bytes]."""
    symbol = ctypes.POINTER(_Symbol)()
    about = (ctypes.c_void_p * 4)()  # Dl_info
    find = ctypes.CDLL(None).dladdr1
    found = find(ctypes.c_void_p(address), about, ctypes.byref(symbol), SYMBOL_ENTRY)
    return symbol.contents.size if found and symbol else 0
