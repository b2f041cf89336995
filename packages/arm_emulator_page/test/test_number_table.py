"""The page's table of all joints: units, equal decimals, names as text."""

import math

import numpy as np

from arm_emulator_page.number_table import DECIMALS, format_machine


def rows_of(q: list[float]) -> list[list[str]]:
    """Return the cells of a table of joints that differ in q alone."""
    names, zeros = [f"joint_{k}" for k in range(len(q))], np.zeros(len(q))
    counts = np.full(len(q), -228991, dtype=np.int64)
    table = format_machine(
        names, q=np.array(q), v=zeros, gear=zeros, current=zeros, command=zeros, counts=counts
    )
    lines = [line for line in table.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_every_quantity_has_its_unit() -> None:
    head = rows_of([0.0])[0]
    for quantity, unit in (("q", "rad"), ("v", "rad/s"), ("gear", "N m"), ("current", "A")):
        assert f"{quantity} [{unit}]" in head


def test_numbers_have_equal_decimals() -> None:
    cells = [row[1] for row in rows_of([0.0, -1.5, 12.34567, 99999.0])[2:]]
    assert cells == ["0.0000", "-1.5000", "12.3457", "99999.0000"]
    assert {len(cell.partition(".")[2]) for cell in cells} == {DECIMALS}


def test_a_number_beyond_the_decimals_is_printed_with_its_magnitude() -> None:
    cells = [row[1] for row in rows_of([1e-6, -2.5e7, math.nan, -0.0])[2:]]
    assert cells == ["1.0e-06", "-2.5e+07", "-", "0.0000"]


def test_counts_are_integers() -> None:
    assert rows_of([0.0])[2][-1] == "-228991"
