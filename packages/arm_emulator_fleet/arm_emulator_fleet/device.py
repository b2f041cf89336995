"""Memory and kernels of a device: a card, or the processor in its place."""

from __future__ import annotations

import ctypes
import weakref
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from arm_emulator.extension.base import Refusal, check_count

LARGEST_MEMORY = 2**62  # bytes; more than any device has
LARGEST_GRID = 2**31 - 1  # blocks
LARGEST_BLOCK = 1024  # threads
DEFAULT_BLOCK = 64  # threads; 32 to 128 were equally fast


class DeviceError(RuntimeError):
    """A device failed at its work, for a reason that no argument explains.

    Attributes:
        function: of the driver, that reported it.
        code: as the driver numbers it.

    Args:
        function: see there.
        code: see there.
        text: name and meaning of the code.
    """

    def __init__(self, function: str, code: int, text: str) -> None:
        super().__init__(f"{function}: {text}")
        self.function, self.code = function, code


class Memory:
    """Bytes on a device. They are freed when nothing refers to them any more.

    Attributes:
        device: where they are.
        pointer: their address there; 0 for no bytes.
        size: their number.

    Args:
        device: see there.
        pointer: see there.
        size: see there.
        owner: what the bytes belong to, and lives as long as they; None: the device, which frees
            them.
    """

    def __init__(self, device: Device, pointer: int, size: int, owner: object = None) -> None:
        self.device, self.pointer, self.size = device, pointer, size
        self._owner = owner
        if owner is None and size:
            # When the process ends, so does the memory.
            weakref.finalize(self, device.free, pointer).atexit = False

    def __repr__(self) -> str:
        return f"<{self.size} bytes on {self.device.name}>"

    def __copy__(self) -> Memory:
        raise Refusal("Memory", "memory", "be copied by its device", "copy", "Device.copy")

    def __reduce__(self) -> tuple[Any, ...]:
        raise Refusal("Memory", "memory", "stay on its device", "pickle", "Device.read")

    def check_range(self, where: str, offset: int, size: int) -> int:
        """Return the address of bytes of this memory.

        Raises:
            Refusal: they go beyond it.
        """
        offset = check_count(where, "offset", offset, 0, self.size)
        if size > self.size - offset:
            rule = f"fit into {self.size} bytes from byte {offset} on"
            raise Refusal(where, "data", rule, f"{size} bytes")
        return self.pointer + offset


class DevicePointer(Protocol):
    """A pointer for kernels: `Memory` and `DeviceArray`."""

    @property
    def device(self) -> Device: ...  # noqa: D102
    @property
    def pointer(self) -> int: ...  # noqa: D102


# A pointer, int64_t, double, a struct's bytes, or a number of the type that NumPy gives it.
Argument = DevicePointer | int | float | bytes | np.generic


class Device(ABC):
    """A card, or the processor in its place: the same calls, the same refusals.

    All work is in the order of the calls. A launch may return before it is done; `read` waits.

    Attributes:
        name: of the hardware.
        architecture: what kernels are compiled for, as sm_90; "native" for the processor.
        units: that work at the same time: multiprocessors, cores.
        dlpack: kind and index, as DLPack numbers devices.
    """

    name: str
    architecture: str
    units: int
    dlpack: tuple[int, int]

    def allocate(self, size: int) -> Memory:
        """Return new memory, with any content.

        Args:
            size: bytes.

        Raises:
            Refusal: no such number, or the device has no room for them.
        """
        size = check_count("Device.allocate", "size", size, 0, LARGEST_MEMORY)
        return self._allocate_memory(size) if size else Memory(self, 0, 0)

    def write(self, memory: Memory, array: NDArray[Any], offset: int = 0) -> None:
        """Copy an array of NumPy to the device.

        Args:
            memory: where to.
            array: its numbers, in C's order.
            offset: of the first byte.

        Raises:
            Refusal: it does not fit, or belongs to another device.
            DeviceError: work before it failed.
        """
        where = "Device.write"
        data = np.ascontiguousarray(array)
        target = self._find_address(where, memory, offset, data.nbytes)
        if data.nbytes:
            self._copy_in(target, data.ctypes.data, data.nbytes)

    def read(
        self, memory: Memory, dtype: DTypeLike, shape: Sequence[int], offset: int = 0
    ) -> NDArray[Any]:
        """Return a copy of numbers on the device as an array of NumPy, after all work before.

        Args:
            memory: where they are.
            dtype: of the numbers.
            shape: of the array.
            offset: of the first byte.

        Raises:
            Refusal: there are not so many, or they are on another device.
            DeviceError: work before it failed.
        """
        where = "Device.read"
        data = np.empty(tuple(shape), dtype)
        source = self._find_address(where, memory, offset, data.nbytes)
        if data.nbytes:
            self._copy_out(data.ctypes.data, source, data.nbytes)
        return data

    def copy(self, target: Memory, source: Memory, size: int, to: int = 0, since: int = 0) -> None:
        """Copy bytes from memory of this device to memory of this device.

        Args:
            target: where to.
            source: where from; it must not overlap.
            size: bytes.
            to: offset in `target`.
            since: offset in `source`.

        Raises:
            Refusal: see `write`.
            DeviceError: see `write`.
        """
        where = "Device.copy"
        size = check_count(where, "size", size, 0, LARGEST_MEMORY)
        first = self._find_address(where, target, to, size)
        second = self._find_address(where, source, since, size)
        if size:
            self._copy_within(first, second, size)

    def fill(self, memory: Memory, byte: int, offset: int = 0, size: int | None = None) -> None:
        """Set bytes to a value.

        Args:
            memory: where they are.
            byte: the value, 0 to 255.
            offset: of the first byte.
            size: their number; None: all after `offset`.

        Raises:
            Refusal: see `write`.
            DeviceError: see `write`.
        """
        where = "Device.fill"
        byte = check_count(where, "byte", byte, 0, 255)
        size = memory.size - offset if size is None else check_count(where, "size", size)
        target = self._find_address(where, memory, offset, size)
        if size > 0:
            self._fill_memory(target, byte, size)

    @abstractmethod
    def load(self, image: bytes | Path) -> Module:
        """Return kernels that were compiled for this device.

        Args:
            image: its bytes or its file: PTX or cubin for a card, a shared library for the
                processor.

        Raises:
            Refusal: the device cannot load it.
        """

    @abstractmethod
    def set_stack(self, size: int) -> None:
        """Let each thread have at least so many bytes of stack.

        Raises:
            Refusal: that is too much.
        """

    @abstractmethod
    def synchronize(self, stream: int | None = None) -> None:
        """Wait until all work is done.

        Args:
            stream: of CUDA, to wait for that alone; None: for all.

        Raises:
            DeviceError: it failed.
        """

    @abstractmethod
    def has_address(self, pointer: int) -> bool:
        """Return whether this device has memory at an address."""

    @abstractmethod
    def free(self, pointer: int) -> None:
        """Free memory; `Memory` calls it."""

    @abstractmethod
    def _allocate_memory(self, size: int) -> Memory: ...
    @abstractmethod
    def _copy_in(self, target: int, host: int, size: int) -> None: ...
    @abstractmethod
    def _copy_out(self, host: int, source: int, size: int) -> None: ...
    @abstractmethod
    def _copy_within(self, target: int, source: int, size: int) -> None: ...
    @abstractmethod
    def _fill_memory(self, target: int, byte: int, size: int) -> None: ...

    def _find_address(self, where: str, memory: Memory, offset: int, size: int) -> int:
        check_device(where, self, memory)
        return memory.check_range(where, offset, size)


class Module(ABC):
    """Kernels on a device.

    A kernel is an ``extern "C"`` function. On a card its first parameter is the number of threads
    (int64_t), and the arguments follow; the last block has threads beyond that number, which must
    return at once. On the processor it is
    ``void NAME(int64_t first, int64_t threads, void** arguments)``. This function loops over
    threads from `first` on, with pointers to the arguments.

    Attributes:
        device: where they run.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._kernels: dict[str, Any] = {}

    def launch(
        self,
        kernel: str,
        threads: int,
        *arguments: Argument,
        block: int = DEFAULT_BLOCK,
    ) -> None:
        """Start a kernel on threads; it may be running when this returns.

        Args:
            kernel: its name.
            threads: their number; 0: nothing happens.
            arguments: memory or an array (its pointer), int (int64_t), float (double), bytes (a
                struct), a number of NumPy's types (that type).
            block: threads of a block, on a card.

        Raises:
            Refusal: no such kernel, or an argument that no kernel takes.
            DeviceError: the device cannot start it, or work before it failed.
        """
        where = "Module.launch"
        block = check_count(where, "block", block, 1, LARGEST_BLOCK)
        threads = check_count(where, "threads", threads, 0, LARGEST_GRID * block)
        packed = _pack_arguments(where, self.device, arguments)
        handle = self._find_kernel(where, kernel)
        if threads:
            self._launch_kernel(handle, threads, packed, block)

    def describe(self, kernel: str) -> dict[str, int]:
        """Return what a kernel needs of a card: registers, bytes of stack, of shared memory.

        Raises:
            Refusal: no such kernel.
        """
        return self._describe_kernel(self._find_kernel("Module.describe", kernel))

    @abstractmethod
    def find_global_memory(self, name: str) -> Memory:
        """Return a variable of the kernels' source.

        Raises:
            Refusal: no variable has that name.
        """

    @abstractmethod
    def _look_up(self, kernel: str) -> Any:
        """Return what starts a kernel, or None."""

    @abstractmethod
    def _launch_kernel(
        self, handle: Any, threads: int, packed: ctypes.Array[Any], block: int
    ) -> None: ...

    def _describe_kernel(self, handle: Any) -> dict[str, int]:
        return {}

    def _find_kernel(self, where: str, kernel: str) -> Any:
        if kernel not in self._kernels:
            function = self._look_up(kernel)
            if function is None:
                raise Refusal(where, "kernel", "be in the module", kernel)
            self._kernels[kernel] = function
        return self._kernels[kernel]


def check_device(where: str, device: Device, pointer: DevicePointer) -> None:
    """Refuse memory of another device.

    Raises:
        Refusal: it is that.
    """
    if pointer.device is not device:
        raise Refusal(where, "memory", f"be on {device.name}", f"memory on {pointer.device.name}")


def _pack_arguments(where: str, device: Device, arguments: Sequence[Argument]) -> ctypes.Array[Any]:
    """Return pointers to arguments; ctypes keeps the arguments as long as the pointers."""
    pointers = (ctypes.c_void_p * len(arguments))()
    places = [_pack_argument(where, device, argument) for argument in arguments]
    for index, place in enumerate(places):
        pointers[index] = ctypes.addressof(place)
    pointers.places = places  # type: ignore[attr-defined]
    return pointers


def _pack_argument(where: str, device: Device, argument: Argument) -> Any:
    if isinstance(argument, np.generic):
        argument = argument.tobytes()
    if isinstance(argument, bytes) and argument:
        return ctypes.create_string_buffer(argument, len(argument))
    if isinstance(argument, int) and not isinstance(argument, bool):
        return ctypes.c_int64(check_count(where, "argument", argument, -(2**63)))
    if isinstance(argument, float):
        return ctypes.c_double(argument)
    if isinstance(getattr(argument, "device", None), Device):
        check_device(where, device, argument)  # type: ignore[arg-type]
        return ctypes.c_uint64(argument.pointer)  # type: ignore[union-attr]
    valid = "Memory, DeviceArray, int, float, bytes, a number of NumPy"
    raise Refusal(where, "argument", "be one that a kernel takes", repr(argument), valid)
