"""Tables of the site that follow from what parts declare: their pages, inputs and outputs."""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from arm_emulator.base.validation.number import REQUIRED, Number, list_numbers
from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.parts.drive_stages.drive_stage import DriveStage
from arm_emulator.machine.parts.fault import Fault
from arm_emulator.machine.parts.gears.gear import RATIO_UNIT, Gear
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.measuring.imu import Imu
from arm_emulator.machine.parts.measuring.sensors import IMU_SENSORS, SENSORS
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.parts.output import COMMAND, FURTHER, READINGS, Output
from arm_emulator.machine.parts.part import Part, PartNumber
from arm_emulator.machine.plant.outputs import ALWAYS, KNOWN
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import LINK_FRICTIONS, MOTORS, PARTS, ROTOR_FRICTIONS
from arm_emulator.machine.schemes.known import KNOWN as SCHEMES
from arm_emulator_fieldbus.declared import find_index
from docs import scene_keys as scene_keys_of

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "reference" / "parts"
OWNERS: tuple[type[Part] | type[Imu], ...] = (*PARTS, *SENSORS)
SHARED = {
    Motor.section,
    Gear.section,
    *(friction.section for friction in (*LINK_FRICTIONS, *ROTOR_FRICTIONS)),
}
SLIDES = {
    "rad": "m", "rad/s": "m/s", "N m": "N", "N m/rad": "N/m", "N m s/rad": "N s/m",
    "N m/rad3": "N/m³", RATIO_UNIT: "m/rad",
}  # fmt: skip
"""Units of sliding joints by those of joints that turn."""
FIELDS = set(re.findall(r"^\w+\[\] (\w+)$", (ROOT / "msg/MotorState.msg").read_text(), re.M))
IN_C = {READINGS: "`readings`, a row", FURTHER: "`further`, a row"}
UNITS = {COMMAND: "that of the command"}


def list_parts(scene_page: str) -> str:
    """Return all parts of joints, with their pages.

    Args:
        scene_page: link to the page of those that have none of their own.
    """
    folder = f"{scene_page.rpartition('/')[0]}/parts"
    rows: dict[str, list[str]] = {}
    for kind in PARTS:
        part_page = _find_page(kind)
        page = f"{folder}/{part_page[1]}" if part_page else scene_page
        title = f"[{part_page[0] if part_page else _find_file_name(kind).capitalize()}]({page})"
        rows.setdefault(title, []).append(_find_section(kind))
    return "\n".join(
        _write_table(
            ("part", "section of a joint"), ((part, ", ".join(at)) for part, at in rows.items())
        )
    )


def list_sensors(_: str) -> str:
    """Return all sensors, with their pages in the folder of the page."""
    rows = []
    for kind in SENSORS:
        page = _find_page(kind)
        assert page, f"{kind.__name__} has a page"
        place = (
            _find_section(kind)
            if issubclass(kind, Imu)
            else _format_code(f"joints.NAME.{kind.section}")
        )
        rows.append((place, _read_first_line(kind), f"[{page[0]}]({page[1]})"))
    return "\n".join(_write_table(("section", "measures", "page"), rows))


def list_schemes(folder: str) -> str:
    """Return all schemes, with their pages in a folder."""
    rows = []
    for k, scheme in enumerate(SCHEMES.values()):
        name = f"[`{scheme.name}`]({folder}/{scheme.name}.md)" + ("" if k else ", the default")
        threads = "1" if scheme.evaluations > 1 else "1 or 2"
        located = "yes" if scheme.locates else "no"
        rows.append(
            (name, scheme.text, str(scheme.order), str(scheme.evaluations), threads, located)
        )
    head = ("scheme", "what", "order", "evaluations of the links", "threads", "locates events")
    return "\n".join(_write_table(head, rows))


def list_faults(_: str) -> str:
    """Return the kinds of faults of parts, and of numbers of several parts."""
    owners = {"joints": "joint", "links": "link", "imus": "unit", "": "machine"}
    head = ("fault", "of a", "what happens", "magnitude m", "numbers x and what they become")
    rows = (
        [_format_code(fault.name), owners[fault.of], fault.text, *_describe_changes(fault)]
        for fault in FAULTS
    )
    return "\n".join(_write_table(head, rows))


def _describe_changes(fault: Fault) -> tuple[str, str]:
    """Return the magnitude of a fault, and the changes of numbers by it."""
    number = fault.magnitude
    unit = "" if number.unit == "1" else f" {number.unit}"
    low, high = number.ends
    by_change: dict[str, list[str]] = {}
    for place, expression in fault.sets.items():
        by_change.setdefault(expression.format(x="x", m="m"), []).append(_format_code(place))
    sets = (f"{', '.join(places)}: {_format_code(to)}" for to, places in by_change.items())
    return f"{number.default:g}{unit}, from {low:g} to {high:g}", "; ".join(sets)


def list_inputs(_: str) -> str:
    """Return all inputs of motors."""
    rows = [
        [
            _format_code(input_.name),
            input_.about,
            _list_sections(owners),
            input_.unit,
            _find_c_name(input_),
            _format_object(input_),
        ]
        for input_, owners in _list_inputs().items()
    ]
    return "\n".join(_write_table(("input", "what", "of", "unit", "`arm.h`", "CiA 402"), rows))


def list_outputs(_: str) -> str:
    """Return all outputs of parts."""
    head = ("output", "what", "of", "unit", "`arm.h`", "`motor_states`", "FMU", "CiA 402")
    return "\n".join(_write_table(head, map(_write_output_row, KNOWN.values())))


def list_keys(module: str) -> str:
    """Return the keys of the parts of a file, by their sections."""
    kinds = [owner for owner in OWNERS if owner.__module__.rpartition(".")[2] == module]
    if not kinds:
        raise KeyError(f"parts in {module}.py")
    owners = "imus" if issubclass(kinds[0], Imu) else kinds[0].owners
    return _write_keys_table(owners, (row for kind in kinds for row in _list_key_rows(kind)))


def list_joint_keys(folder: str) -> str:
    """Return the keys of a joint: of parts without a page all of them, of others their sections.

    Args:
        folder: of the pages of parts.
    """
    rows = [_write_row(key, number) for key, number in list_numbers(Joint).items()]
    kinds = ", ".join(_format_code(motor.kind) for motor in MOTORS)
    rows.append(_write_row("motor.kind", Key(
        name="", range=kinds, absent=_format_code(MOTORS[0].kind),
        text="which motor; those with a page of their own have other keys",
    )))  # fmt: skip
    of_joints = [owner for owner in OWNERS if not issubclass(owner, Imu)]
    for kind in of_joints:
        rows += [] if _find_page(kind) else _list_key_rows(kind)
    for kind in of_joints:
        if (page := _find_page(kind)) and not issubclass(kind, Motor):
            text = f"{_write_sentence(kind)}, see [{page[0]}]({folder}/{page[1]})"
            own = [f"{kind.section}.{key}" for key in getattr(kind, "named_by", ())]
            rows += [_write_row(place, Key(name="", range="" if own else "section", text=text))
                     for place in own or [kind.section]]  # fmt: skip
    return _write_keys_table("joints", rows)


def list_scene_keys(which: str) -> str:
    """Return the keys of a scene outside its joints: of the machine, or of time."""
    keys = {"machine": scene_keys_of.MACHINE, "time": scene_keys_of.TIME}[which]
    head = ("key", "unit", "range", "if absent", "effect")
    return "\n".join(
        _write_table(head, (_write_row(key, key_row) for key, key_row in keys.items()))
    )


def _write_keys_table(owners: str, rows: Iterable[list[str]]) -> str:
    head = (f"key in `{owners}.NAME`", "unit", "range", "if absent", "effect")
    first: dict[str, list[str]] = {}
    for row in rows:
        first.setdefault(row[0], row)
    return "\n".join(_write_table(head, first.values()))


def _list_key_rows(kind: type[Part] | type[Imu]) -> list[list[str]]:
    """Return the rows of a kind of part: its section, if it has one of its own, and its keys."""
    if issubclass(kind, Imu):
        own = [_write_row(key.name, key) for key in kind.keys]
        return own + [row for sensor in IMU_SENSORS for row in _list_key_rows(sensor)]
    rows = []
    if issubclass(kind, Motor):
        this = Key(
            name="",
            range=_format_code(kind.kind),
            absent=_format_code(MOTORS[0].kind),
            text="this motor",
        )
        rows.append(_write_row("motor.kind", this))
    elif kind.section not in SHARED and kind.owners == Part.owners:
        own_section = Key(name="", range="section", text=_write_sentence(kind))
        rows.append(_write_row(kind.section, own_section))
    rows += [_write_row(f"{kind.section}.{key.name}", key) for key in kind.keys]
    moves = kind.owners == Part.owners and (kind.shaft == "link" or issubclass(kind, Gear))
    for key, number in kind.list_numbers().items():
        if key in getattr(kind, "named_by", ()):
            number = replace(number, default=None)  # the part is another one then
        rows.append(_write_row(f"{kind.section}.{key}", number, moves))
    return rows


def _write_sentence(kind: type[Part] | type[Imu]) -> str:
    line = _read_first_line(kind)
    return line[0].lower() + line[1:] if line[:2] in ("A ", "An", "Th") else line


def _write_row(place: str, key: Key | Number, moves: bool = False) -> list[str]:
    """Return a row; `moves`: of a quantity that is another one of a sliding joint."""
    if isinstance(key, Key):
        return [_format_code(place), _format_unit(key.unit), key.range, key.absent, key.text]
    fall = "/s" * key.unit.endswith("/s/s")  # of a drift
    slide = SLIDES.get(key.unit.removesuffix(fall) if fall else key.unit)
    unit = f"{key.unit} ({slide}{fall})" if moves and slide else key.unit
    return [
        _format_code(place),
        _format_unit(unit),
        _describe_range(key),
        _describe_default(key),
        key.text,
    ]


def _describe_range(number: Number) -> str:
    if number.whole:
        return f"whole, {number.least:g} to {number.most:.16g}"
    words = []
    if number.above is not None:
        words.append(f"> {number.above:g}")
    if number.at_least is not None:
        words.append(f"≥ {number.at_least:g}")
    if isinstance(number, PartNumber) and number.follows is not None:
        words.append(f"≥ `{number.follows}`")
    if number.at_most is not None:
        words.append(f"≤ {number.at_most:g}")
    return ("size " if number.in_size else "") + ", ".join(words)


def _describe_default(number: Number) -> str:
    if isinstance(number, PartNumber) and number.follows is not None:
        return _format_code(number.follows)
    if number.default is REQUIRED:
        return "refused"
    if number.default is None:
        return number.absent if isinstance(number, PartNumber) else "none"
    return f"{number.default:g}"


def _format_unit(unit: str) -> str:
    return re.sub(r"(?<=[a-z])[23]\b", lambda match: "²³"[int(match[0]) - 2], unit)


def _find_page(kind: type[Part] | type[Imu]) -> tuple[str, str] | None:
    """Return title and file name of the page that is called as the file of a part."""
    page = PAGES / f"{_find_file_name(kind).replace(' ', '_')}.md"
    if not page.is_file():
        return None
    return page.read_text().partition("\n")[0].removeprefix("# "), page.name


def _find_file_name(kind: type[Part] | type[Imu]) -> str:
    return kind.__module__.rpartition(".")[2].replace("_", " ")


def _read_first_line(kind: type[Part] | type[Imu]) -> str:
    return (kind.__doc__ or "").partition("\n")[0].rstrip(".").removeprefix("Sensor of ")


def _list_inputs() -> dict[Input, list[type[Part]]]:
    taken: dict[Input, list[type[Part]]] = {}
    for kind in PARTS:
        for input_ in getattr(kind, "inputs", ()):
            taken.setdefault(input_, []).append(kind)
    return taken


def _find_c_name(input_: Input) -> str:
    return f"`{input_.mode}`" if input_.mode else "`further`, a row"


def _format_object(input_: Input) -> str:
    return "" if input_.mode else f"0x{find_index(input_):04X}"


def _write_output_row(output: Output) -> list[str]:
    always = "every machine" if output in ALWAYS else ""
    unit = "that of the input" if output.symbol == FURTHER else UNITS.get(output.unit, output.unit)
    if output.kind != "number":
        unit = {"count": "counts", "flag": "0 or 1", "bits": "bits"}[output.kind]
    elif output.unit_of_slides:
        unit += f" ({output.unit_of_slides} of a slide)"
    return [
        _format_code(output.name),
        output.about,
        always or _list_sections(kind for kind in OWNERS if output in kind.outputs),
        unit,
        IN_C.get(output.symbol, _format_code(output.symbol)),
        _format_code(output.name) if output.name in FIELDS else "`readings`",
        _format_code(f"{output.name}.UNIT" if output.per_unit else output.name),
        f"0x{find_index(output):04X}",
    ]


def _list_sections(owners: Iterable[type[Part] | type[Imu]]) -> str:
    """Return where parts stand in a scene; motors by their kinds."""
    return ", ".join(dict.fromkeys(_find_section(owner) for owner in owners))


def _find_section(owner: type[Part] | type[Imu]) -> str:
    if issubclass(owner, Imu):
        return "`imus`"
    if issubclass(owner, Motor):
        return _format_code(f"motor.kind: {owner.kind}")
    kind = owner.around_kind if issubclass(owner, DriveStage) else ""
    return _format_code(owner.section) + (f" of a `{kind}`" if kind else "")


def _format_code(text: str) -> str:
    return f"`{text}`"


def _write_table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    columns = list(head)
    lines = [columns, ["---"] * len(columns), *map(list, rows)]
    return [f"| {' | '.join(line)} |" for line in lines]
