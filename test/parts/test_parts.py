"""Parts of a drive: what follows from their declared numbers, and what the pages state of these."""

import contextlib
import math
import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import DOCS

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import LARGEST, REQUIRED, SMALLEST
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.joint_effects.torque_table import TorqueTable
from arm_emulator.machine.parts.measuring.encoder import Encoder
from arm_emulator.machine.parts.measuring.sensors import ANALOG, SENSOR_PARTS
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.parts.part import Part, PartNumber
from arm_emulator.machine.parts.registry import list_kinds
from arm_emulator.machine.scene.known_parts import PARTS
from oracles.part_truths import draw_part, get_truth, list_truths

# Other sensors have more than numbers, and a table has none: test_sensors.py, test_torque_table.py.
OF_NUMBERS = (*(part for part in PARTS if part is not TorqueTable), *ANALOG)
parts = pytest.mark.parametrize("part", OF_NUMBERS, ids=lambda part: part.__name__)


def draw_number(number: PartNumber, rng: np.random.Generator) -> float:
    """A number within its bounds; small and large ones are as likely."""
    if number.whole:
        return int(rng.integers(int(number.least), int(number.most) + 1))
    low = number.least if number.least > -LARGEST else -1e3
    high = min(number.most, 1e3)
    if low >= 0.0:
        sign = rng.choice([-1.0, 1.0]) if number.in_size else 1.0
        return float(sign * np.exp(rng.uniform(math.log(max(low, 1e-3)), math.log(high))))
    return float(rng.uniform(low, high))


def draw_section(part: type[Part], rng: np.random.Generator) -> dict[str, float]:
    """Numbers that a section of the part may have, with some of the optional ones left out."""
    for _ in range(50):
        data = draw_numbers(part, rng)
        with contextlib.suppress(Refusal):  # of numbers that do not go together
            read(part, data)
            return data
    raise AssertionError(f"{part.__name__} takes no numbers")


def draw_numbers(part: type[Part], rng: np.random.Generator) -> dict[str, float]:
    data: dict[str, float] = {}
    for key, number in part.list_numbers().items():
        if number.default is not REQUIRED and rng.random() < 0.3:
            continue
        value = draw_number(number, rng)
        if number.follows is not None:
            if number.follows not in data:
                continue
            value = data[number.follows] * float(rng.uniform(1.0, 3.0))
        data[key] = value
    return data


def read(part: type[Part], data: dict[str, Any]) -> Part:
    section = Section(data, "drawn.yaml", f"joints.elbow.{part.section}")
    part_read = part.read_section(section)
    section.refuse_unread_keys()
    return part_read


def out_of_bounds(key: str, number: PartNumber, data: dict[str, float]) -> list[Any]:
    bad: list[Any] = [None, "much", True, [1.0], math.nan, math.inf, -math.inf, 10**400]
    bad.append(
        number.most + 1e-3 * (abs(number.most) or 1.0) if number.most < LARGEST else 2.0 * LARGEST
    )
    if number.above is not None:
        bad += [number.above] if number.in_size else [number.above, number.above - 1.0, -LARGEST]
        bad += [0.5 * SMALLEST] if number.above == 0.0 else []
    if number.at_least is not None:
        bad.append(number.at_least - 1e-3)
    if number.follows is not None:
        bad.append(0.99 * data.get(number.follows, 0.0) - 1e-3)
    return bad


@parts
def test_numbers_are_read_from_the_file_or_take_their_defaults(part: type[Part]) -> None:
    rng = np.random.default_rng([len(part.__name__), 1])
    for _ in range(20):
        data = draw_section(part, rng)
        part_read = read(part, data)
        for key, number in part.list_numbers().items():
            followed = number.follows and getattr(part_read, number.follows)
            expected = data.get(key, number.default if followed is None else followed)
            assert getattr(part_read, key) == expected, f"{key} of {data}"


@parts
def test_a_number_out_of_bounds_is_refused_by_its_key_in_a_line(part: type[Part]) -> None:
    rng = np.random.default_rng([len(part.__name__), 2])
    for key, number in part.list_numbers().items():
        data = draw_section(part, rng)
        if number.follows is not None:
            data.setdefault(number.follows, 1.0)
        for bad in out_of_bounds(key, number, data):
            with pytest.raises(Refusal) as refusal:
                read(part, data | {key: bad})
            printed = str(refusal.value)
            at = f"drawn.yaml: joints.elbow.{part.section}.{key} must "
            assert printed.startswith(at) and "\n" not in printed, f"{bad!r}: {printed}"


@parts
def test_a_missing_number_and_an_unknown_number_are_refused(part: type[Part]) -> None:
    rng = np.random.default_rng([len(part.__name__), 3])
    data = draw_section(part, rng)
    for key, number in part.list_numbers().items():
        if number.default is REQUIRED:
            rest = {name: value for name, value in data.items() if name != key}
            with pytest.raises(
                Refusal, match=rf"{part.section}.{key} must be a (whole )?number.*nothing"
            ):
                read(part, rest)
    with pytest.raises(Refusal, match=f"key joints.elbow.{part.section}.colour") as refusal:
        read(part, data | {"colour": 1.0})
    valid = str(refusal.value).split("valid: ")[1].split(", ")
    assert set(part.list_numbers()) <= set(valid), "keys that are named as valid"


@parts
def test_varied_numbers_stand_in_their_places_in_cxx(part: type[Part]) -> None:
    """Constants to the last bit, varied numbers by their place, what follows one by its ratio."""
    rng = np.random.default_rng([len(part.__name__), 4])
    for _ in range(20):
        instance = read(part, draw_section(part, rng))
        could = {varied.name: varied for varied in instance.list_variable_numbers("elbow")}
        chosen = [name for name in could if rng.random() < 0.5]
        places = {name: f"p[{k}]" for k, name in enumerate(chosen)}
        p = [could[name].value for name in chosen]
        text = instance.write_initialiser("elbow", places)
        members = dict(re.findall(r"\.(\w+) = ([^,{}]+)", text))
        for key, quantity in part.list_numbers().items():
            value, at = getattr(instance, key), f"joints.elbow.{part.section}.{key}"
            assert (at in could) == (
                quantity.varied
                and not quantity.whole
                and quantity.follows is None
                and value is not None
            ), at
            assert (quantity.symbol in members) == (value is not None), text
            if value is None:
                continue
            written = members[quantity.symbol]
            assert ("p[" in written) == (quantity.follows in [n.split(".")[-1] for n in chosen]
                                         if quantity.follows else at in chosen), text  # fmt: skip
            # One rounding where it is a ratio times its leader.
            result = eval(written, {"p": p})
            assert result == pytest.approx(
                value, rel=1e-15 if quantity.follows else 0.0, abs=0.0
            ), text
        for name, number in could.items():
            assert number.number.least <= number.value <= number.number.most, name


TESTS = Path(__file__).parents[1]
TABLES = runpy.run_path(str(DOCS / "tables.py"))


def rows_of(table: str) -> dict[str, list[str]]:
    """The rows of a table by key: unit, range, if absent, effect."""
    rows = re.findall(r"^\| `([\w.]+)` \|(.*)\|$", table, re.M)
    return {key: [cell.strip() for cell in rest.split("|")] for key, rest in rows}


def keys_of(part: type[Part]) -> dict[str, list[str]]:
    """The rows of a part in the table of its page, or in that of joints, below its section."""
    module = part.__module__.rsplit(".", 1)[1]
    page = DOCS / "reference" / "parts" / f"{module}.md"
    line = f"<!-- generated: keys {module} -->\n"
    assert not page.exists() or line in page.read_text(), f"{page.name} has its table"
    table = TABLES["list_keys"](module) if page.exists() else TABLES["list_joint_keys"]("parts")
    of = f"{part.section}."
    return {key.removeprefix(of): row for key, row in rows_of(table).items() if key.startswith(of)}


class ReadSection(Section):
    """A section that knows which keys its reader has asked for."""

    @property
    def keys_read(self) -> set[str]:
        return self._read_keys


def supply(part: type[Part], rng: np.random.Generator) -> dict[str, Any]:
    """A section of a part that is sound."""
    if issubclass(part, Encoder):
        return {"counts_per_turn": 1000}
    if part in SENSOR_PARTS:
        return dict(draw_numbers(part, rng))
    return ({"rotor_inertia": 1e-4} if issubclass(part, Motor) else {}) | draw_part(part, rng)


@pytest.mark.parametrize("part", (*PARTS, *SENSOR_PARTS), ids=lambda part: part.__name__)
def test_the_table_of_a_part_has_the_keys_that_its_reader_knows(part: type[Part]) -> None:
    section = ReadSection(supply(part, np.random.default_rng(3)), "drawn.yaml", part.section)
    if issubclass(part, JointEffect):
        part.put_limits(section, None)
    part.read_section(section)
    rows = keys_of(part)
    declared = {*part.list_numbers(), *(key.name for key in part.keys)}
    assert declared <= rows.keys() and all(rows[key][3] for key in declared), "what each is"
    of_others = {kind.section.partition(".")[2] for kind in PARTS}
    sections = {key.partition(".")[0] for key in declared}
    assert section.keys_read - of_others == sections - of_others


# Parts of nearly every scene, whose equations stand in docs/concepts/physics.md.
IN_PHYSICS = {"dc_motor", "elastic_gear", "gear", "progressive_gear"}


@pytest.mark.parametrize("part", (*PARTS, *SENSOR_PARTS), ids=lambda part: part.__name__)
def test_a_part_has_its_page_and_a_test_with_it(part: type[Part]) -> None:
    module = part.__module__.rsplit(".", 1)[1]
    page = DOCS / "reference" / "parts" / f"{module}.md"
    assert page.exists() or module in IN_PHYSICS, f"write {page.relative_to(DOCS.parent)}"
    labels = (
        part.section.rpartition(".")[2],
        getattr(part, "kind", ""),
        *vars(part).get("named_by", ()),
    )
    name = re.compile("|".join(rf'"{word}"|\b{part.__name__}\b' for word in labels if word))
    tests = (file for file in TESTS.glob("*/test_*.py") if file != Path(__file__))
    # `measure` is what test_readings.py tests a sensor with.
    own = any(key == "measure" or key.startswith("test_") for key in vars(get_truth(part)))
    assert own or any(name.search(file.read_text()) for file in tests), (
        f"write a test into oracles/parts/{module}.py"
    )


def test_every_truth_is_of_a_part() -> None:
    """One whose part has another name, or is gone, would judge nothing."""
    owners = {part.__module__.rpartition(".")[2] for part in (*list_kinds(Part), *SENSOR_PARTS)}
    assert set(list_truths()) == owners | {"analog_sensor"}  # what six of them share


def test_rows_state_units_ranges_and_defaults() -> None:
    """As people write them, of numbers of each kind."""
    pages = ("end_stops", "pmsm", "friction", "winding", "tachometer")
    tables = [TABLES["list_joint_keys"]("parts"), *(TABLES["list_keys"](page) for page in pages)]
    rows = {key: row for table in tables for key, row in rows_of(table).items()}
    expected = {
        "end_stops.stiffness": ["N m/rad (N/m)", "> 0", "refused"],
        "end_stops.damping": ["N m s/rad (N s/m)", "≥ 0", "0"],
        "motor.pole_pairs": ["pairs", "whole, 1 to 1000", "refused"],
        "motor.rotor_inertia": ["kg m²", "> 0", "refused"],
        "friction.breakaway": ["N m (N)", "≥ `coulomb`", "`coulomb`"],
        "motor.friction.coulomb": ["N m", "≥ 0", "0"],
        "motor.winding.ambient": ["degC", "≥ -50, ≤ 150", "20"],
        "motor.winding.limit": ["degC", "> 0, ≤ 1000", "none"],
        "tachometer.drift": ["rad/s/s (m/s/s)", "≥ -1e+06, ≤ 1e+06", "none"],
        "gear.ratio": ["link turns per motor turn (m/rad)", "size > 0, ≤ 1000", "refused"],
        "gear.cubic_stiffness": ["N m/rad³ (N/m³)", "≥ 0", "none"],
        "start": ["rad or m", "≥ -10000, ≤ 10000", "0"],
    }
    assert {key: rows[key][:3] for key in expected} == expected
