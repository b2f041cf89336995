"""docs/reference/faults.md: the kinds of faults, as their files declare them."""

from __future__ import annotations

from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.parts.fault import Fault

OWNERS = {"joints": "joint", "links": "link", "imus": "unit", "": "machine"}


def run(quick: bool) -> tuple[Fault, ...]:
    """Return the kinds."""
    return FAULTS


def report(kinds: tuple[Fault, ...]) -> str:
    """Return the table."""
    head = "| fault | of a | what happens | magnitude m | numbers x and what they become |"
    return "\n".join((head, "|---|---|---|---|---|", *map(_row, kinds)))


def _row(kind: Fault) -> str:
    number = kind.magnitude
    unit = "" if number.unit == "1" else f" {number.unit}"
    low, high = number.ends
    size = f"{number.default:g}{unit}, from {low:g} to {high:g}"
    by_change: dict[str, list[str]] = {}
    for place, expression in kind.sets.items():
        by_change.setdefault(expression.format(x="x", m="m"), []).append(f"`{place}`")
    sets = "; ".join(f"{', '.join(places)}: `{to}`" for to, places in by_change.items())
    return f"| `{kind.name}` | {OWNERS[kind.of]} | {kind.text} | {size} | {sets} |"
