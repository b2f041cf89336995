"""Filters of the entities of simulation_interfaces, without its messages."""

from types import SimpleNamespace

import pytest

from arm_emulator import Refusal, Session, load_scene
from emulator_node.entities import SimulationEntities


def search(expression: str) -> list[str]:
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    filters = SimpleNamespace(
        filter=expression, categories=[], tags=SimpleNamespace(tags=[], filter_mode=0)
    )
    with session:
        return SimulationEntities(session).filter_names(filters)


def test_an_expression_is_searched_for_in_names() -> None:
    assert search("arm") == search("[a]rm") == ["upper_arm", "forearm"]
    assert search("^f.*m$") == ["forearm"]
    assert search("") == search(".*")


def test_an_expression_that_takes_long_is_refused() -> None:
    """It is in no name, of which it tries 8 to the power of 10 ways: minutes."""
    with pytest.raises(Refusal, match="filter must be found or not within 1 s"):
        search(rf"({r'|'.join([chr(92) + 'w'] * 8)})*#")


@pytest.mark.parametrize("expression", ["[", "x{1,4294967295}", "(" * 5000 + ")" * 5000])
def test_an_expression_that_python_does_not_take_is_refused_in_a_line(expression: str) -> None:
    with pytest.raises(Refusal, match="filter must be a regular expression") as refusal:
        search(expression)
    assert "\n" not in str(refusal.value)
