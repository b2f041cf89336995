"""The processor and two cards of a stub in the place of NVIDIA's driver, for tests."""

import gc
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cffi
import pytest

from arm_emulator.extension.compiler import Unit, compiled_library
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator_fleet import cuda_device, gpu_compiler
from arm_emulator_fleet.device import Device
from arm_emulator_fleet.processor_device import ProcessorDevice

HERE = Path(__file__).parent
CALLS = """
const char *stub_notes(void); void stub_forget(void); void stub_set_memory(size_t);
void stub_set_cards(int); size_t stub_memory_in_use(void); int stub_contexts(void);
void stub_push(int); int stub_pop(void); void stub_fail(const char *, int);
"""
SUCCESS = 0
ROOM, ROOM_OF_FLEETS = 64 << 20, 512 << 20  # bytes


class Stub:
    """The stub's library, and what it has noted."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._ffi = cffi.FFI()
        self._ffi.cdef(CALLS)
        self.calls = self._ffi.dlopen(str(file))

    @property
    def notes(self) -> list[tuple[str, int]]:
        lines = self._ffi.string(self.calls.stub_notes()).decode().splitlines()
        return [(name, int(code)) for name, code in map(str.split, lines)]

    def fail(self, function: str, code: int) -> None:
        """Let the next call of a function answer with a code."""
        self.calls.stub_fail(function.encode(), code)


def build_stub(folder: Path) -> Path:
    file = folder / "libcuda.so.1"
    warnings = "-Wall", "-Wextra", "-Werror"
    source = HERE / "stub_cuda.c"
    headers = f"-I{Path(cuda_device.__file__).parent}"
    # By the C++ compiler, the only one that the project asks for.
    command = [*find_compiler(), "-x", "c", "-std=gnu11", *warnings, "-shared", "-fPIC"]
    subprocess.run([*command, headers, source, "-o", file, "-lpthread", "-ldl"], check=True)
    return file


@pytest.fixture(scope="session")
def stub(tmp_path_factory: pytest.TempPathFactory) -> Stub:
    return Stub(build_stub(tmp_path_factory.mktemp("driver")))


@pytest.fixture(scope="session")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library of the kernels of device_kernels.cpp, as both devices take it."""
    file = tmp_path_factory.mktemp("kernels") / "kernels.so"
    flags = "-std=c++20 -O1 -Wall -Wextra -Werror -shared -fPIC".split()
    subprocess.run([*find_compiler(), *flags, HERE / "device_kernels.cpp", "-o", file], check=True)
    return file


@pytest.fixture
def cards(stub: Stub, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    """Two cards that are opened for this test; at its end nothing must be left of it."""
    monkeypatch.setattr(cuda_device, "LIBRARY", str(stub.file))
    monkeypatch.setattr(cuda_device, "_CARDS", {})
    stub.calls.stub_forget()
    before = stub.calls.stub_memory_in_use()
    yield SimpleNamespace(stub=stub, open=lambda index=0: cuda_device.open_card("Fleet", index))
    gc.collect()  # errors that were caught refer to what their callers had
    assert stub.calls.stub_memory_in_use() == before, "memory was not freed"
    assert stub.calls.stub_contexts() == 0, "a context was left to the thread"
    failed = [note for note in stub.notes if note[0] in ENDS and note[1] != SUCCESS]
    assert not failed, "freed twice, or written beyond its bounds"


ENDS = "cuMemFree_v2", "cuModuleUnload", "cuCtxPopCurrent_v2"


@pytest.fixture(params=["processor", "card"])
def device(request: pytest.FixtureRequest) -> Any:
    """Each of the two devices."""
    return make_device(request)


@pytest.fixture
def fleet_cards(cards: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stub]:
    """The two cards, for fleets: their kernels are the processor's, with the memory of a card's."""

    def load(unit: Unit, architecture: str) -> bytes:
        assert architecture == "sm_90"
        source = f'#include "pool.hpp"\n{unit.source}'
        return Path(compiled_library(replace(unit, source=source)).file).read_bytes()

    monkeypatch.setattr(gpu_compiler, "load_ptx", load)
    monkeypatch.setattr(gpu_compiler, "load_cubin", load)
    cards.stub.calls.stub_set_memory(ROOM_OF_FLEETS)
    yield cards.stub
    cards.stub.calls.stub_set_memory(ROOM)


def make_device(request: pytest.FixtureRequest) -> Device:
    if request.param == "processor":
        return ProcessorDevice(2)
    opened: Device = request.getfixturevalue("cards").open()
    return opened
