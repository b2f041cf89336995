"""Numbers that pages name are those of the code."""

import re
from importlib import import_module
from typing import Any

import pytest
from documents import page_of

# Page, words with the number's place, where the number is, and in which unit the page has it.
NUMBERS: list[tuple[str, str, str, float]] = [
    (
        "motion",
        "uses {} of the description's speed limits",
        "planner.target_planner.SPEED_SHARE",
        1,
    ),
    ("motion", "deviates by more than {} rad", "planner.target_planner.LOST", 1),
    ("motion", "would take more than {} times as long", "planner.candidate_paths.MUCH_LONGER", 1),
    ("motion", "and at least {} s longer", "planner.candidate_paths.LONGER", 1),
    ("motion", "rises to its limit in {} ms", "planner.target_planner.JERK_TIME", 1e3),
    ("motion", "or in {} motion periods", "planner.target_planner.JERK_PERIODS", 1),
    ("motion", "from the line by at most {} of the reach", "trajectory.tool_line.OFF_THE_LINE", 1),
    ("motion", "Flat corners are rounded, at most {} um", "trajectory.tool_path.ROUNDED", 1e6),
    ("motion", "null-space motions of {} rad are tried", "ik.inverse_kinematics._PROBE", 1),
    ("motion", "starts from {} sets of joint angles", "ik.configuration_search.STARTS", 1),
    ("topics", "none or more than {}, stamps", "trajectory.tool_path.MAX_POSES", 1),
    ("topics", "a path longer than {} m", "trajectory.tool_path.LONGEST", 1),
    ("topics", "while it stands, again every {} s", "emulator_node.node.STATUS_PERIOD", 1),
    (
        "gains",
        "largest amplification of disturbances | {} |",
        "arm_emulator.design.joint_gains.SENSITIVITY",
        1,
    ),
    ("gains", "overshoot of the link | {} % |", "arm_emulator.design.joint_gains.OVERSHOOT", 100),
]


def plain(page: str) -> str:
    """A page's words in one line."""
    return " ".join(page_of(page).read_text(encoding="utf-8").split())


def value(place: str) -> Any:
    module, _, name = place.rpartition(".")
    if not module.startswith(("arm_emulator.", "emulator_node.")):
        module = f"arm_emulator.motion.{module}"
    return getattr(import_module(module), name)


@pytest.mark.parametrize(("page", "words", "place", "unit"), NUMBERS, ids=[n[2] for n in NUMBERS])
def test_a_page_has_the_number_of_the_code(page: str, words: str, place: str, unit: float) -> None:
    before, after = (re.escape(part) for part in words.split("{}"))
    texts = re.findall(rf"{before}([\d.e+-]*\d){after}", plain(page))
    assert [float(text) for text in texts] == [pytest.approx(unit * value(place))], texts
