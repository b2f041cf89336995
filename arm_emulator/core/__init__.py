"""The machine in C++20, compiled per scene; what imports what is in CONTRIBUTING.md."""

from pathlib import Path

CORE = Path(__file__).resolve().parent
BOUNDARY = CORE / "boundary"  # headers in C, for control code and libraries beside a machine
