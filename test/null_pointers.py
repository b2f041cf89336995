"""Calls every function of our C headers with null pointers, one or more at a time.

Run as a program by test_null_pointers.py. It prints what it is about to call, so that a crash has
a name.
"""

from __future__ import annotations

import ctypes
import itertools
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from arm_emulator.base.config_files import find_scene
from arm_emulator.core import BOUNDARY
from arm_emulator.doors.fieldbus.drives import DRIVES_CORE
from arm_emulator.doors.fieldbus.ethercat import Segment
from arm_emulator.machine.compiler import fleet_library_of, real_time_library
from arm_emulator.machine.firmware_loop import firmware_loop
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import load_scene
from arm_emulator.runs.gains import load_gains
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.drives import Drives as ServoDrives
from arm_emulator.servo.servo_law import servo_law

FUNCTION = re.compile(r"^([a-z][\w ]*?\*?)\s*\b(\w+)\(([^()]*)\);", re.M)
NUMBERS: dict[str, type[ctypes.c_int] | type[ctypes.c_double]] = {
    "double": ctypes.c_double,
    "servo_real": ctypes.c_double,
    "int": ctypes.c_int,
    **{f"int{bits}_t": getattr(ctypes, f"c_int{bits}") for bits in (32, 64)},
    **{f"uint{bits}_t": getattr(ctypes, f"c_uint{bits}") for bits in (8, 16, 32)},
}
ROOM = 1 << 16  # bytes behind any pointer


@dataclass
class Function:
    """A prototype."""

    result: str
    name: str
    types: list[str]
    names: list[str]


def functions(header: Path) -> Iterator[Function]:
    """Every function that a header declares."""
    text = re.sub(r"/\*.*?\*/", "", header.read_text(), flags=re.S)
    for result, name, parameters in FUNCTION.findall(text):
        types, names = [], []
        for one in re.sub(r"\s+", " ", parameters).split(","):
            if one.strip() == "void":
                continue
            found = re.fullmatch(r"\s*(?:const )?(\w+)\s*(\*?)\s*(\w+)\s*", one)
            assert found, f"{header.name}: {name}: {one}"
            types.append(found[1] + found[2])
            names.append(found[3])
        yield Function(result.replace("const ", "").strip(), name, types, names)


def room(size: int = 512) -> int:
    """Memory of zeros that begins with a size, as structs do; it lives for ever."""
    memory = (ctypes.c_uint32 * (ROOM // 4))()
    memory[0] = size
    KEPT.append(memory)
    return ctypes.addressof(memory)


KEPT: list[object] = []


def main() -> None:
    """Call everything."""
    scene = load_scene("three_axis")
    plant, config = Plant(scene), load_gains(find_scene("three_axis")).servo
    segment = Segment(scene, config, lockstep=True)
    servo = ServoDrives(config).servo
    fleet_library = fleet_library_of(scene)
    KEPT.extend((plant, segment, servo))

    options = (ctypes.c_double * 8)()
    header = ctypes.cast(options, ctypes.POINTER(ctypes.c_int32))
    header[0], header[1] = 32, -1
    options[1] = 1e-4
    ctypes.cast(options, ctypes.POINTER(ctypes.c_int64))[2] = 10
    fleet_library.arm_fleet_new.restype = ctypes.c_void_p
    fleet = fleet_library.arm_fleet_new(options, 3)
    machine = fleet_library.arm_fleet_machine(ctypes.c_void_p(fleet), 0)
    assert fleet and machine, "a fleet and one of its machines"
    own = {
        "arm_machine*": machine,
        "arm_fleet*": fleet,
        "arm_command*": ctypes.addressof(plant.command),
        "arm_measurement*": ctypes.addressof(plant.measurement),
        "drives*": segment.drives.pointer,
        "servo*": ctypes.addressof(servo.arm),
        "firmware_loop*": None,  # calls the functions that it names
        "arm_real_time*": None,  # runs a thread
        "ethercat_segment*": segment.pointer,
    }
    values = {"size": plant.core.arm_saved_size(), "descriptor": -1}
    libraries = [
        (BOUNDARY / "arm.h", fleet_library),
        (BOUNDARY / "arm_fleet.h", fleet_library),
        (BOUNDARY / "real_time.h", real_time_library()),
        (BOUNDARY / "firmware_loop.h", firmware_loop()),
        (FOLDER / "servo.h", servo_law()),
        (DRIVES_CORE / "drives.h", segment.drives.calls),
        (DRIVES_CORE / "ethercat.h", segment.drives.calls),
    ]
    for header_file, library in libraries:
        for one in functions(header_file):
            call = getattr(library, one.name)
            pointers = [k for k, kind in enumerate(one.types) if kind.endswith("*")]
            call.argtypes = [
                ctypes.c_void_p if kind.endswith("*") else NUMBERS[kind] for kind in one.types
            ]
            pointer = ctypes.c_void_p if one.result.endswith("*") else None
            call.restype = pointer or NUMBERS.get(one.result)
            for nulls in subsets(pointers):
                if any(own.get(one.types[k], 0) is None and k not in nulls for k in pointers):
                    continue
                if one.name.endswith("_delete") and not nulls:
                    continue
                arguments = [
                    (None if k in nulls else own.get(kind) or room())
                    if kind.endswith("*") else values.get(name, 1)
                    for k, (kind, name) in enumerate(zip(one.types, one.names, strict=True))
                ]  # fmt: skip
                shown = ", ".join(one.names[k] for k in nulls)
                print(f"{one.name} {shown or '-'}", end=" ", flush=True)
                print(call(*arguments), flush=True)


def subsets(places: list[int]) -> Iterator[tuple[int, ...]]:
    """Yield all of them, the empty one first."""
    for size in range(len(places) + 1):
        yield from itertools.combinations(places, size)


if __name__ == "__main__":
    main()
    sys.exit(0)
