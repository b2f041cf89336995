"""The processor in the place of a card: kernels are loops over threads in a shared library."""

from __future__ import annotations

import ctypes
import os
import tempfile
import weakref
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.extension.base import Refusal, check_count
from arm_emulator.extension.compiler import CData, Header, Library, c_text
from arm_emulator_fleet.device import LARGEST_MEMORY, Device, Memory, Module
from arm_emulator_fleet.work_threads import WorkThreads

ALIGNMENT = 256  # bytes, as a card aligns memory
PROCESSOR = 1, 0  # kDLCPU
MAX_COUNTS = 8  # numbers of threads whose shares are remembered
KERNEL = "void (*)(int64_t, int64_t, void **)"


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

    def synchronize(self, stream: int | None = None) -> None:  # noqa: D102
        pass

    def has_address(self, pointer: int) -> bool:  # noqa: D102
        return True

    def free(self, pointer: int) -> None:  # noqa: D102
        raise AssertionError("memory of the processor is NumPy's")

    def get_work_threads(self, threads: int) -> WorkThreads:
        """Return the division of a launch among cores, which learns from earlier launches."""
        key = os.getpid(), threads  # a fork has none of its parent's threads
        if key not in self._shares:
            while len(self._shares) >= MAX_COUNTS:
                self._shares.pop(next(iter(self._shares))).end_threads()
            self._shares[key] = WorkThreads(threads, 1, self.units)
        return self._shares[key]

    def _allocate_memory(self, size: int) -> Memory:
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

    def _fill_memory(self, target: int, byte: int, size: int) -> None:
        ctypes.memset(target, byte, size)


class ProcessorModule(Module):
    """A shared library of kernels, unloaded when nothing refers to them any more.

    Each module has variables of its own, as on a card, even if another is of the same file.

    Args:
        device: the processor.
        image: see `Device.load`.

    Raises:
        Refusal: see there.
    """

    def __init__(self, device: ProcessorDevice, image: bytes | Path) -> None:
        super().__init__(device)
        self._processor = device
        try:
            content = image if isinstance(image, bytes) else image.read_bytes()
            self._library = _load_copy(content)
        except OSError as error:
            rule = "be a shared library of kernels"
            raise Refusal("Device.load", "image", rule, error) from None
        weakref.finalize(self, _load_loader().dlclose, self._library).atexit = False

    def find_global_memory(self, name: str) -> Memory:  # noqa: D102
        address = _load_loader().dlsym(self._library, name.encode())
        if not address:
            raise Refusal("Module.find_global_memory", "name", "be in the module", name)
        place = int(_LOADER.ffi.cast("uintptr_t", address))
        return Memory(self.device, place, _measure_symbol(address), self)

    def _look_up(self, kernel: str) -> Any:
        address = _load_loader().dlsym(self._library, kernel.encode())
        return _LOADER.ffi.cast(KERNEL, address) if address else None

    def _launch_kernel(
        self, kernel: CData, threads: int, packed: ctypes.Array[Any], block: int
    ) -> None:
        arguments = _LOADER.ffi.cast("void **", ctypes.addressof(packed))
        work = self._processor.get_work_threads(threads)
        work.do_work(threads, lambda first, count: kernel(first, count, arguments))


_LOADER = Header(Path(__file__).with_name("dynamic_loader.h"))


@cache
def _load_loader() -> Library:
    return Library("libc.so.6", [_LOADER])


def _load_copy(content: bytes) -> CData:
    """Return a library that shares nothing with others of the same content.

    The loader knows libraries by path and by inode, so both are new. The copy is in memory, since
    temporary folders may forbid to run what is in them.

    Raises:
        OSError: it is no library.
    """
    loader = _load_loader()
    copy = os.memfd_create("kernels")
    try:
        with open(copy, "wb", closefd=False) as file:
            file.write(content)
        with tempfile.TemporaryDirectory() as folder:
            link = Path(folder, "kernels.so")
            link.symlink_to(f"/proc/self/fd/{copy}")
            library = loader.dlopen(bytes(link), _LOADER.get_constant("RTLD_NOW"))
            if not library:
                raise OSError(c_text(loader.dlerror()))
            return library
    finally:
        os.close(copy)


def _measure_symbol(address: CData) -> int:
    """Return the size of a variable of a loaded library [bytes]."""
    about, entry = _LOADER.ffi.new("Dl_info *"), _LOADER.ffi.new("void **")
    loader, kind = _load_loader(), _LOADER.get_constant("RTLD_DL_SYMENT")
    if not loader.dladdr1(address, about, entry, kind) or not entry[0]:
        return 0
    return int(_LOADER.ffi.cast("Elf64_Sym *", entry[0]).st_size)
