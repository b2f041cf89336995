"""Every kind of fault changes the numbers that a table states, and as it states.

The table, declared_faults.txt, is written by hand; test_faults.py shows that machines follow the
declarations.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from arm_emulator.machine.faults.known import FAULTS

TABLE = Path(__file__).with_name("declared_faults.txt")
OWNERS = {"joints": "joints", "imus": "imus", "links": "links", "the machine": ""}


class Written(NamedTuple):
    """A line of the table, with those of further numbers."""

    of: str
    unit: str
    default: float
    range: tuple[float, float]
    changes: dict[str, Callable[[float, float], float]]


def formula(text: str) -> Callable[[float, float], float]:
    """Return a function of x and m from a formula as people write it, products without a sign."""
    python = re.sub(r"(?<=[\w)]) (?=[(x])", " * ", text)
    return eval(f"lambda x, m: {python}")


def faults_in(table: str) -> dict[str, Written]:
    result: dict[str, Written] = {}
    for block in table.split("\n\n")[1:]:
        lines = block.splitlines()
        headings = [line.strip("[]") for line in lines if line.startswith("[")]
        for heading in headings:
            of, *letters = heading.removeprefix("of ").split(", ")
            words = dict(letter.split(" = ") for letter in letters)
            name = ""
            for line in lines[len(headings) :]:
                for letter, word in words.items():
                    line = re.sub(rf"(?<![^\W_]){letter}(?![^\W_])", word, line)
                *numbers, change = re.split(r"  +", line)
                place, _, text = change.partition(" ")
                if numbers[0]:
                    name, unit, default, ends = numbers
                    assert name not in result, f"{name} has one line"
                    low, high = map(float, ends.split(" to "))
                    result[name] = Written(OWNERS[of], unit, float(default), (low, high), {})
                result[name].changes[place] = formula(text)
    return result


WRITTEN, DECLARED = faults_in(TABLE.read_text()), {fault.name: fault for fault in FAULTS}


def test_the_table_has_every_kind_of_fault() -> None:
    assert WRITTEN.keys() == DECLARED.keys()


@pytest.mark.parametrize("name", DECLARED)
def test_magnitude_and_changes_of_a_fault_are_those_of_the_table(name: str) -> None:
    fault, written = DECLARED[name], WRITTEN[name]
    m = fault.magnitude
    assert (fault.of, m.unit, m.default, m.ends) == written[:4]
    assert fault.sets.keys() == written.changes.keys()
    assert m.is_in_range(0.0) and m.is_in_range(m.default) and m.default
    for place, changed in written.changes.items():
        assert changed(0.7, 0.0) == 0.7 != changed(0.7, m.default), place
        for x, size in np.random.default_rng(5).uniform(0.1, 0.9, (3, 2)).tolist():
            result = eval(fault.sets[place].format(x=x, m=size))
            assert result == pytest.approx(changed(x, size), rel=1e-14), place  # some roundings
