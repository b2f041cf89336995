"""docs/reference/quantities.md: what machines take and report, and where, by what parts declare."""

from __future__ import annotations

from collections.abc import Iterable

from arm_emulator.doors.fieldbus.converter import REPORTED
from arm_emulator.machine.outputs import ALWAYS, KNOWN
from arm_emulator.machine.parts.current_loop import CurrentLoop
from arm_emulator.machine.parts.encoder import Encoder, LinkEncoder
from arm_emulator.machine.parts.imu import Imu
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.known import LOOPS, PARTS
from arm_emulator.machine.parts.motor import Motor
from arm_emulator.machine.parts.output import COMMAND, FURTHER, READINGS, Output
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.sensors import ANALOG
from arm_emulator_msgs.msg import MotorState

OWNERS: tuple[type[Part] | type[Imu], ...] = (*PARTS, Encoder, LinkEncoder, *ANALOG, Imu)
IN_C = {READINGS: "`readings`, a row", FURTHER: "`further`, a row"}
UNITS = {COMMAND: "that of the command"}


def run(quick: bool) -> tuple[list[list[str]], list[list[str]]]:
    """Return the rows of inputs and of outputs."""
    inputs = [
        [_code(one.name), one.about, _sections(owners), one.unit, _in_c(one)]
        for one, owners in _taken().items()
    ]
    return inputs, [_output(one) for one in KNOWN.values()]


def report(found: tuple[list[list[str]], list[list[str]]]) -> str:
    """Return both tables."""
    inputs, outputs = found
    return "\n".join(
        (
            *_table(("input", "what", "of", "unit", "`arm.h`"), inputs),
            "",
            *_table(
                ("output", "what", "of", "unit", "`arm.h`", "`motor_states`", "FMU", "Modbus",
                 "CiA 402"), outputs),
        )
    )  # fmt: skip


def _taken() -> dict[Input, list[type[Part]]]:
    taken: dict[Input, list[type[Part]]] = {}
    for kind in PARTS:
        for one in getattr(kind, "inputs", ()):
            taken.setdefault(one, []).append(kind)
    return taken


def _in_c(one: Input) -> str:
    return f"`{one.mode}`" if one.mode else "`further`, a row"


def _output(one: Output) -> list[str]:
    always = "every machine" if one in ALWAYS else ""
    unit = "that of the input" if one.symbol == FURTHER else UNITS.get(one.unit, one.unit)
    if one.kind != "number":
        unit = {"count": "counts", "flag": "0 or 1", "bits": "bits"}[one.kind]
    elif one.unit_of_slides:
        unit += f" ({one.unit_of_slides} of a slide)"
    fields = MotorState.get_fields_and_field_types()
    return [
        _code(one.name),
        one.about,
        always or _sections(kind for kind in OWNERS if one in kind.outputs),
        unit,
        IN_C.get(one.symbol, _code(one.symbol)),
        _code(one.name) if one.name in fields else "`readings`",
        _code(f"{one.name}.UNIT" if one.per_unit else one.name),
        "of every machine" if one.name in REPORTED else "further",
        f"0x{one.cia:04X}" if one.cia else "",
    ]


def _sections(owners: Iterable[type[Part] | type[Imu]]) -> str:
    """Return where parts stand in a scene; motors by their kinds."""
    return ", ".join(dict.fromkeys(_section(one) for one in owners))


def _section(owner: type[Part] | type[Imu]) -> str:
    if issubclass(owner, Imu):
        return "`imus`"
    if issubclass(owner, Motor):
        return _code(f"motor.kind: {owner.kind}")
    of = f" of a `{owner.around_kind}`" if owner in LOOPS and issubclass(owner, CurrentLoop) else ""
    return _code(owner.section) + of


def _code(text: str) -> str:
    return f"`{text}`"


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    columns = list(head)
    lines = [columns, ["---"] * len(columns), *map(list, rows)]
    return [f"| {' | '.join(line)} |" for line in lines]
