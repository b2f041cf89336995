"""Truths of each part, written by hand: the modules of `parts`, and random numbers by them.

A module is called as the part's in `arm_emulator/machine/parts` and has, of these, what the part
has; none may follow from the part's declaration:

- `NUMBERS`: a table of name, unit, default and range, and usual values of what random machines
  have. A heading names all that have the numbers below it; U is the unit of the quantity that a
  sensor reads. "needed" has no default, "none" is a default of nothing;
- `FAULTS`: name; unit of the magnitude m; the magnitude that shows the fault well; its range; the
  change of each number x, the first number in the line of the name. S is the sensor's section;
- `OUTPUTS`, `INPUTS`: units by name. Outputs have one where the joint turns and one where it
  slides. "" is for counts, flags, bits and quantities in the unit of an input;
- `draw_section(part, rng)`: its section in a random machine, where numbers depend on each other;
- `EXCEEDED`, `measure(plant)`: a size that the quantity of a sensor exceeds in the motion of
  test/sensors/test_readings.py, and its true values by joint;
- `ON_BASE`: a C++ part of it that has another part as its base, and a number of that base;
- tests against a closed form.
"""

import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from arm_emulator.base.validation.number import REQUIRED
from arm_emulator.machine.parts.frictions.load_friction import OF_MOTOR_TORQUE
from arm_emulator.machine.parts.motors.motor import Motor, Rating
from arm_emulator.machine.parts.part import Part

Rng = np.random.Generator
Numbers = dict[str, Any]
USUAL = 4  # column of usual values


class TruthTable(NamedTuple):
    """A block of tables: its owner, letters that stand for words, columns by row."""

    owner: str
    letters: dict[str, str]
    rows: list[list[str]]


@cache
def list_truths() -> dict[str, ModuleType]:
    """Return the modules by name."""
    files = sorted(Path(__file__).with_name("parts").glob("[!_]*.py"))
    return {file.stem: importlib.import_module(f"oracles.parts.{file.stem}") for file in files}


def get_truth(part: type[Part]) -> ModuleType:
    """Return the module about a part."""
    name = part.__module__.rpartition(".")[2]
    assert name in list_truths(), f"write oracles/parts/{name}.py about {part.__name__}"
    return list_truths()[name]


def collect_truths(name: str) -> dict[str, Any]:
    """Return the values of a name in all modules that have it, by module."""
    return {
        module: getattr(truth, name)
        for module, truth in list_truths().items()
        if hasattr(truth, name)
    }


def read_tables(table: str) -> Iterator[TruthTable]:
    """Yield the blocks of a table, one for each heading."""
    for block in table.strip("\n").split("\n\n"):
        lines = block.splitlines()
        headings = [line.strip("[]") for line in lines if line.startswith("[")]
        for heading in headings:
            owner, *letters = heading.split(", ")
            words = dict(letter.split(" = ") for letter in letters)
            rows = []
            for line in lines[len(headings) :]:
                for letter, word in words.items():
                    line = re.sub(rf"(?<![^\W_]){letter}(?![^\W_])", word, line)
                rows.append(re.split(r"  +", line))
            yield TruthTable(owner, words, rows)


def draw_scaled(rng: Rng, low: float, high: float) -> float:
    """Draw a number of any scale between two: its logarithm is uniform."""
    return float(10 ** rng.uniform(np.log10(low), np.log10(high)))


def draw_part(part: type[Part], rng: Rng) -> Numbers:
    """Return the section of a random part."""
    truth = get_truth(part)
    if hasattr(truth, "draw_section"):
        numbers: Numbers = truth.draw_section(part, rng)
        return numbers
    return _draw_sized(part, rng) if issubclass(part, Motor) else _draw_usual(part, truth, rng)


def _draw_usual(part: type[Part], truth: ModuleType, rng: Rng) -> Numbers:
    """Return the section of a part, with half of what may be absent."""
    usual = {
        row[0]: row[USUAL].split(" to ")
        for block in read_tables(truth.NUMBERS)
        for row in block.rows
        if block.owner == part.name_place() and len(row) > USUAL
    }
    numbers: Numbers = {}
    for key, number in part.list_numbers().items():
        needed = number.default is REQUIRED
        if not needed and key not in usual:
            continue
        low, high = map(float, usual[key])
        if needed or rng.random() < 0.5:
            numbers[key] = (
                draw_scaled(rng, low, high) if low > 0.0 else float(rng.uniform(low, high))
            )
    return numbers


def _draw_sized(part: type[Motor], rng: Rng) -> Numbers:
    """Return the section of a motor without its rotor, as `new` sizes it."""
    rating = Rating(
        torque=draw_scaled(rng, 0.3, 1.0),
        rotor_inertia=1e-4,
        torque_constant=0.05,
        back_emf_constant=0.05,
        resistance=draw_scaled(rng, 0.5, 2.0),
        inductance=2e-3,
        bandwidth=200.0,
    )
    motor = part.size_part(rating)
    values = {key: getattr(motor, key) for key in part.list_numbers()}
    limit = motor.limit if motor.circuit is not None else ""  # it would need a loop
    return {
        key: value
        for key, value in values.items()
        if value is not None and key not in ("rotor_inertia", limit)
    }


def fit_friction_to_gear(joint: Numbers) -> None:
    """Leave out friction by a rotor's torque behind a rigid gear, which has no other torque."""
    if "stiffness" not in joint["gear"]:
        for key in OF_MOTOR_TORQUE:
            joint["motor"].get("friction", {}).pop(key, None)
