"""Processor time by which a breakpoint makes an exchange of the machine longer.

python -m bench.breakpoints
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median

from arm_emulator import Breakpoint, Plant
from arm_emulator.build.c_header import NULL
from arm_emulator.machine.formula_rows import formula_library

CASES = (
    ("three_axis", "abs(v.elbow) > 0.5"),
    ("three_axis", "abs(v.elbow) > 0.5 and tool.z < 0.4"),
    ("ur5", "abs(v.elbow_joint) > 0.5 and tool.z < 0.2"),
)
CALLS, TURNS = 200_000, 5


def cost(scene: str, condition: str) -> float:
    """Return the median of the turns [ns], without the call from Python."""
    plant = Plant(scene)
    one, take = Breakpoint(plant, condition), formula_library().breakpoint_take

    def call() -> None:
        take(one.struct, plant.machine)

    def call_nothing() -> None:
        take(NULL, plant.machine)

    return median(_each(call) - _each(call_nothing) for _ in range(TURNS))


def _each(call: Callable[[], None]) -> float:
    begin = time.thread_time_ns()
    for _ in range(CALLS):
        call()
    return (time.thread_time_ns() - begin) / CALLS


def main() -> None:
    """Measure, and print a table."""
    print("| condition | processor time [ns] |\n|---|---|")
    for scene, condition in CASES:
        print(f"| {scene}: `{condition}` | {cost(scene, condition):.0f} |")


if __name__ == "__main__":
    main()
