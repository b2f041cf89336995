"""Filters of the entities of simulation_interfaces, without its messages."""

from types import SimpleNamespace

import pytest

from arm_emulator import Refusal, Session, load_scene
from emulator_node.entities import SimulationEntities


@pytest.mark.parametrize("expression", ["[", "x{1,4294967295}", "(" * 5000 + ")" * 5000])
def test_an_expression_that_python_does_not_take_is_refused_in_a_line(expression: str) -> None:
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    entities = SimulationEntities(session)
    filters = SimpleNamespace(
        filter=expression, categories=[], tags=SimpleNamespace(tags=[], filter_mode=0)
    )
    with session, pytest.raises(Refusal, match="filter must be a regular expression") as refusal:
        entities.filter_names(filters)
    assert "\n" not in str(refusal.value)
