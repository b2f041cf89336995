"""Calls every function of our C headers with null pointers, one or more at a time.

Run as a program by test_null_pointers.py. It prints what it is about to call, so that a crash has
a name.
"""

import itertools
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from arm_emulator import Breakpoint, Plant, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.machine.plant.call_arguments import make_options
from arm_emulator.machine.plant.compiler import (
    load_equations,
    load_real_time,
)
from arm_emulator.machine.plant.core_calls import ARM, EQUATIONS
from arm_emulator.machine.plant.formula_rows import (
    CONDITION,
    FORMULA,
    TOOL_POSITION,
    formula_library,
)
from arm_emulator.machine.session.record_ring import LISTENERS, RING, record_ring
from arm_emulator.servo.servo_arm import ServoArm as ServoDrives
from arm_emulator.servo.servo_law import SERVO, servo_law
from arm_emulator.tick.c import FIRMWARE_CONTROLLER, REAL_TIME, TICK, tick_calls
from arm_emulator.toolchain.c_header import NULL
from arm_emulator_fieldbus.drives_unit import DRIVES
from arm_emulator_fieldbus.ethercat import SEGMENT, Segment
from arm_emulator_fleet.unit import FLEET, load_fleet

ROOM = 1 << 16  # bytes behind any pointer
ALIVE: list[object] = []


def room(size: int = 512) -> Any:
    """Memory of zeros that begins with a size, as structs do; it lives indefinitely."""
    memory = np.zeros(ROOM // 4, np.uint32)
    memory[0] = size
    ALIVE.append(memory)
    return ARM.ffi.cast("void *", memory.ctypes.data)


def main() -> None:
    """Call everything."""
    scene = load_scene("three_axis")
    plant, config = Plant(scene), load_gains(find_scene("three_axis")).servo
    segment = Segment(scene, config, lockstep=True)
    servo = ServoDrives(config).servo
    fleet_library = load_fleet(scene)
    ALIVE.extend((plant, segment, servo))

    fleet = fleet_library.arm_fleet_new(make_options(scene, np.zeros(0)), 3)
    machine = fleet_library.arm_fleet_machine(fleet, 0)
    assert fleet and machine, "a fleet and one of its machines"
    stops = Breakpoint(plant, "tick > 3")
    own = {
        "arm_machine *": machine,
        "arm_fleet *": fleet,
        "arm_command *": plant.command,
        "arm_measurement *": plant.measurement,
        "drives *": segment.drives.pointer,
        "servo *": servo.arm,
        "tick_machine *": None,  # calls the functions that it names
        "tick_controller *": None,
        "arm_real_time *": None,  # runs a thread
        "ethercat_segment *": segment.pointer,
        "listeners *": LISTENERS.make_struct("listeners"),
        "condition *": stops.struct.what,
        "breakpoint *": stops.struct,
    }
    size = plant.core.arm_saved_size()
    values = {
        ("arm_save", 2): size, ("arm_restore", 2): size, ("drives_write", 5): size,
        ("ethercat_frame", 2): size, ("arm_listen", 1): NULL, ("ethercat_serve", 1): -1,
        ("listeners_add", 1): NULL,
    }  # fmt: skip
    libraries = [
        (ARM, fleet_library),
        (FLEET, fleet_library),
        (EQUATIONS, load_equations(scene)),
        (REAL_TIME, load_real_time()),
        (TICK, tick_calls()),
        (FIRMWARE_CONTROLLER, tick_calls()),
        (RING, record_ring()),
        (LISTENERS, record_ring()),
        (FORMULA, formula_library()),
        (TOOL_POSITION, formula_library()),
        (CONDITION, formula_library()),
        (SERVO, servo_law()),
        (DRIVES, segment.drives.calls),
        (SEGMENT, segment.drives.calls),
    ]
    for header, library in libraries:
        for name in header.functions:
            call = getattr(library, name)
            types = header.ffi.typeof(call).args
            kinds = [kind.cname.removeprefix("struct ") for kind in types]
            pointers = [k for k, kind in enumerate(types) if kind.kind == "pointer"]
            for nulls in subsets(pointers):
                if any(own.get(kinds[k], 0) is None and k not in nulls for k in pointers):
                    continue
                if name.endswith("_delete") and not nulls:
                    continue
                arguments = [
                    (NULL if k in nulls else own.get(kind) or room())
                    if k in pointers else values.get((name, k), 1)
                    for k, kind in enumerate(kinds)
                ]  # fmt: skip
                print(f"{name} {' '.join(map(str, nulls)) or '-'}", end=" ", flush=True)
                print(call(*arguments), flush=True)


def subsets(places: list[int]) -> Iterator[tuple[int, ...]]:
    """Yield all of them, the empty one first."""
    for size in range(len(places) + 1):
        yield from itertools.combinations(places, size)


if __name__ == "__main__":
    main()
    sys.exit(0)
