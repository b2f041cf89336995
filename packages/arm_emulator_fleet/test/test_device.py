"""Memory and kernels: the processor and a card behind a stub of the driver do the same."""

import copy
import gc
import json
import os
import pickle
import struct
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from devices import Stub
from machines import SENSED

from arm_emulator import Refusal
from arm_emulator_fleet import cuda_device
from arm_emulator_fleet.device import Device, DeviceError
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.open_device import open_device
from arm_emulator_fleet.processor_device import MAX_COUNTS, ProcessorDevice

pytest_plugins = ["devices"]

RNG = np.random.default_rng(20)
DTYPES = ["f8", "f4", "i8", "u8", "i4", "u4", "i2", "u2", "i1", "u1", "?", "c16"]
OFFSETS = np.array([0.5, 0.25, 0.125])  # of device_kernels.cpp


def scaled(numbers: DeviceArray, factor: float, add: int) -> bytes:
    """Return struct Scaled of device_kernels.cpp."""
    return struct.pack("Qdq", numbers.pointer, factor, add)


def draw(dtype: str, shape: tuple[int, ...]) -> np.ndarray:
    bits = RNG.integers(0, 256, (*shape, np.dtype(dtype).itemsize), np.uint8)
    return bits.view(dtype)[..., 0] if dtype != "?" else bits[..., 0] > 100


# Memory


@pytest.mark.parametrize("dtype", DTYPES)
def test_numbers_are_read_as_they_were_written(device: Device, dtype: str) -> None:
    for _ in range(5):
        shape = tuple(int(n) for n in RNG.integers(0, 7, RNG.integers(0, 4)))
        numbers = draw(dtype, shape)
        offset, beyond = (int(n) for n in RNG.integers(0, 40, 2))
        memory = device.allocate(offset + numbers.nbytes + beyond)
        device.fill(memory, 7)
        device.write(memory, numbers, offset)
        read = device.read(memory, dtype, shape, offset)
        assert read.dtype == dtype and read.shape == shape and read.tobytes() == numbers.tobytes()
        everything = device.read(memory, "u1", (memory.size,)).tobytes()
        assert everything == b"\7" * offset + numbers.tobytes() + b"\7" * beyond


def test_arrays_in_any_order_of_numpy_are_written_in_that_of_c(device: Device) -> None:
    numbers = RNG.normal(size=(4, 5))
    memory = device.allocate(numbers.nbytes)
    for view in (numbers.T, numbers[::-1, ::-1], np.asfortranarray(numbers)):
        device.write(memory, view)
        np.testing.assert_array_equal(device.read(memory, "f8", view.shape), view)


def test_bytes_are_copied_and_filled_where_they_should_be(device: Device) -> None:
    source, target = device.allocate(50), device.allocate(60)
    expected = bytearray(RNG.bytes(60))
    device.write(source, np.arange(50, dtype=np.uint8))
    device.write(target, np.frombuffer(expected, np.uint8))
    device.copy(target, source, 20, to=30, since=7)
    expected[30:50] = bytes(range(7, 27))
    device.fill(target, 255, 3, 4)
    expected[3:7] = b"\xff" * 4
    device.fill(target, 1, 58)
    expected[58:] = b"\1\1"
    device.copy(target, source, 0)
    device.fill(target, 9, 60)
    assert device.read(target, "u1", (60,)).tobytes() == expected


@pytest.mark.parametrize(
    "spoil",
    [
        lambda device, memory: device.write(memory, np.zeros(4), 1),
        lambda device, memory: device.write(memory, np.zeros(5)),
        lambda device, memory: device.write(memory, np.zeros(1), -8),
        lambda device, memory: device.write(memory, np.zeros(1), 33),
        lambda device, memory: device.read(memory, "f8", (5,)),
        lambda device, memory: device.read(memory, "f8", (1,), 2**62),
        lambda device, memory: device.fill(memory, 1, 0, 33),
        lambda device, memory: device.fill(memory, 1, 33),
        lambda device, memory: device.fill(memory, 256),
        lambda device, memory: device.fill(memory, 1, 0, -1),
        lambda device, memory: device.copy(memory, device.allocate(8), 9),
        lambda device, memory: device.copy(memory, device.allocate(8), 8, to=25),
        lambda device, memory: device.copy(memory, device.allocate(8), 8, since=1),
        lambda device, memory: device.write(ProcessorDevice(1).allocate(99), np.zeros(1)),
        lambda device, memory: device.copy(memory, ProcessorDevice(1).allocate(99), 1),
        lambda device, memory: device.allocate(-1),
        lambda device, memory: device.allocate(1.5),
        lambda device, memory: copy.copy(memory),
        lambda device, memory: pickle.dumps(memory),
        lambda device, memory: device.set_stack(-1),
        lambda device, memory: device.set_stack(0.5),
    ],
)
def test_data_that_do_not_fit_are_refused_and_change_nothing(device: Device, spoil) -> None:
    memory = device.allocate(32)
    device.fill(memory, 3)
    with pytest.raises(Refusal):
        spoil(device, memory)
    assert device.read(memory, "u1", (32,)).tobytes() == b"\3" * 32


def test_no_bytes_are_memory_too(device: Device) -> None:
    memory = device.allocate(0)
    device.write(memory, np.zeros((3, 0)))
    device.fill(memory, 1)
    assert device.read(memory, "f8", (0, 5)).shape == (0, 5)


def test_more_memory_than_there_is_is_refused(device: Device, request) -> None:
    with pytest.raises(Refusal, match=r"Device.allocate: size must fit into .*, got 4611686018427"):
        device.allocate(2**62)
    if not isinstance(device, ProcessorDevice):
        array = device.allocate(60 << 20)
        with pytest.raises(Refusal, match=f"valid: {4 << 20} are free"):
            device.allocate(5 << 20)
        del array
        device.allocate(5 << 20)


def test_memory_is_freed_when_nothing_refers_to_it(cards: SimpleNamespace) -> None:
    card, in_use = cards.open(), cards.stub.calls.stub_memory_in_use
    before = in_use()
    memory = card.allocate(1000)
    array = DeviceArray((5, 5), "f8", card)
    row = array[3]
    assert in_use() == before + 1200
    del memory, array
    assert in_use() == before + 200, "a row keeps its array"
    del row
    assert in_use() == before


def test_memory_is_freed_by_any_thread(cards: SimpleNamespace) -> None:
    card, in_use = cards.open(), cards.stub.calls.stub_memory_in_use
    before = in_use()
    arrays = [card.allocate(100) for _ in range(50)]
    threads = [threading.Thread(target=lambda: arrays.pop() and None) for _ in range(50)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    gc.collect()
    assert in_use() == before


def test_work_of_several_threads_goes_to_the_card(cards: SimpleNamespace) -> None:
    card, wrong = cards.open(), []

    def work(seed: int) -> None:
        numbers = np.random.default_rng(seed).normal(size=100)
        wrong.append(seed)
        for _ in range(50):
            array = DeviceArray(100, "f8", card)
            array.copy_from(numbers)
            assert np.array_equal(array.numpy(), numbers)
        wrong.remove(seed)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


# Kernels


@pytest.mark.parametrize("threads", [1, 2, 63, 64, 65, 10_007])
@pytest.mark.parametrize("block", [1, 32, 64, 512])
def test_a_kernel_runs_once_per_thread(
    device: Device, kernels: Path, threads: int, block: int
) -> None:
    module = device.load(kernels)
    numbers = RNG.normal(size=threads)
    array = DeviceArray(threads, "f8", device)
    array[:] = numbers
    module.launch("scale", threads, scaled(array, 3.0, -2), block=block)
    device.synchronize()
    expected = 3.0 * numbers + -2.0 + OFFSETS[np.arange(threads) % 3]
    np.testing.assert_array_equal(array.numpy(), expected)


def test_the_processor_shares_threads_among_its_cores(kernels: Path) -> None:
    """Each way of sharing, by repetition, and more numbers of threads than are remembered."""
    device = ProcessorDevice(3)
    module = device.load(kernels)
    for threads in [*range(20_000, 20_000 + 2 * MAX_COUNTS), 20_000]:
        array = DeviceArray(threads, "f8", device)
        array[:] = np.zeros(threads)
        for _ in range(3):
            module.launch("scale", threads, scaled(array, 1.0, 1))
        expected = 3.0 + 3.0 * OFFSETS[np.arange(threads) % 3]
        np.testing.assert_array_equal(array.numpy(), expected)


def test_no_threads_do_nothing(device: Device, kernels: Path) -> None:
    module = device.load(kernels)
    array = DeviceArray(0, "f8", device)
    module.launch("scale", 0, scaled(array, 1.0, 1))


def test_arguments_arrive_with_their_types(device: Device, kernels: Path) -> None:
    module = device.load(kernels.read_bytes())
    result = DeviceArray((2, 3), "f8", device)
    for number in (0, 1, -1, 2**53, -(2**63)):
        for argument in (number, np.int64(number), struct.pack("q", number)):
            module.launch("take", 3, result[1], argument, 0.25, np.float32(0.125))
            np.testing.assert_array_equal(result[1].numpy(), float(number) + 0.25 + 0.125)
    module.launch("take", 6, result.memory, 1, np.float64(2.0), np.float32(0.5))
    np.testing.assert_array_equal(result.numpy(), 3.5)


@pytest.mark.parametrize("wrong", [2**63, -(2**63) - 1, "1", None, b"", True, [1.0], np.zeros(3)])
def test_an_argument_that_no_kernel_takes_is_refused(device: Device, kernels: Path, wrong) -> None:
    with pytest.raises(Refusal, match=r"Module.launch: argument must be"):
        device.load(kernels).launch("take", 1, wrong)


def test_memory_of_another_device_is_no_argument(cards: SimpleNamespace, kernels: Path) -> None:
    module = cards.open(0).load(kernels)
    for foreign_device in (cards.open(1), ProcessorDevice(1)):
        with pytest.raises(Refusal, match=r"memory must be on stub 0, got memory on "):
            module.launch("take", 1, DeviceArray(1, "f8", foreign_device))


@pytest.mark.parametrize(
    ("threads", "block"), [(-1, 64), (1.5, 64), (2**41, 64), (1, 0), (1, 1025)]
)
def test_no_such_launch(device: Device, kernels: Path, threads, block) -> None:
    with pytest.raises(Refusal, match=r"Module.launch: (threads|block) must be"):
        device.load(kernels).launch("scale", threads, b"1", block=block)


def test_a_kernel_that_is_not_there(device: Device, kernels: Path) -> None:
    module = device.load(kernels)
    for ask in (lambda: module.launch("nothing", 0), lambda: module.describe("nothing")):
        with pytest.raises(Refusal, match="kernel must be in the module, got nothing"):
            ask()


@pytest.mark.parametrize("image", [b"", b"no image", b"\x7fELF\2\1\1" + bytes(100)])
def test_a_module_that_cannot_be_loaded(device: Device, image: bytes) -> None:
    with pytest.raises(Refusal, match=r"Device.load: image must be "):
        device.load(image)


def test_a_file_that_is_not_there(device: Device, tmp_path: Path) -> None:
    with pytest.raises(Refusal, match=r"Device.load: image must be .*No such file"):
        device.load(tmp_path / "nothing")


def test_the_error_log_of_the_compiler_is_in_the_refusal(cards: SimpleNamespace) -> None:
    with pytest.raises(Refusal) as refused:
        cards.open().load(b".version 7.8")
    line = "Device.load: image must be PTX or cubin for stub 0 (sm_90), got cuModuleLoadDataEx: "
    line += "CUDA_ERROR_218 (text of the driver) ptxas application ptx input, line 1; fatal: no PTX"
    assert str(refused.value) == line


def test_a_variable_of_the_source_is_read_and_written(device: Device, kernels: Path) -> None:
    module = device.load(kernels.read_bytes())
    offsets = module.find_global_memory("offsets")
    assert offsets.size == OFFSETS.nbytes
    np.testing.assert_array_equal(device.read(offsets, "f8", (3,)), OFFSETS)
    device.write(offsets, OFFSETS + 8.0)
    array = DeviceArray(7, "f8", device)
    array[:] = np.zeros(7)
    module.launch("scale", 7, scaled(array, 1.0, 0))
    np.testing.assert_array_equal(array.numpy(), 8.0 + OFFSETS[np.arange(7) % 3])
    with pytest.raises(Refusal, match="name must be in the module, got nothing"):
        module.find_global_memory("nothing")


def test_modules_of_the_same_file_have_variables_of_their_own(
    device: Device, kernels: Path
) -> None:
    for image in (kernels, kernels.read_bytes()):
        modules = [device.load(image) for _ in range(3)]
        places = [module.find_global_memory("offsets") for module in modules]
        for k, place in enumerate(places):
            device.write(place, np.full(3, float(k)))
        for k, (module, place) in enumerate(zip(modules, places, strict=True)):
            array = DeviceArray(3, "f8", device)
            array[:] = np.zeros(3)
            module.launch("scale", 3, scaled(array, 1.0, 0))
            assert array.numpy().tolist() == device.read(place, "f8", (3,)).tolist() == 3 * [k]


def test_a_library_of_the_processor_is_unloaded(kernels: Path) -> None:
    def count() -> int:
        return Path("/proc/self/maps").read_text().count("memfd:kernels")

    before, files = count(), len(os.listdir("/proc/self/fd"))
    device = ProcessorDevice(1)
    for _ in range(50):
        module = device.load(kernels)
        offsets = module.find_global_memory("offsets")
        del module
        np.testing.assert_array_equal(device.read(offsets, "f8", (3,)), OFFSETS)
    del offsets
    assert count() == before and len(os.listdir("/proc/self/fd")) == files


def test_a_module_lives_as_long_as_its_memory(cards: SimpleNamespace, kernels: Path) -> None:
    card = cards.open()
    module = card.load(kernels)
    offsets = module.find_global_memory("offsets")
    del module
    assert "cuModuleUnload" not in dict(cards.stub.notes)
    np.testing.assert_array_equal(card.read(offsets, "f8", (3,)), OFFSETS)
    del offsets
    assert dict(cards.stub.notes)["cuModuleUnload"] == 0


def test_a_module_describes_its_kernels(cards: SimpleNamespace, kernels: Path) -> None:
    module = cards.open().load(kernels)
    needs = {"registers": 40, "stack": 16, "shared": 0, "block": 512}
    assert module.describe("scale") == needs
    with pytest.raises(Refusal, match="block must be at most 512 threads"):
        module.launch("scale", 5, b"1", block=513)


def test_the_stack_of_a_card_is_raised_and_never_lowered(cards: SimpleNamespace) -> None:
    card = cards.open()
    card.set_stack(20_000)
    card.set_stack(30_000)
    cards.stub.calls.stub_forget()
    card.set_stack(10_000)
    assert "cuCtxSetLimit" not in dict(cards.stub.notes)
    with pytest.raises(Refusal, match=r"size must be a size that the card grants \[byte\]"):
        card.set_stack(1 << 40)


# Errors of the driver


WORK = {
    "cuMemAlloc_v2": lambda card, module, array: card.allocate(8),
    "cuMemcpyHtoD_v2": lambda card, module, array: array.copy_from([1.0, 2.0]),
    "cuMemcpyDtoH_v2": lambda card, module, array: array.numpy(),
    "cuMemcpyDtoD_v2": lambda card, module, array: array.copy_from(DeviceArray(2, "f8", card)),
    "cuMemsetD8_v2": lambda card, module, array: card.fill(array.memory, 0),
    "cuModuleLoadDataEx": lambda card, module, array: card.load(module.image),
    "cuModuleGetFunction": lambda card, module, array: module.describe("scale"),
    "cuModuleGetGlobal_v2": lambda card, module, array: module.find_global_memory("offsets"),
    "cuFuncGetAttribute": lambda card, module, array: module.describe("take"),
    "cuLaunchKernel": lambda card, module, array: module.launch("take", 2, array, 1, 2.0, 3.0),
    "cuCtxPushCurrent_v2": lambda card, module, array: card.allocate(8),
    "cuCtxSynchronize": lambda card, module, array: card.synchronize(),
    "cuStreamSynchronize": lambda card, module, array: card.synchronize(2),
}


@pytest.mark.parametrize("function", WORK)
@pytest.mark.parametrize("code", [700, 719, 999])
def test_a_failure_of_the_card_is_an_error(
    cards: SimpleNamespace, kernels: Path, function: str, code: int
) -> None:
    """Such as an illegal address in a kernel, which the next call reports."""
    card = cards.open()
    module, array = card.load(kernels), DeviceArray(2, "f8", card)
    module.image = kernels
    cards.stub.fail(function, code)
    text = "text of the driver" if code < 900 else "unknown"
    with pytest.raises(DeviceError, match=rf"^{function}: CUDA_ERROR_{code} \({text}\)$") as error:
        WORK[function](card, module, array)
    assert (error.value.function, error.value.code) == (function, code)
    WORK[function](card, module, array)


def test_the_context_of_the_caller_is_left(cards: SimpleNamespace) -> None:
    """For example that of torch on another card."""
    first, second = cards.open(0), cards.open(1)
    cards.stub.calls.stub_push(1)
    arrays = [DeviceArray(3, "f8", card) for card in (first, second)]
    for array in arrays:
        array[:] = [1.0, 2.0, 3.0]
        assert array.numpy().tolist() == [1.0, 2.0, 3.0]
    assert cards.stub.calls.stub_contexts() == 1 and cards.stub.calls.stub_pop() == 1


def test_memory_is_copied_from_card_to_card(cards: SimpleNamespace) -> None:
    arrays = [DeviceArray(3, "f8", cards.open(k)) for k in range(2)]
    arrays[0][:] = [1.0, 2.0, 3.0]
    arrays[1].copy_from(arrays[0])
    assert arrays[1].numpy().tolist() == [1.0, 2.0, 3.0]


def test_a_fork_is_refused_and_frees_nothing(cards: SimpleNamespace) -> None:
    card = cards.open()
    memory = card.allocate(8)
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            line = ""
            try:
                card.read(memory, "f8", (1,))
            except Refusal as refused:
                line = str(refused)
            cards.stub.calls.stub_forget()
            del memory
            os.write(write, f"{line}|{cards.stub.notes}".encode())
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    line, notes = os.read(read, 4096).decode().split("|")
    assert line.startswith("Device: stub 0 must be used by the process that opened it, got process")
    assert notes == "[]"
    assert card.read(memory, "f8", (1,)).size == 1


# Opening


def test_a_card_is_opened_once(cards: SimpleNamespace) -> None:
    first, again, second = (open_device("Fleet", name) for name in ("gpu", "gpu:0", "gpu:1"))
    assert first is again and first is not second
    assert (first.name, first.architecture, first.units) == ("stub 0", "sm_90", 3)
    assert (second.name, second.dlpack) == ("stub 1", (2, 1))
    retained = [note for note in cards.stub.notes if note[0] == "cuDevicePrimaryCtxRetain"]
    assert len(retained) == 2


def test_the_processor_is_a_single_device() -> None:
    """So that arrays of several fleets are shared among them."""
    assert open_device("Fleet", "processor") is open_device("Fleet", "processor")


def test_no_such_card(cards: SimpleNamespace) -> None:
    with pytest.raises(Refusal) as refused:
        open_device("Fleet", "gpu:2")
    expected = "Fleet: device must be a card of this machine, got gpu:2; valid: gpu:0, gpu:1"
    assert str(refused.value) == expected


@pytest.mark.parametrize(
    "name", ["", "cuda", "gpu:", "gpu:-1", "gpu:99999", "GPU", None, 1, "gpu\n"]
)
def test_no_such_device(name) -> None:
    with pytest.raises(
        Refusal, match=r'Fleet: device must be known, .*; valid: "processor", "gpu"'
    ):
        open_device("Fleet", name)


def test_a_missing_driver_is_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_device, "LIBRARY", "libno_cuda.so.1")
    monkeypatch.setattr(cuda_device, "_CARDS", {})
    with pytest.raises(Refusal) as refused:
        open_device("Fleet", "gpu")
    line = 'Fleet: device must have NVIDIA\'s driver (libno_cuda.so.1) for "gpu", got none; '
    assert str(refused.value) == line + 'valid: "processor"'


def test_a_library_that_is_no_driver(kernels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda_device, "LIBRARY", str(kernels))
    monkeypatch.setattr(cuda_device, "_CARDS", {})
    with pytest.raises(Refusal, match=r"device must have NVIDIA's driver .*undefined symbol: cu"):
        open_device("Fleet", "gpu")


def test_no_card(cards: SimpleNamespace) -> None:
    cards.stub.calls.stub_set_cards(0)
    try:
        with pytest.raises(Refusal, match=r"be a card that the driver can use .*CUDA_ERROR_100 \("):
            open_device("Fleet", "gpu")
    finally:
        cards.stub.calls.stub_set_cards(2)


@pytest.mark.parametrize(
    "function", ["cuDeviceGet", "cuDevicePrimaryCtxRetain", "cuDeviceGetAttribute"]
)
def test_a_card_that_cannot_be_used(cards: SimpleNamespace, function: str) -> None:
    cards.stub.fail(function, 46)
    with pytest.raises(
        Refusal, match=rf"Fleet: device must be usable, got {function}: CUDA_ERROR_46"
    ):
        open_device("Fleet", "gpu")
    assert open_device("Fleet", "gpu").name == "stub 0"


OPENS = """
import json, sys
from arm_emulator import load_scene
import arm_emulator_fleet
from arm_emulator_fleet import Fleet, ServoFleet
def opened():
    return "cuda" in open("/proc/self/maps").read()
def loaded(*parts):
    names = [name for name in sys.modules if name.startswith("arm_emulator_fleet")]
    return [name for name in names if any(part in name for part in parts)]
PARTS = "cuda", "device", "gpu", "kernels", "dlpack"
print(opened(), loaded(*PARTS), "ctypes.util" in sys.modules)
fleet = Fleet(load_scene("three_axis", json.loads(sys.argv[1])), 3)
fleet.advance([0.0, 0.0, 0.0], 5)
fleet.follow(ServoFleet(fleet, "three_axis"), 2)
print(opened(), loaded(*PARTS))
from arm_emulator_fleet.open_device import open_device
open_device("test", "processor")
print(opened(), loaded("cuda", "gpu"))
print(open_device("test", "gpu").name, opened())
"""


@pytest.mark.slow
def test_the_driver_is_opened_for_a_card_alone(stub: Stub) -> None:
    """And found by its own name, as the loader finds libraries."""
    folders = os.pathsep.join(filter(None, sys.path))
    environment = os.environ | {"LD_LIBRARY_PATH": str(stub.file.parent), "PYTHONPATH": folders}
    command = [sys.executable, "-c", OPENS, json.dumps(SENSED)]  # a fleet of other tests
    result = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert result.returncode == 0, result.stderr
    expected = ["False [] False", "False []", "False []", "stub 0 True"]
    assert result.stdout.splitlines() == expected
