"""The fault matrix: who detects faults, and how far the tool goes meanwhile."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from draws import FULL

from bench.fault_matrix import Row, draw, fault_matrix, worst_by_kind

ROWS = [
    Row("a.x", "x", 1.0, "1", "nobody", math.nan, 0.01),
    Row("b.x", "x", 1.0, "1", "drive", 0.1, 0.02),
    Row("a.y", "y", 1.0, "1", "servo", 0.2, 0.03),
]


def test_the_worst_of_each_kind_and_their_picture(tmp_path: Path) -> None:
    assert worst_by_kind(ROWS) == [ROWS[2], ROWS[1]]
    assert draw(ROWS, tmp_path).read_bytes()[:4] == b"\x89PNG"


@pytest.mark.skipif(not FULL, reason="a machine with all faults compiles for 13 s")
def test_the_fault_matrix_of_the_three_axis_arm() -> None:
    rows = {one.fault: one for one in fault_matrix("three_axis")}
    stuck, sagging = rows["waist.encoder_stuck"], rows["supply_sags"]
    assert stuck.detected_by == "motion controller" and stuck.after < 0.5 and stuck.travel > 0.05
    assert sagging.travel == 0.0, "the move takes less than a fifth of the supply"
    # A tooth that is gone is seen by no encoder of a motor.
    assert rows["elbow.gear_breaks"].travel > 0.02
