"""The computations of cpp/way.h, compiled; what they take is read from that header."""

from __future__ import annotations

from arm_emulator.build.c_header import Header
from arm_emulator.build.flags import CPP_FLAGS
from arm_emulator.build.unit import Unit, compiled_once
from arm_emulator.core import CORE
from arm_emulator.motion.cpp import FOLDER

WAY = Header(FOLDER / "way.h")


def way_unit() -> Unit:
    """Return their sources."""
    source = '#include "way.cpp"\n'
    return Unit("way", source, CPP_FLAGS, (FOLDER, CORE), (WAY,), "motion", "the ways", "way.cpp")


way_library = compiled_once(way_unit)
