"""Machines at rest without a command, with each law of friction alone."""

from __future__ import annotations

import pytest
from draws import some

from bench.at_rest import LAWS, PLACES, Case, equations_of, judge

DRY, LOADED = ("viscous", "coulomb", "breakaway"), ("load", "load and coulomb")
# Laws of one kind share a library.
CASES = [
    ("rotor", DRY, "rosenbrock", "step", True),
    ("link", DRY, "extrapolated", "located", False),
    ("rotor", LOADED, "implicit", "step", True),
    ("rotor", LOADED, "implicit", "step", False),
    ("link", LOADED, "rosenbrock", "located", False),
    *((place, (law,), "rosenbrock", "located", False) for place in PLACES for law in LAWS),
]


@pytest.mark.parametrize(("place", "laws", "scheme", "events", "weightless"), some(CASES, 3))
def test_what_nothing_holds_moves_and_what_friction_holds_rests(
    place: str, laws: tuple[str, ...], scheme: str, events: str, weightless: bool
) -> None:
    """Rotors that rub viscously ended as a divergence in 34 of 200 poses without weights."""
    equations = equations_of("three_axis")
    wrong = [
        line
        for law in laws
        for line in judge(Case("three_axis", place, law, scheme, events, weightless), 60, equations)
    ]
    assert not wrong, wrong
