"""A card of NVIDIA, through the driver's C interface: neither toolkit nor runtime is needed.

All work is in the legacy default stream of the card's primary context. torch, cupy and jax use the
same context, so that their arrays are valid in our kernels, and ours in theirs.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import weakref
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from arm_emulator.extension.base import Refusal, check_count
from arm_emulator.extension.compiler import C_NULL, CData, Header, Library, c_text
from arm_emulator_fleet.device import (
    LARGEST_MEMORY,
    Device,
    DeviceError,
    Memory,
    Module,
)

LIBRARY = "libcuda.so.1"
DRIVER = Header(Path(__file__).with_name("cuda_driver.h"))
CARD = 2  # kDLCUDA
LONGEST_NAME = 256  # bytes
LONGEST_LOG = 8192  # bytes
OTHERWISE = '"processor"'
REFUSED_IMAGES = (
    "CUDA_ERROR_INVALID_IMAGE",
    "CUDA_ERROR_NO_BINARY_FOR_GPU",
    "CUDA_ERROR_INVALID_PTX",
    "CUDA_ERROR_UNSUPPORTED_PTX_VERSION",
)


def count_cards(where: str) -> int:
    """Return the number of cards of this machine.

    Args:
        where: name in refusals.

    Raises:
        Refusal: there is no driver, or it finds no card.
    """
    return int(_Driver(where).read_result("cuDeviceGetCount", "int *"))


def open_card(where: str, index: int = 0) -> CudaDevice:
    """Return a card; the same object for the same card.

    Args:
        where: name in refusals.
        index: of the card, as the driver counts them.

    Raises:
        Refusal: there is no driver, or no such card.
    """
    if index not in _CARDS:
        count = count_cards(where)
        if not 0 <= index < count:
            valid = ", ".join(f"gpu:{k}" for k in range(count))
            raise Refusal(where, "device", "be a card of this machine", f"gpu:{index}", valid)
        _CARDS.setdefault(index, CudaDevice(_Driver(where), index, where))
    return _CARDS[index]


_CARDS: dict[int, CudaDevice] = {}


class _Driver:
    """The driver's functions; their error codes become exceptions."""

    def __init__(self, where: str) -> None:
        quantity, rule = "device", f'have NVIDIA\'s driver ({LIBRARY}) for "gpu"'
        try:
            self._library = Library(LIBRARY, [DRIVER])
        except OSError as error:
            reason = "none" if "cannot open shared object" in str(error) else error
            raise Refusal(where, quantity, rule, reason, OTHERWISE) from None
        except DRIVER.ffi.error as error:  # older than CUDA 10.2
            raise Refusal(where, quantity, rule, error, OTHERWISE) from None
        try:
            self.call_function("cuInit", 0)
        except DeviceError as error:
            rule = 'be a card that the driver can use for "gpu"'
            raise Refusal(where, quantity, rule, error, OTHERWISE) from None

    def call_function(self, function: str, *arguments: Any) -> None:
        """Call a function of the driver.

        Raises:
            DeviceError: it reports an error.
        """
        code = self.call_quietly(function, *arguments)
        if code:
            texts = [
                self._explain_error(name, code) for name in ("cuGetErrorName", "cuGetErrorString")
            ]
            raise DeviceError(function, code, f"{texts[0] or code} ({texts[1] or 'unknown'})")

    def call_quietly(self, function: str, *arguments: Any) -> int:
        """Call a function of the driver, and return its error code."""
        return int(getattr(self._library, function)(*arguments))

    def read_result(self, function: str, kind: str, *arguments: Any) -> Any:
        """Return what a function of the driver writes to its first argument.

        Args:
            function: its name.
            kind: of its first argument, a pointer.
            arguments: the further ones.

        Raises:
            DeviceError: it reports an error.
        """
        result = DRIVER.ffi.new(kind)
        self.call_function(function, result, *arguments)
        return result[0]

    def _explain_error(self, function: str, code: int) -> str:
        text = DRIVER.ffi.new("const char **")
        return "" if self.call_quietly(function, code, text) else c_text(text[0])


class CudaDevice(Device):
    """A card, made by `open_card`.

    It is opened once per process and stays open. A forked process cannot use it.
    """

    def __init__(self, driver: _Driver, index: int, where: str) -> None:
        self.driver, self.dlpack = driver, (CARD, index)
        self._process = os.getpid()
        try:
            device = driver.read_result("cuDeviceGet", "CUdevice *", index)
            name = DRIVER.ffi.new("char[]", LONGEST_NAME)
            driver.call_function("cuDeviceGetName", name, LONGEST_NAME, device)
            self.name = c_text(name)
            self._context = driver.read_result("cuDevicePrimaryCtxRetain", "CUcontext *", device)
            self.units, major, minor = (
                driver.read_result(
                    "cuDeviceGetAttribute", "int *", DRIVER.get_constant(attribute), device
                )
                for attribute in (
                    "CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT",
                    "CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR",
                    "CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR",
                )
            )
        except DeviceError as error:  # for example: another process has it for itself
            raise Refusal(where, "device", "be usable", error, OTHERWISE) from None
        self.architecture = f"sm_{major}{minor}"

    def load(self, image: bytes | Path) -> Module:  # noqa: D102
        return CudaModule(self, image)

    def set_stack(self, size: int) -> None:  # noqa: D102
        where, limit = "Device.set_stack", DRIVER.get_constant("CU_LIMIT_STACK_SIZE")
        size = check_count(where, "size", size, 0, LARGEST_MEMORY)
        with self.enter_context():
            # Other users of the context may need its present value.
            before = self.driver.read_result("cuCtxGetLimit", "size_t *", limit)
            if size > before:
                try:
                    self.driver.call_function("cuCtxSetLimit", limit, size)
                except DeviceError as error:
                    rule = "be a size that the card grants [byte]"
                    raise Refusal(where, "size", rule, f"{size} ({error})") from None

    def synchronize(self, stream: int | None = None) -> None:  # noqa: D102
        with self.enter_context():
            if stream is None:
                self.driver.call_function("cuCtxSynchronize")
            else:
                self.driver.call_function(
                    "cuStreamSynchronize", DRIVER.ffi.cast("CUstream", stream)
                )

    def has_address(self, pointer: int) -> bool:  # noqa: D102
        ordinal = DRIVER.ffi.new("int *", -1)
        attribute = DRIVER.get_constant("CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL")
        with self.enter_context():
            self.driver.call_quietly("cuPointerGetAttribute", ordinal, attribute, pointer)
        return bool(ordinal[0] == self.dlpack[1])

    def free(self, pointer: int) -> None:  # noqa: D102
        self.free_handle("cuMemFree_v2", pointer)

    def free_handle(self, function: str, handle: Any) -> None:
        """Call a function that frees; errors are those of earlier work, which others report."""
        if os.getpid() == self._process:
            with contextlib.suppress(DeviceError), self.enter_context():
                self.driver.call_quietly(function, handle)

    @contextlib.contextmanager
    def enter_context(self) -> Iterator[None]:
        """Make the card's context that of this thread, and afterwards the one before.

        Raises:
            Refusal: this process is a fork of the one that opened the card.
            DeviceError: the context has failed.
        """
        if os.getpid() != self._process:
            rule = "be used by the process that opened it"
            process = f"process {os.getpid()}, a fork of process {self._process}"
            raise Refusal("Device", self.name, rule, process, "a process that is spawned")
        self.driver.call_function("cuCtxPushCurrent_v2", self._context)
        try:
            yield
        finally:
            self.driver.call_quietly("cuCtxPopCurrent_v2", DRIVER.ffi.new("CUcontext *"))

    def _allocate_memory(self, size: int) -> Memory:
        with self.enter_context():
            try:
                pointer = self.driver.read_result("cuMemAlloc_v2", "CUdeviceptr *", size)
            except DeviceError as error:
                if error.code != DRIVER.get_constant("CUDA_ERROR_OUT_OF_MEMORY"):
                    raise
                total = DRIVER.ffi.new("size_t *")
                left = self.driver.read_result("cuMemGetInfo_v2", "size_t *", total)
                rule, valid = f"fit into the memory of {self.name} [byte]", f"{left} are free"
                raise Refusal("Device.allocate", "size", rule, size, valid) from None
        return Memory(self, int(pointer), size)

    def _copy_in(self, target: int, host: int, size: int) -> None:
        with self.enter_context():
            self.driver.call_function("cuMemcpyHtoD_v2", target, _find_host_pointer(host), size)

    def _copy_out(self, host: int, source: int, size: int) -> None:
        with self.enter_context():
            self.driver.call_function("cuMemcpyDtoH_v2", _find_host_pointer(host), source, size)

    def _copy_within(self, target: int, source: int, size: int) -> None:
        with self.enter_context():
            self.driver.call_function("cuMemcpyDtoD_v2", target, source, size)

    def _fill_memory(self, target: int, byte: int, size: int) -> None:
        with self.enter_context():
            self.driver.call_function("cuMemsetD8_v2", target, byte, size)


class CudaModule(Module):
    """Kernels on a card, unloaded when nothing refers to them any more.

    Args:
        device: the card.
        image: see `Device.load`.

    Raises:
        Refusal: see there.
    """

    def __init__(self, device: CudaDevice, image: bytes | Path) -> None:
        super().__init__(device)
        self._card, self._driver = device, device.driver
        try:
            content = image if isinstance(image, bytes) else image.read_bytes()
        except OSError as error:
            raise Refusal("Device.load", "image", "be a file", error) from None
        ffi = DRIVER.ffi
        log = ffi.new("char[]", LONGEST_LOG)
        names = "CU_JIT_ERROR_LOG_BUFFER", "CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES"
        options = ffi.new("int[]", [DRIVER.get_constant(name) for name in names])
        values = ffi.new("void *[]", [log, ffi.cast("void *", LONGEST_LOG)])
        with device.enter_context():
            try:
                # PTX ends with a zero, and a cubin may be followed by one.
                self._module = self._driver.read_result(
                    "cuModuleLoadDataEx", "CUmodule *", content + b"\0", len(names), options, values
                )
            except DeviceError as error:
                if error.code not in [DRIVER.get_constant(name) for name in REFUSED_IMAGES]:
                    raise
                rule = f"be PTX or cubin for {device.name} ({device.architecture})"
                message = " ".join(filter(None, [str(error), c_text(log)]))
                raise Refusal("Device.load", "image", rule, message) from None
        weakref.finalize(self, device.free_handle, "cuModuleUnload", self._module).atexit = False

    def find_global_memory(self, name: str) -> Memory:  # noqa: D102
        size = DRIVER.ffi.new("size_t *")
        arguments = size, self._module, name.encode()
        pointer = self._get_symbol("cuModuleGetGlobal_v2", "CUdeviceptr *", *arguments)
        if pointer is None:
            raise Refusal("Module.find_global_memory", "name", "be in the module", name)
        return Memory(self.device, int(pointer), int(size[0]), self)

    def _look_up(self, kernel: str) -> Any:
        function = self._get_symbol(
            "cuModuleGetFunction", "CUfunction *", self._module, kernel.encode()
        )
        if function is None:
            return None
        with self._card.enter_context():
            max_threads = self._get_attribute(function, "CU_FUNC_ATTRIBUTE_MAX_THREADS_PER_BLOCK")
        return function, max_threads

    def _get_symbol(self, function: str, kind: str, *arguments: Any) -> Any:
        """Return what the module has of a name, or None."""
        with self._card.enter_context():
            try:
                return self._driver.read_result(function, kind, *arguments)
            except DeviceError as error:
                if error.code != DRIVER.get_constant("CUDA_ERROR_NOT_FOUND"):
                    raise
                return None

    def _describe_kernel(self, kernel: tuple[CData, int]) -> dict[str, int]:
        function, max_threads = kernel
        with self._card.enter_context():
            return {
                "registers": self._get_attribute(function, "CU_FUNC_ATTRIBUTE_NUM_REGS"),
                "stack": self._get_attribute(function, "CU_FUNC_ATTRIBUTE_LOCAL_SIZE_BYTES"),
                "shared": self._get_attribute(function, "CU_FUNC_ATTRIBUTE_SHARED_SIZE_BYTES"),
                "block": max_threads,
            }

    def _get_attribute(self, function: CData, name: str) -> int:
        return int(
            self._driver.read_result(
                "cuFuncGetAttribute", "int *", DRIVER.get_constant(name), function
            )
        )

    def _launch_kernel(
        self,
        kernel: tuple[CData, int],
        threads: int,
        packed: ctypes.Array[Any],
        block: int,
    ) -> None:
        function, max_threads = kernel
        if block > max_threads:
            rule = f"be at most {max_threads} threads, by the registers that the kernel uses"
            raise Refusal("Module.launch", "block", rule, block)
        count = ctypes.c_int64(threads)
        pointers = (ctypes.c_void_p * (1 + len(packed)))(ctypes.addressof(count), *packed)
        parameters = DRIVER.ffi.cast("void **", ctypes.addressof(pointers))
        grid = -(-threads // block), 1, 1, block, 1, 1
        with self._card.enter_context():
            self._driver.call_function(
                "cuLaunchKernel", function, *grid, 0, C_NULL, parameters, C_NULL
            )


def _find_host_pointer(address: int) -> CData:
    return DRIVER.ffi.cast("void *", address)
