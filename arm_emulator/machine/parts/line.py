"""The line between a controller and a joint's drive, in C++ as core/parts/line.hpp has it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from arm_emulator.machine.parts.part import Part, number

LATEST = 16.0  # servo periods


def _probability(symbol: str) -> float | None:
    found: float | None = number(symbol, "1", at_least=0.0, at_most=1.0, default=None)
    return found


def _late(symbol: str) -> float | None:
    found: float | None = number(
        symbol, "servo periods", at_least=0.0, at_most=LATEST, default=None
    )
    return found


@dataclass(frozen=True, kw_only=True)
class Line(Part):
    """A perfect line, whose numbers faults change. No scene states it."""

    section = "line"
    header = "line.hpp"
    cxx = "Line"

    command_late: float | None = _late("command.late")
    command_lost: float | None = _probability("command.lost")
    command_repeated: float | None = _probability("command.repeated")
    command_overtaken: float | None = _probability("command.overtaken")
    command_corrupted: float | None = _probability("command.corrupted")
    measurement_late: float | None = _late("measurement.late")
    measurement_lost: float | None = _probability("measurement.lost")
    measurement_repeated: float | None = _probability("measurement.repeated")
    measurement_overtaken: float | None = _probability("measurement.overtaken")
    measurement_corrupted: float | None = _probability("measurement.corrupted")
    silent: float | None = _probability("silent")
    swapped: float | None = _probability("swapped")


def lines(seed: str, joints: Iterable[str], places: Mapping[str, str]) -> str:
    """Return the function that makes the lines of a scene, empty where no fault is of them.

    Args:
        seed: of their draws, in C++.
        joints: names, base to tool.
        places: where the values of varied numbers stand, by their name.
    """
    set_here = [
        f"    all.at[{j}].{member} = {value};"
        for j, name in enumerate(joints)
        for member, value in Line().members(name, places)
    ]
    if not set_here:
        return ""
    body = "\n".join(["    arm::LineSuite<N> all;", f"    all.seed = {seed};", *set_here])
    return f"""\
  static constexpr auto lines([[maybe_unused]] const double* p) {{
{body}
    return all;
  }}
"""
