"""Every number that a scene, a node or a message gives has the unit, default and range of a table.

The table, declared_numbers.txt, is written by hand. Tests that ask the declaration for its own
default or range cannot notice that either is wrong.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from arm_emulator.base.validation import bound
from arm_emulator.base.validation.number import REQUIRED, Number, list_numbers
from arm_emulator.machine.parts.measuring.imu import Imu
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.registry import list_kinds
from arm_emulator.machine.scene.integrator import Integrator
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.payload import COM, INERTIA, MASS
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.drive_parameters import DriveParameters
from arm_emulator.servo.servo_config import JointServo, ServoConfig
from emulator_node.node import EmulatorParameters
from servo_node.node import ServoNodeParameters

TABLE = Path(__file__).with_name("declared_numbers.txt")


class Row(NamedTuple):
    """A number: its unit, its default as text, its range."""

    unit: str
    default: str
    above: float | None = None
    at_least: float | str | None = None  # or the key of another number
    at_most: float | None = None
    in_size: bool = False
    whole: bool = False


def numbers_in(table: str) -> dict[str, dict[str, Row]]:
    result: dict[str, dict[str, Row]] = {}
    for block in table.split("\n\n"):
        lines = block.splitlines()
        headings = [line for line in lines if line.startswith("[")]
        for heading in headings:
            owner, _, unit = heading.strip("[]").partition(", U = ")
            assert owner not in result, f"{owner} has one heading"
            rows = lines[len(headings) :]
            result[owner] = dict(row_of(re.sub(r"\bU\b", unit, line)) for line in rows)
            assert len(result[owner]) == len(rows), f"{owner} has each number once"
    return result


def row_of(line: str) -> tuple[str, Row]:
    name, unit, default, words = re.split(r"  +", line)
    if default not in ("needed", "none") and not default.isalpha():
        default = str(float(default))
    ends = dict(re.findall(r"(>=|<=|>) (\S+?)(?:,|$)", words))
    if between := re.search(r"(\S+) to (\S+)$", words):
        ends[">="], ends["<="] = between.groups()
    smallest = ends.get(">=")
    return name, Row(
        "" if unit == "-" else unit,
        default,
        float(ends[">"]) if ">" in ends else None,
        smallest if smallest is None or smallest.isalpha() else float(smallest),
        float(ends["<="]) if "<=" in ends else None,
        words.startswith("size"),
        words.startswith("whole"),
    )


def declared(number: Number) -> Row:
    followed = getattr(number, "follows", None)
    default = "needed" if number.default is REQUIRED else "none" if number.default is None else None
    return Row(
        number.unit,
        followed or default or str(float(number.default)),
        number.above,
        followed or number.at_least,
        None if number.at_most is None else float(number.at_most),
        number.in_size,
        number.whole,
    )


def rows_of(numbers: Iterable[Number]) -> dict[str, Row]:
    return {number.name: declared(number) for number in numbers}


def of_class(kind: type[Any]) -> dict[str, Row]:
    return rows_of(list_numbers(kind).values())


def declarations() -> Iterator[tuple[str, dict[str, Row]]]:
    """Yield what parts, scenes, nodes and messages declare, by the headings of the table."""
    for part in list_kinds(Part):
        beside = (key for key in part.keys if isinstance(key, Number))
        yield part.name_place(), rows_of((*part.list_numbers().values(), *beside))
    yield "imus.NAME", rows_of(key for key in Imu.keys if isinstance(key, Number))
    yield "joints.NAME", of_class(Joint)
    yield "scene", of_class(Scene)
    yield "integrator", of_class(Integrator)
    yield "payload", rows_of((MASS, COM, INERTIA))
    yield "emulator", of_class(EmulatorParameters)
    yield "servo_node", of_class(ServoNodeParameters)
    yield "servo", of_class(ServoConfig)
    yield "servo joints.NAME", of_class(JointServo)
    yield "motion_controller", of_class(MotionConfig)
    yield "motion_controller joints.NAME", of_class(DriveParameters)
    b = bound
    messages = (b.POSITION, b.VELOCITY, b.ACCELERATION, b.EFFORT, b.COMMAND, b.CURRENT,
                b.BRAKE_CLOSED, b.FORCE, b.MOMENT, b.POINT)  # fmt: skip
    yield "messages and calls", rows_of((*messages, b.TOOL_POSITION.rename("tool position")))


WRITTEN, DECLARED = numbers_in(TABLE.read_text()), dict(declarations())


def test_the_table_has_all_that_declares_numbers() -> None:
    assert WRITTEN.keys() == DECLARED.keys()


@pytest.mark.parametrize("owner", DECLARED)
def test_numbers_have_the_units_defaults_and_ranges_of_the_table(owner: str) -> None:
    assert DECLARED[owner] == WRITTEN[owner]
