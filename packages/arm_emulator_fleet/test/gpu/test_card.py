"""A card of this machine does as the tests' stub of its driver: `make test-gpu`."""

import importlib
import struct
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest
from test_gpu_compiler import make_unit, needs_clang

from arm_emulator import Refusal
from arm_emulator_fleet.device import Device, DeviceError, Module
from arm_emulator_fleet.device_array import DeviceArray, convert_to_device_array
from arm_emulator_fleet.load_kernels import load_kernels
from arm_emulator_fleet.open_device import open_device
from arm_emulator_fleet.processor_device import ProcessorDevice

pytest_plugins = ["cards"]

RNG = np.random.default_rng(4)
ADDRESS = """
struct Wrong { double* at; };
KERNEL(spoil, Wrong) { given.at[thread] = 1.0; }
struct Deep { double* result; int64 depth; };
#ifdef __CUDA__
__attribute__((device))
#endif
__attribute__((noinline)) double descend(int64 depth, double sum) {
  volatile double row[64];
  row[depth % 64] = sum;
  return depth > 0 ? descend(depth - 1, row[depth % 64] + 1.0) + row[depth % 64] : sum;
}
KERNEL(descend_in, Deep) { given.result[thread] = descend(given.depth, 0.0); }
"""


@pytest.fixture(scope="module")
def module(card: Device) -> Module:
    return load_kernels(card, make_unit(ADDRESS))


def test_the_card_reports_its_name(card: Device) -> None:
    print(f"{card.name}, {card.architecture}, {card.units} multiprocessors")
    assert card.architecture.startswith("sm_") and card.units > 0
    assert card is open_device("test", "gpu:0")


def test_numbers_are_read_as_they_were_written(card: Device) -> None:
    for shape in ((), (0, 3), (7,), (1000, 1000)):
        numbers = RNG.normal(size=shape)
        array = convert_to_device_array(card, numbers)
        assert array.numpy().tobytes() == np.ascontiguousarray(numbers).tobytes()
        target = DeviceArray(shape, "f8", card)
        target.copy_from(array)
        assert target.numpy().tobytes() == np.ascontiguousarray(numbers).tobytes()


@needs_clang
@pytest.mark.parametrize("block", [1, 32, 128, 256])
@pytest.mark.parametrize("threads", [1, 31, 65_537, 1_000_003])
def test_the_card_computes_the_bits_of_the_processor(
    card: Device, module: Module, threads: int, block: int
) -> None:
    numbers = RNG.normal(size=threads)
    results = []
    for device, kernels in (
        (card, module),
        (ProcessorDevice(), load_kernels(ProcessorDevice(1), make_unit(ADDRESS))),
    ):
        array = convert_to_device_array(kernels.device, numbers.copy())
        packed = struct.pack("Qdq", array.pointer, np.pi, -7)
        for _ in range(3):
            kernels.launch("scale", threads, packed, block=block)
        results.append(array.numpy().tobytes())
        assert device.name
    assert results[0] == results[1]


@needs_clang
def test_variables_and_needs_of_a_module(card: Device, module: Module) -> None:
    offsets = module.find_global_memory("offsets")
    assert card.read(offsets, "f8", (3,)).tolist() == [0.5, 0.25, 0.125]
    needs = module.describe("scale")
    print(needs)
    assert 0 < needs["registers"] <= 255 and needs["block"] >= 256
    with pytest.raises(Refusal, match="kernel must be in the module, got nothing"):
        module.launch("nothing", 1)


@needs_clang
def test_a_raised_stack_is_deep_enough(card: Device, module: Module) -> None:
    card.set_stack(64 << 10)
    depth = 80
    array = DeviceArray(1000, "f8", card)
    module.launch("descend_in", 1000, struct.pack("Qq", array.pointer, depth))
    # Each of the depths adds how deep it is.
    assert set(array.numpy()) == {depth + depth * (depth - 1) / 2}


def test_an_image_that_is_no_ptx_is_explained(card: Device) -> None:
    with pytest.raises(Refusal, match=r"Device.load: image must be PTX or cubin for .*\(sm_"):
        card.load(b".version 7.8\n.target sm_70\n.address_size 64\nno instruction\n")


def test_more_memory_than_the_card_has(card: Device) -> None:
    with pytest.raises(Refusal, match=r"size must fit into the memory of .*; valid: \d+ are free"):
        card.allocate(1 << 45)


@needs_clang
def test_a_launch_takes_microseconds(card: Device, module: Module) -> None:
    """Printed beside the work of a fleet, of which one launch is many steps."""
    array = DeviceArray(64, "f8", card)
    packed = struct.pack("Qdq", array.pointer, 1.0, 0)
    module.launch("scale", 64, packed)
    card.synchronize()
    began = time.perf_counter()
    for _ in range(1000):
        module.launch("scale", 64, packed)
    card.synchronize()
    print(f"{1e3 * (time.perf_counter() - began):.1f} us a launch")


def library(name: str) -> Any:
    return pytest.importorskip(name, reason=f"{name} is not installed")


def test_torch_shares_memory_with_us(card: Device) -> None:
    torch = library("torch")
    array = convert_to_device_array(card, np.arange(12.0).reshape(3, 4))
    tensor = torch.from_dlpack(array)
    assert tensor.data_ptr() == array.pointer and tensor.tolist() == array.numpy().tolist()
    tensor += 1.0
    assert array.numpy()[2, 3] == 12.0
    with torch.cuda.stream(torch.cuda.Stream()):
        assert float(torch.from_dlpack(array[1]).sum()) == 5 + 6 + 7 + 8
    theirs = torch.arange(5, dtype=torch.float64, device="cuda:0")
    ours = convert_to_device_array(card, theirs)
    assert ours.pointer == theirs.data_ptr() and ours.numpy().tolist() == [0, 1, 2, 3, 4]
    del array
    assert float(tensor.sum()) == sum(range(1, 13)), "the memory lives as long as the tensor"


def test_cupy_shares_memory_with_us(card: Device) -> None:
    cupy = library("cupy")
    array = convert_to_device_array(card, np.arange(12.0))
    for theirs in (cupy.from_dlpack(array), cupy.asarray(array)):
        assert theirs.data.ptr == array.pointer
        theirs += 1.0
    assert array.numpy().tolist() == list(range(2, 14))
    assert convert_to_device_array(card, theirs).pointer == array.pointer


def test_jax_shares_memory_with_us(card: Device) -> None:
    library("jax")
    jax = importlib.import_module("jax")
    jax.config.update("jax_enable_x64", True)
    array = convert_to_device_array(card, np.arange(12.0))
    theirs = importlib.import_module("jax.dlpack").from_dlpack(array)
    assert theirs.unsafe_buffer_pointer() == array.pointer and float(theirs.sum()) == 66.0
    assert convert_to_device_array(card, theirs + 1.0).numpy().tolist() == list(range(1, 13))


FAILS = """
import struct, sys
sys.path[:] = {path}
from test_gpu_compiler import make_unit
from test_card import ADDRESS
from arm_emulator_fleet.device import DeviceError
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.load_kernels import load_kernels
from arm_emulator_fleet.open_device import open_device
card = open_device("test", "gpu")
module, array = load_kernels(card, make_unit(ADDRESS)), DeviceArray(5, "f8", card)
module.launch("spoil", 64, struct.pack("Q", 8))
for call in (card.synchronize, array.numpy, lambda: card.allocate(8)):
    try:
        call()
    except DeviceError as error:
        print(error.code)
"""


@needs_clang
def test_an_illegal_address_is_an_error_and_no_crash(card: Device) -> None:
    """In a process of its own, since the context is lost."""
    command = [sys.executable, "-c", FAILS.format(path=sys.path)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == ["700"] * 3 and issubclass(DeviceError, RuntimeError)
