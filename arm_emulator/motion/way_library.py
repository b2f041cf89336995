"""The computations of cpp/way.h, compiled; what they take is read from that header."""

from __future__ import annotations

from functools import cache

from arm_emulator.build.c_header import Header, Library
from arm_emulator.build.flags import SHARED
from arm_emulator.build.unit import Unit, library
from arm_emulator.motion.cpp import FOLDER

WAY = Header(FOLDER / "way.h")

# Sums may be reordered for vectors; non-finite numbers are kept.
_FLAGS = (
    *"-x c++ -std=c++20 -O3 -fno-math-errno -fno-trapping-math -fno-signed-zeros".split(),
    "-fassociative-math",
    *SHARED,
)


@cache
def way_library() -> Library:
    """Return the compiled computations, compiling them if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(way_unit())


def way_unit() -> Unit:
    """Return their sources."""
    source = '#include "way.cpp"\n'
    return Unit("way", source, _FLAGS, (FOLDER,), (WAY,), "motion", "the ways", "way.cpp")
