"""The computations of cpp/way.h, compiled; what they take is read from that header."""

from __future__ import annotations

from arm_emulator.build.c_header import Header
from arm_emulator.build.flags import SHARED
from arm_emulator.build.unit import Unit, compiled_once
from arm_emulator.motion.cpp import FOLDER

WAY = Header(FOLDER / "way.h")

# Sums may be reordered for vectors; non-finite numbers are kept.
_FLAGS = (
    *"-x c++ -std=c++20 -O3 -fno-math-errno -fno-trapping-math -fno-signed-zeros".split(),
    "-fassociative-math",
    *SHARED,
)


def way_unit() -> Unit:
    """Return their sources."""
    source = '#include "way.cpp"\n'
    return Unit("way", source, _FLAGS, (FOLDER,), (WAY,), "motion", "the ways", "way.cpp")


way_library = compiled_once(way_unit)
