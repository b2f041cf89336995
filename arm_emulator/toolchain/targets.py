"""Targets of compiled libraries: levels of x86-64, and this machine's processor."""

import contextlib
import platform
from functools import cache
from pathlib import Path

# Targets that code can be compiled for, best first; "native" is this machine's.
PORTABLE_TARGETS = ("x86-64-v4", "x86-64-v3", "x86-64-v2", "x86-64")


@cache
def describe_processor() -> str:
    """Return the properties that decide whether code for one machine runs on another."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith(("flags", "Features")):
                return f"{platform.machine()} {line}"
    return f"{platform.machine()} {platform.processor()}"


def is_supported_here(target: str) -> bool:
    """Whether this processor has what the x86-64 level `target` names."""
    needed = {
        "x86-64": {"sse2"},
        "x86-64-v2": {"sse4_2", "popcnt", "ssse3"},
        "x86-64-v3": {"avx2", "fma", "bmi2"},
        "x86-64-v4": {"avx512f", "avx512dq", "avx512vl", "avx512bw"},
    }[target]
    return platform.machine() in ("x86_64", "AMD64") and needed <= set(describe_processor().split())
