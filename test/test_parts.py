"""Parts of a drive: what follows from their declared numbers, and what the pages state of these."""

from __future__ import annotations

import contextlib
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import DOCS, page_of

from arm_emulator.base.number import LARGEST, REQUIRED, SMALLEST
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import Section
from arm_emulator.machine.parts.known import PARTS
from arm_emulator.machine.parts.part import Part, PartNumber
from arm_emulator.machine.parts.sensors import ANALOG, SENSOR_PARTS
from arm_emulator.machine.parts.torque_table import TorqueTable

# Other sensors have more than numbers, and a table has none: test_sensors.py, test_torque_table.py.
OF_NUMBERS = (*(part for part in PARTS if part is not TorqueTable), *ANALOG)
parts = pytest.mark.parametrize("part", OF_NUMBERS, ids=lambda part: part.__name__)


def drawn_number(one: PartNumber, rng: np.random.Generator) -> float:
    """A number within its bounds; small and large ones are as likely."""
    if one.whole:
        return int(rng.integers(int(one.least), int(one.most) + 1))
    low = one.least if one.least > -LARGEST else -1e3
    high = min(one.most, 1e3)
    if low >= 0.0:
        sign = rng.choice([-1.0, 1.0]) if one.in_size else 1.0
        return float(sign * np.exp(rng.uniform(math.log(max(low, 1e-3)), math.log(high))))
    return float(rng.uniform(low, high))


def drawn_section(part: type[Part], rng: np.random.Generator) -> dict[str, float]:
    """Numbers that a section of the part may have, with some of the optional ones left out."""
    for _ in range(50):
        data = drawn_numbers(part, rng)
        with contextlib.suppress(Refusal):  # of numbers that do not go together
            read(part, data)
            return data
    raise AssertionError(f"{part.__name__} takes no numbers")


def drawn_numbers(part: type[Part], rng: np.random.Generator) -> dict[str, float]:
    data: dict[str, float] = {}
    for key, one in part.numbers().items():
        if one.default is not REQUIRED and rng.random() < 0.3:
            continue
        value = drawn_number(one, rng)
        if one.follows is not None:
            if one.follows not in data:
                continue
            value = data[one.follows] * float(rng.uniform(1.0, 3.0))
        data[key] = value
    return data


def read(part: type[Part], data: dict[str, Any]) -> Part:
    section = Section(data, "drawn.yaml", f"joints.elbow.{part.section}")
    found = part.read(section)
    section.finish()
    return found


def out_of_bounds(key: str, one: PartNumber, data: dict[str, float]) -> list[Any]:
    bad: list[Any] = [None, "much", True, [1.0], math.nan, math.inf, -math.inf, 10**400]
    bad.append(one.most + 1e-3 * (abs(one.most) or 1.0) if one.most < LARGEST else 2.0 * LARGEST)
    if one.above is not None:
        bad += [one.above] if one.in_size else [one.above, one.above - 1.0, -LARGEST]
        bad += [0.5 * SMALLEST] if one.above == 0.0 else []
    if one.at_least is not None:
        bad.append(one.at_least - 1e-3)
    if one.follows is not None:
        bad.append(0.99 * data.get(one.follows, 0.0) - 1e-3)
    return bad


@parts
def test_numbers_are_read_as_given_or_take_their_defaults(part: type[Part]) -> None:
    rng = np.random.default_rng([len(part.__name__), 1])
    for _ in range(20):
        data = drawn_section(part, rng)
        found = read(part, data)
        for key, one in part.numbers().items():
            leader = one.follows and getattr(found, one.follows)
            expected = data.get(key, one.default if leader is None else leader)
            assert getattr(found, key) == expected, f"{key} of {data}"


@parts
def test_a_number_out_of_bounds_is_refused_by_its_key_in_one_line(part: type[Part]) -> None:
    rng = np.random.default_rng([len(part.__name__), 2])
    for key, one in part.numbers().items():
        data = drawn_section(part, rng)
        if one.follows is not None:
            data.setdefault(one.follows, 1.0)
        for bad in out_of_bounds(key, one, data):
            with pytest.raises(Refusal) as refusal:
                read(part, data | {key: bad})
            printed = str(refusal.value)
            at = f"drawn.yaml: joints.elbow.{part.section}.{key} must "
            assert printed.startswith(at) and "\n" not in printed, f"{bad!r}: {printed}"


@parts
def test_a_missing_number_and_an_unknown_one_are_refused(part: type[Part]) -> None:
    rng = np.random.default_rng([len(part.__name__), 3])
    data = drawn_section(part, rng)
    for key, one in part.numbers().items():
        if one.default is REQUIRED:
            rest = {other: value for other, value in data.items() if other != key}
            with pytest.raises(
                Refusal, match=rf"{part.section}.{key} must be a (whole )?number.*nothing"
            ):
                read(part, rest)
    with pytest.raises(Refusal, match=f"key joints.elbow.{part.section}.colour") as refusal:
        read(part, data | {"colour": 1.0})
    valid = str(refusal.value).split("valid: ")[1].split(", ")
    assert set(part.numbers()) <= set(valid), "keys that are named as valid"


@parts
def test_varied_numbers_stand_in_their_places_in_cxx(part: type[Part]) -> None:
    """Constants to the last bit, varied numbers by their place, what follows one by its ratio."""
    rng = np.random.default_rng([len(part.__name__), 4])
    for _ in range(20):
        found = read(part, drawn_section(part, rng))
        could = {one.name: one for one in found.could_vary("elbow")}
        chosen = [name for name in could if rng.random() < 0.5]
        places = {name: f"p[{k}]" for k, name in enumerate(chosen)}
        p = [could[name].value for name in chosen]
        text = found.initialiser("elbow", places)
        members = dict(re.findall(r"\.(\w+) = ([^,{}]+)", text))
        for key, one in part.numbers().items():
            value, at = getattr(found, key), f"joints.elbow.{part.section}.{key}"
            assert (at in could) == (
                one.varied and not one.whole and one.follows is None and value is not None
            ), at
            assert (one.symbol in members) == (value is not None), text
            if value is None:
                continue
            written = members[one.symbol]
            assert ("p[" in written) == (one.follows in [n.split(".")[-1] for n in chosen]
                                         if one.follows else at in chosen), text  # fmt: skip
            # One rounding where it is a ratio times its leader.
            result = eval(written, {"p": p})
            assert result == pytest.approx(value, rel=1e-15 if one.follows else 0.0, abs=0.0), text
        for name, number in could.items():
            assert number.number.least <= number.value <= number.number.most, name


def rows_of(page: Path) -> dict[str, list[str]]:
    """The table rows of a page by key: unit, range, if absent, effect."""
    rows = re.findall(r"^\| `([\w.]+)` \|(.*)\|$", page.read_text(), re.M)
    return {key: [cell.strip() for cell in rest.split("|")] for key, rest in rows}


def written_range(one: PartNumber) -> str:
    if one.whole:
        return f"whole, {one.least:g} to {one.most:g}"
    words = []
    if one.above is not None:
        words.append(f"> {one.above:g}")
    if one.at_least is not None:
        words.append(f"≥ {one.at_least:g}")
    if one.follows is not None:
        words.append(f"≥ `{one.follows}`")
    if one.at_most is not None:
        words.append(f"≤ {one.at_most:g}")
    return ("size " if one.in_size else "") + ", ".join(words)


@pytest.mark.parametrize("part", (*PARTS, *SENSOR_PARTS), ids=lambda part: part.__name__)
def test_every_key_has_a_row_with_its_unit_range_and_default(part: type[Part]) -> None:
    """In the page of its part, or in that of the scene."""
    page = DOCS / "reference" / "parts" / f"{part.__module__.rsplit('.', 1)[1]}.md"
    rows = rows_of(page if page.exists() else page_of("scene"))
    for key, one in part.numbers().items():
        at = f"{part.section}.{key}"
        assert at in rows, f"{at} in {page.name}"
        unit, bounds, absent = rows[at][:3]
        # A prismatic joint's unit follows in brackets.
        assert unit.translate(str.maketrans("²³", "23")).split(" (")[0] == one.unit, at
        assert bounds.replace(",", "").split() == written_range(one).replace(",", "").split(), at
        default = one.default
        if one.follows is not None:
            assert absent == f"`{one.follows}`", at
        elif key in getattr(part, "named_by", ()):
            assert absent not in ("", "refused"), at  # the gear is another one then
        elif default is REQUIRED:
            assert absent == "refused", at
        elif default is not None:
            assert absent == f"{default:g}", at
        else:
            assert absent not in ("", "refused", "0"), at
