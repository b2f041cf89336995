"""Tables of the site that follow from what parts declare: their pages, inputs and outputs."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from arm_emulator.doors.fieldbus.declared import index_of
from arm_emulator.machine.outputs import ALWAYS, KNOWN
from arm_emulator.machine.parts.decorator import Decorator
from arm_emulator.machine.parts.imu import Imu
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.known import PARTS
from arm_emulator.machine.parts.motor import Motor
from arm_emulator.machine.parts.output import COMMAND, FURTHER, READINGS, Output
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.sensors import SENSORS
from arm_emulator.machine.schemes.known import KNOWN as SCHEMES

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "reference" / "parts"
OWNERS: tuple[type[Part] | type[Imu], ...] = (*PARTS, *SENSORS)
FIELDS = set(re.findall(r"^\w+\[\] (\w+)$", (ROOT / "msg/MotorState.msg").read_text(), re.M))
IN_C = {READINGS: "`readings`, a row", FURTHER: "`further`, a row"}
UNITS = {COMMAND: "that of the command"}


def parts(scene_page: str) -> str:
    """Return all parts of joints, with their pages.

    Args:
        scene_page: link to the page of those that have none of their own.
    """
    folder = f"{scene_page.rpartition('/')[0]}/parts"
    rows: dict[str, list[str]] = {}
    for kind in PARTS:
        found = _page(kind)
        page = f"{folder}/{found[1]}" if found else scene_page
        title = f"[{found[0] if found else _file(kind).capitalize()}]({page})"
        rows.setdefault(title, []).append(_section(kind))
    return "\n".join(
        _table(("part", "section of a joint"), ((one, ", ".join(at)) for one, at in rows.items()))
    )


def sensors(_: str) -> str:
    """Return all sensors, with their pages in the folder of the page."""
    rows = []
    for kind in SENSORS:
        found = _page(kind)
        assert found, f"{kind.__name__} has a page"
        place = _section(kind) if issubclass(kind, Imu) else _code(f"joints.NAME.{kind.section}")
        rows.append((place, _first_line(kind), f"[{found[0]}]({found[1]})"))
    return "\n".join(_table(("section", "measures", "page"), rows))


def schemes(folder: str) -> str:
    """Return all schemes, with their pages in a folder."""
    rows = []
    for k, one in enumerate(SCHEMES.values()):
        name = f"[`{one.name}`]({folder}/{one.name}.md)" + ("" if k else ", the default")
        threads = "1" if one.evaluations > 1 else "1 or 2"
        located = "yes" if one.locates else "no"
        rows.append((name, one.text, str(one.order), str(one.evaluations), threads, located))
    head = ("scheme", "what", "order", "evaluations of the links", "threads", "locates events")
    return "\n".join(_table(head, rows))


def inputs(_: str) -> str:
    """Return all inputs of motors."""
    rows = [
        [_code(one.name), one.about, _sections(owners), one.unit, _in_c(one), _object(one)]
        for one, owners in _taken().items()
    ]
    return "\n".join(_table(("input", "what", "of", "unit", "`arm.h`", "CiA 402"), rows))


def outputs(_: str) -> str:
    """Return all outputs of parts."""
    head = ("output", "what", "of", "unit", "`arm.h`", "`motor_states`", "FMU", "CiA 402")
    return "\n".join(_table(head, map(_output, KNOWN.values())))


def _page(kind: type[Part] | type[Imu]) -> tuple[str, str] | None:
    """Return title and file name of the page that is called as the file of a part."""
    page = PAGES / f"{_file(kind).replace(' ', '_')}.md"
    if not page.is_file():
        return None
    return page.read_text().partition("\n")[0].removeprefix("# "), page.name


def _file(kind: type[Part] | type[Imu]) -> str:
    return kind.__module__.rpartition(".")[2].replace("_", " ")


def _first_line(kind: type[Part] | type[Imu]) -> str:
    return (kind.__doc__ or "").partition("\n")[0].rstrip(".").removeprefix("Of ")


def _taken() -> dict[Input, list[type[Part]]]:
    taken: dict[Input, list[type[Part]]] = {}
    for kind in PARTS:
        for one in getattr(kind, "inputs", ()):
            taken.setdefault(one, []).append(kind)
    return taken


def _in_c(one: Input) -> str:
    return f"`{one.mode}`" if one.mode else "`further`, a row"


def _object(one: Input) -> str:
    return "" if one.mode else f"0x{index_of(one):04X}"


def _output(one: Output) -> list[str]:
    always = "every machine" if one in ALWAYS else ""
    unit = "that of the input" if one.symbol == FURTHER else UNITS.get(one.unit, one.unit)
    if one.kind != "number":
        unit = {"count": "counts", "flag": "0 or 1", "bits": "bits"}[one.kind]
    elif one.unit_of_slides:
        unit += f" ({one.unit_of_slides} of a slide)"
    return [
        _code(one.name),
        one.about,
        always or _sections(kind for kind in OWNERS if one in kind.outputs),
        unit,
        IN_C.get(one.symbol, _code(one.symbol)),
        _code(one.name) if one.name in FIELDS else "`readings`",
        _code(f"{one.name}.UNIT" if one.per_unit else one.name),
        f"0x{index_of(one):04X}",
    ]


def _sections(owners: Iterable[type[Part] | type[Imu]]) -> str:
    """Return where parts stand in a scene; motors by their kinds."""
    return ", ".join(dict.fromkeys(_section(one) for one in owners))


def _section(owner: type[Part] | type[Imu]) -> str:
    if issubclass(owner, Imu):
        return "`imus`"
    if issubclass(owner, Motor):
        return _code(f"motor.kind: {owner.kind}")
    kind = owner.around_kind if issubclass(owner, Decorator) else ""
    return _code(owner.section) + (f" of a `{kind}`" if kind else "")


def _code(text: str) -> str:
    return f"`{text}`"


def _table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    columns = list(head)
    lines = [columns, ["---"] * len(columns), *map(list, rows)]
    return [f"| {' | '.join(line)} |" for line in lines]
