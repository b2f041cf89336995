"""Arrays of numbers that stay on a device, shared with other libraries without a copy."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from arm_emulator.extension.base import Refusal, check_count
from arm_emulator_fleet.device import Device, Memory
from arm_emulator_fleet.dlpack import IS_COPIED, KINDS, VERSION, make_capsule, read_capsule
from arm_emulator_fleet.processor_device import PROCESSOR

LEGACY_STREAM = 1  # in which all work of ours is, as DLPack and CUDA's array interface number it
NO_WAITING = -1  # as DLPack numbers it
LIBRARY_ERRORS = (BufferError, TypeError, ValueError, RuntimeError)  # what arrays of others raise


class DeviceArray:
    """Numbers on a device, in C's order.

    Other libraries take it without a copy: ``numpy.from_dlpack(array)`` on the processor, and
    ``torch.from_dlpack(array)``, ``jax.dlpack.from_dlpack(array)`` or ``cupy.from_dlpack(array)``
    on a card. The memory lives until all of them are done with it.

    Attributes:
        shape: of the array.
        dtype: of the numbers.
        device: where they are.
        memory: that they are in.
        offset: of the first of them in `memory` [bytes].

    Args:
        shape: see there.
        dtype: see there.
        device: see there.
        memory: see there; None: new memory, with any content.
        offset: see there.

    Raises:
        Refusal: no such shape or type, or no room for them.
    """

    def __init__(
        self,
        shape: int | Sequence[int],
        dtype: DTypeLike,
        device: Device,
        *,
        memory: Memory | None = None,
        offset: int = 0,
    ) -> None:
        where = "DeviceArray"
        sizes = [shape] if isinstance(shape, int | np.integer) else list(shape)
        self.shape = tuple(check_count(where, "shape", size) for size in sizes)
        self.dtype = np.dtype(dtype)
        if self.dtype.hasobject:
            raise Refusal(where, "dtype", "be of numbers", self.dtype)
        self.device = device
        self.memory = device.allocate(self.nbytes) if memory is None else memory
        self.memory.check_range(where, offset, self.nbytes)
        self.offset = offset

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of numbers."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Number of bytes."""
        return self.size * self.dtype.itemsize

    @property
    def pointer(self) -> int:
        """Address of the first number on the device."""
        return self.memory.pointer + self.offset

    def __repr__(self) -> str:
        return f"<DeviceArray {self.shape} of {self.dtype} on {self.device.name}>"

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("len() of a DeviceArray without axes")
        return self.shape[0]

    def __iter__(self) -> Iterator[DeviceArray]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, rows: int | slice) -> DeviceArray:
        """Return a row, or rows next to each other, of the same memory.

        Raises:
            Refusal: there is no such row, or the rows are not next to each other.
        """
        where = "DeviceArray"
        count = len(self)
        if isinstance(rows, slice):
            first, end, step = rows.indices(count)
            if step != 1:
                raise Refusal(where, "rows", "be next to each other", rows)
            shape = max(0, end - first), *self.shape[1:]
        else:
            first = check_count(where, "row", rows, -count, count - 1) % count
            shape = self.shape[1:]
        step = self.nbytes // count if count else 0
        offset = self.offset + first * step
        return DeviceArray(shape, self.dtype, self.device, memory=self.memory, offset=offset)

    def __setitem__(self, rows: int | slice, values: object) -> None:
        """Copy values to rows, see `copy_from`."""
        self[rows].copy_from(values)

    def numpy(self) -> NDArray[Any]:
        """Return a copy of the numbers as an array of NumPy.

        Raises:
            DeviceError: work before it failed.
        """
        return self.device.read(self.memory, self.dtype, self.shape, self.offset)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("a DeviceArray is copied to NumPy; numpy.from_dlpack shares it")
        return self.numpy() if dtype is None else self.numpy().astype(dtype, copy=False)

    def copy_from(self, values: object) -> None:
        """Copy numbers to this array.

        Args:
            values: an array of this shape on any device, or what NumPy makes one of; its numbers
                must be of this type, or convert to it without loss of their kind.

        Raises:
            Refusal: another shape, or numbers that do not convert.
            DeviceError: work before it failed.
        """
        where = "DeviceArray.copy_from"
        source = _share_array(self.device, values, to_write=False)
        if source is not None and source.dtype == self.dtype:
            self._check_shape(where, source.shape)
            places = self.offset, source.offset
            if source.memory is not self.memory:
                self.device.copy(self.memory, source.memory, self.nbytes, *places)
                return
        array = _convert_to_numpy(where, values if source is None else source)
        self._check_shape(where, array.shape)
        if not np.can_cast(array.dtype, self.dtype, "same_kind"):
            raise Refusal(where, "values", f"be of type {self.dtype}", array.dtype)
        self.device.write(self.memory, array.astype(self.dtype, copy=False), self.offset)

    def _check_shape(self, where: str, shape: tuple[int, ...]) -> None:
        if shape != self.shape:
            raise Refusal(where, "values", f"have shape {self.shape}", shape)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.device.dlpack

    def __dlpack__(
        self,
        *,
        stream: int | None = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> object:
        """Return this array as a capsule of DLPack, see the Python array API.

        Args:
            stream: of CUDA, in which the consumer uses it; -1: it waits itself.
            max_version: newest version of DLPack that the consumer knows; None: one before 1.0.
            dl_device: where the consumer wants it; None: where it is.
            copy: whether it must be copied; None: only if needed.

        Raises:
            BufferError: it cannot be there, or DLPack has no such numbers.
            Refusal: no such stream.
            DeviceError: work before it failed.
        """
        if dl_device is not None and tuple(dl_device) != self.device.dlpack:
            if tuple(dl_device) != PROCESSOR or copy is False:
                raise BufferError(f"{self.device.name} shares its memory with no other device")
            return self.numpy().__dlpack__(max_version=max_version)
        self._wait_for(stream)
        shared = self
        if copy:
            shared = DeviceArray(self.shape, self.dtype, self.device)
            shared.copy_from(self)
        place = shared.pointer, self.dtype, self.shape, self.device.dlpack
        return make_capsule(shared.memory, *place, max_version, IS_COPIED if copy else 0)

    def _wait_for(self, stream: int | None) -> None:
        """Let a consumer's stream see what was written."""
        if self.device.dlpack == PROCESSOR:
            if stream is not None:
                raise Refusal("DeviceArray", "stream", "be None on the processor", stream)
        elif stream not in (None, NO_WAITING, LEGACY_STREAM):
            check_count("DeviceArray", "stream", stream, NO_WAITING)
            if stream == 0:  # ambiguous, and ruled out by the protocol
                raise Refusal("DeviceArray", "stream", "not be 0", stream, "-1, 1, 2, a handle")
            self.device.synchronize()

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """Version 3 of the interface by which numba, cupy and torch take arrays on a card.

        Raises:
            AttributeError: this array is on the processor.
        """
        if self.device.dlpack == PROCESSOR:
            raise AttributeError("a DeviceArray on the processor is in no memory of CUDA")
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (self.pointer, False),
            "strides": None,
            "stream": LEGACY_STREAM,
            "version": 3,
        }


def convert_to_device_array(
    device: Device, values: object, dtype: DTypeLike | None = None
) -> DeviceArray:
    """Return numbers as an array on a device, without a copy if they are there.

    Args:
        device: where to.
        values: a `DeviceArray`, an array with ``__dlpack__`` or ``__cuda_array_interface__``, or
            what NumPy makes one of.
        dtype: of the numbers; None: theirs.

    Returns:
        An array that shares their memory if they are on the device, in C's order, may be written
        to, and have this type; else a copy.

    Raises:
        Refusal: they are no numbers, or do not convert to the type.
    """
    shared = _share_array(device, values, to_write=True)
    if shared is not None and (dtype is None or shared.dtype == np.dtype(dtype)):
        return shared
    source = _share_array(device, values, to_write=False)
    array = _convert_to_numpy("as_device_array", values) if source is None else source
    copied = DeviceArray(array.shape, array.dtype if dtype is None else dtype, device)
    copied.copy_from(array)
    return copied


def is_device_array(values: object) -> bool:
    """Return whether numbers are an array of this module, or of a library with devices."""
    if isinstance(values, np.ndarray):
        return False
    return hasattr(values, "__dlpack__") or hasattr(values, "__cuda_array_interface__")


def take_array(
    where: str,
    name: str,
    device: Device,
    values: object,
    shape: tuple[int, ...],
    dtype: DTypeLike | None,
) -> DeviceArray:
    """Return an argument as an array on a device, see `convert_to_device_array`.

    Args:
        where: name of the refusal.
        name: of the argument.
        device: where to.
        values: see there.
        shape: that it must have.
        dtype: of the numbers; None: theirs.

    Raises:
        Refusal: another shape, or no numbers of this type.
    """
    array = convert_to_device_array(device, values, dtype)
    if array.shape != shape:
        raise Refusal(where, name, f"have shape {shape}", array.shape)
    return array


def _share_array(device: Device, values: object, to_write: bool) -> DeviceArray | None:
    """Return an array that shares the memory of values on a device; None if it cannot.

    Args:
        device: see there.
        values: see there.
        to_write: whether it will be written to.
    """
    if isinstance(values, DeviceArray):
        return values if values.device is device else None
    if isinstance(values, np.ndarray):
        if device.dlpack != PROCESSOR or values.dtype.kind not in KINDS:
            return None
        if not values.flags.c_contiguous or (to_write and not values.flags.writeable):
            return None
        return _share_memory(device, values.ctypes.data, values.dtype, values.shape, values)
    if hasattr(values, "__dlpack__"):
        return _share_capsule(device, values, to_write)
    if device.dlpack != PROCESSOR and hasattr(values, "__cuda_array_interface__"):
        return _share_interface(device, values, to_write)
    return None


def _share_capsule(device: Device, values: Any, to_write: bool) -> DeviceArray | None:
    # In our stream, before which the producer completes its work.
    stream = {} if device.dlpack == PROCESSOR else {"stream": LEGACY_STREAM}
    try:
        if tuple(map(int, values.__dlpack_device__())) != device.dlpack:
            return None
        try:
            capsule = values.__dlpack__(**stream, max_version=VERSION)
        except TypeError:  # from before DLPack 1.0
            capsule = values.__dlpack__(**stream)
    except LIBRARY_ERRORS:
        return None
    handed = read_capsule(capsule)
    if handed is None or handed.dtype is None or not handed.is_in_order:
        return None
    if to_write and handed.is_read_only:
        return None
    return _share_memory(device, handed.pointer, handed.dtype, handed.shape, capsule)


def _share_interface(device: Device, values: Any, to_write: bool) -> DeviceArray | None:
    interface = values.__cuda_array_interface__
    pointer, read_only = interface["data"]
    if (to_write and read_only) or interface.get("strides") is not None or interface.get("mask"):
        return None
    if pointer and not device.has_address(pointer):
        return None
    if interface.get("stream") is not None:
        device.synchronize(interface["stream"])
    return _share_memory(
        device, pointer, np.dtype(interface["typestr"]), tuple(interface["shape"]), values
    )


def _share_memory(
    device: Device, pointer: int, dtype: np.dtype[Any], shape: Sequence[int], owner: object
) -> DeviceArray:
    memory = Memory(device, pointer, math.prod(shape) * dtype.itemsize, owner)
    return DeviceArray(shape, dtype, device, memory=memory)


def _convert_to_numpy(where: str, values: Any) -> NDArray[Any]:
    """Return numbers from anywhere as an array of NumPy."""
    if isinstance(values, DeviceArray):
        return values.numpy()
    try:
        if hasattr(values, "__dlpack__") and not isinstance(values, np.ndarray):
            return _read_dlpack(values)
        array = np.asarray(values)
    except LIBRARY_ERRORS as error:
        rule = "be an array of numbers, in C's order on a card"
        raise Refusal(where, "values", rule, error) from None
    if array.dtype.kind not in "biufcV":
        raise Refusal(where, "values", "be an array of numbers", f"an array of {array.dtype}")
    return array


def _read_dlpack(values: Any) -> NDArray[Any]:
    kind = int(values.__dlpack_device__()[0])
    if kind == PROCESSOR[0]:
        return np.from_dlpack(values)
    # Since DLPack 1.0 a producer copies to the processor where it is asked to.
    return np.from_dlpack(values, device="cpu", copy=True)
