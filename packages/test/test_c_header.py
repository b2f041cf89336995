"""cffi reads our C headers as a C compiler does."""

import contextlib
import gc
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from arm_emulator import Plant, load_scene
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.plant.compiler import load_machine
from arm_emulator.machine.plant.core_calls import ARM, FIRMWARE
from arm_emulator.runs.servo_step import HERE, STEP
from arm_emulator.servo.c import FOLDER as SERVO_FOLDER
from arm_emulator.servo.servo_law import SERVO
from arm_emulator.tick.c import FIRMWARE_CONTROLLER, REAL_TIME, TICK
from arm_emulator.tick.c import FOLDER as TICK_FOLDER
from arm_emulator.toolchain import c_header, library_cache
from arm_emulator.toolchain.c_header import NULL, Header, Library, make_pointer, read_text
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator_fieldbus.drives_unit import DRIVES, DRIVES_CORE
from arm_emulator_fieldbus.ethercat import SEGMENT
from arm_emulator_firmware import CORE_FOLDER
from arm_emulator_firmware.board import RUNNER
from arm_emulator_fleet.unit import FLEET

HEADERS = (
    ARM,
    FLEET,
    FIRMWARE,
    TICK,
    FIRMWARE_CONTROLLER,
    REAL_TIME,
    SERVO,
    STEP,
    DRIVES,
    SEGMENT,
    RUNNER,
)
FOLDERS = (BOUNDARY, TICK_FOLDER, SERVO_FOLDER, HERE, DRIVES_CORE, CORE_FOLDER)
IMPORT = "import arm_emulator.machine.plant.core_calls as c; print(c.ARM.functions)"


def structs_of(header: Header) -> list[str]:
    """The structs that a header and those that it includes define."""
    structs = []
    for kind in header.ffi.list_types()[0]:
        with contextlib.suppress(header.ffi.error):  # an opaque one has no size
            if header.get_size(kind) and header.ffi.typeof(kind).kind == "struct":
                structs.append(kind)
    return structs


def numbers_of(header: Header, kind: str) -> list[tuple[str, int]]:
    """C expressions of a struct's layout, with what Python has for them."""
    struct = header.ffi.typeof(kind)
    numbers = [(f"sizeof({kind})", header.get_size(kind))]
    for name, field in struct.fields:
        numbers.append((f"offsetof({kind}, {name})", field.offset))
        numbers.append((f"sizeof((({kind}*)0)->{name})", header.ffi.sizeof(field.type)))
    dtype = header.get_dtype(kind)
    assert dtype.itemsize == header.get_size(kind)
    fields = dtype.fields or {}
    numbers += [(f"offsetof({kind}, {name})", fields[name][1]) for name, _ in struct.fields]
    numbers += [(f"sizeof((({kind}*)0)->{name})", fields[name][0].itemsize) for name in fields]
    return numbers


def test_layouts_are_those_of_the_c_compiler(tmp_path: Path) -> None:
    lines = ["#include <stddef.h>", *(f'#include "{header.path}"' for header in HEADERS)]
    count = 0
    for header in HEADERS:
        for kind in structs_of(header):
            for expression, number in numbers_of(header, kind):
                lines.append(f'_Static_assert({expression} == {number}, "{expression}");')
                count += 1
    assert count > 1000, "all fields of all structs"
    source = tmp_path / "layouts.c"
    source.write_text("\n".join(lines) + "\n")
    folders = [f"-I{folder}" for folder in FOLDERS]
    command = [*find_compiler(), "-xc", "-std=c11", *folders, "-c", str(source)]
    done = subprocess.run(
        [*command, "-o", "/dev/null"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def write(folder: Path, name: str, words: str) -> Path:
    file = folder / name
    file.write_text(words)
    return file


def test_a_header_is_read_as_its_compiler_does(tmp_path: Path) -> None:
    write(tmp_path, "inner.h", "typedef struct inner { short a; double b[2]; } inner;\n")
    header = Header(write(tmp_path, "outer.h", """\
#ifndef OUTER_H /* a guard */
#define OUTER_H
#include "inner.h"
#include <stdint.h>
#ifdef __cplusplus
this is not C
#else
#define OUTER_MOST 0x10
#ifdef __cplusplus
nor this
#endif
#endif
#define OUTER_REAL 1.5
enum outer { OUTER_NONE = 7, OUTER_ONE };
typedef struct outer { inner one; uint8_t more; /* struct { */ const char* text; } outer;
int abs(int x);
#endif
"""))  # fmt: skip
    assert header.functions == ("abs",)
    assert [header.get_constant(n) for n in ("OUTER_MOST", "OUTER_ONE")] == [16, 8]
    assert header.get_dtype("outer")["one"]["b"] == np.dtype(("f8", (2,)))
    assert header.get_dtype("outer").itemsize == 40
    inner = Header(tmp_path / "inner.h")
    assert inner.ffi.typeof("inner") is header.ffi.typeof("inner"), "one type for both"
    assert Library("libc.so.6", (header,)).abs(-3) == 3
    with pytest.raises(AttributeError, match="no header declares getpid"):
        Library("libc.so.6", (header,)).getpid()


def test_an_array_of_a_different_type_is_no_place_for_a_struct(tmp_path: Path) -> None:
    """Wrong types, orders and strides are errors, where an address would be taken for good."""
    rows = ARM.make_rows("arm_joint_command", 3)
    for wrong in (np.zeros(3), np.zeros(3, ARM.get_dtype("arm_joint_measurement"))):
        with pytest.raises(TypeError):
            ARM.make_struct("arm_command", joint=wrong)
    with pytest.raises((ValueError, BufferError)):
        ARM.make_struct("arm_command", joint=rows[::2])
    with pytest.raises((ValueError, BufferError)):
        make_pointer(np.zeros((3, 2)).T)
    with pytest.raises(AttributeError):
        ARM.make_struct("arm_command", joints=rows)
    command = ARM.make_struct("arm_command", joint=rows, tick=2**40)
    rows["value"][1] = 2.5
    assert (command.size, command.tick, command.joint[1].value) == (32, 2**40, 2.5)
    assert command.further == NULL
    why = ARM.make_struct("arm_refusal", quantity=b"q")
    assert read_text(why.quantity) == "q"


def test_functions_outlive_the_library_that_gave_them_and_machines_leave_nothing() -> None:
    """The system keeps it loaded; a process may make machines indefinitely."""
    scene = load_scene("three_axis")
    saved_size = load_machine(scene).arm_saved_size
    before = saved_size()
    gc.collect()
    tracemalloc.start()
    try:
        for run in range(4):
            if run == 1:
                first = tracemalloc.get_traced_memory()[0]
            for _ in range(50):
                Plant(scene).advance([0.0] * 3, 1)
            gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - first
    finally:
        tracemalloc.stop()
    assert grown < 150 * 100, f"{grown} bytes of 150 plants"
    assert saved_size() == before


def read_cache(cache: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in cache.iterdir() if file.suffix == ".cdef"}


def test_read_headers_are_cached_and_read_again_if_the_cache_is_spoiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = tmp_path / "cache"
    monkeypatch.setenv(library_cache.CACHE_VARIABLE, str(cache))

    def run() -> str:
        done = subprocess.run(
            [sys.executable, "-c", IMPORT], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    first = run()
    stored = read_cache(cache)
    assert {name.partition("-")[0] for name in stored} >= {"arm", "equations", "firmware"}
    for spoil in (lambda b: b[:-1], lambda b: b"", lambda b: bytes([b[0] ^ 1]) + b[1:]):
        for name, body in stored.items():
            (cache / name).write_bytes(spoil(body))
        assert run() == first
        assert read_cache(cache) == stored
    monkeypatch.setenv(library_cache.CACHE_VARIABLE, "/proc/none")
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    monkeypatch.setenv("TMPDIR", "/proc/none")
    assert run() == first, "without a place to keep it"


def test_another_text_is_another_header(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cache key is the text of a header and of all headers that it includes."""
    monkeypatch.setenv(library_cache.CACHE_VARIABLE, str(tmp_path / "cache"))
    sizes: list[Any] = []
    for words in ("int a;", "int a, b;", "int a, b, c;"):
        write(tmp_path, "inner.h", f"typedef struct inner {{ {words} }} inner;\n")
        outer = write(tmp_path, "outer.h", '#include "inner.h"\ntypedef inner outer;\n')
        for cache_table in (c_header._READ, c_header._DIGESTS, c_header._PARSERS):
            for name in ("inner.h", "outer.h"):
                cache_table.pop(tmp_path / name, None)
        sizes.append(Header(outer).get_size("outer"))
    assert sizes == [4, 8, 12]
