"""The library of the drives behind field buses, core/drives.h."""

from pathlib import Path

from arm_emulator.extension.compiler import (
    SERVO_FOLDER,
    SHARED_FLAGS,
    TICK_FOLDERS,
    Header,
    Unit,
    compile_once,
)
from arm_emulator_fieldbus import declared

DRIVES_CORE = Path(__file__).resolve().parent / "core"

# The servo's bits are those of its C library: nothing is contracted or reordered.
DRIVES_FLAGS = (
    *"-std=c++20 -O2 -fvisibility=hidden -fno-exceptions -ffp-contract=off".split(),
    *"-fno-semantic-interposition -pthread".split(),
    *SHARED_FLAGS,
)
SOURCE = f'#include "tick.c"\n#include "servo.c"\n{declared.write_source()}#include "drives.hpp"\n'

DRIVES = Header(DRIVES_CORE / "drives.h", (*TICK_FOLDERS, SERVO_FOLDER))
ETHERCAT, CANOPEN = map(DRIVES.get_constant, ("DRIVES_ETHERCAT", "DRIVES_CANOPEN"))
UNITS = DRIVES.get_constant("DRIVES_UNITS")


def drives_unit(
    name: str = "drives",
    source: str = "",
    headers: tuple[Header, ...] = (),
    about: str = "the drives behind field buses",
) -> Unit:
    """Return the drives, with a bus, as one unit to compile, the same for all scenes.

    Args:
        name: of the library.
        source: C++ that comes behind core/drives.hpp.
        headers: declare the functions that it adds.
        about: text of the line that is printed while it is compiled.
    """
    return Unit(
        name,
        SOURCE + source,
        DRIVES_FLAGS,
        (DRIVES_CORE, SERVO_FOLDER, *TICK_FOLDERS),
        (DRIVES, *headers),
        "fieldbus",
        about,
        "drives.hpp",
    )


drives_library = compile_once(drives_unit)
