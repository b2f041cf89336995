"""The fault matrix: who detects faults, and how far the tool goes meanwhile."""

import csv
import math
from pathlib import Path

import pytest
from draws import FULL

from arm_emulator_campaign.fault_matrix import (
    FaultRow,
    draw_matrix,
    find_worst,
    try_faults,
    write_csv,
)

ROWS = [
    FaultRow("a.x", "x", 1.0, "1", "nobody", math.nan, 0.01),
    FaultRow("b.x", "x", 1.0, "1", "drive", 0.1, 0.02),
    FaultRow("a.y", "y", 1.0, "1", "servo", 0.2, 0.03),
]


def test_the_worst_of_each_kind_and_files(tmp_path: Path) -> None:
    assert find_worst(ROWS) == [ROWS[2], ROWS[1]]
    write_csv(ROWS, tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open() as file:
        worst = list(csv.DictReader(file))
    assert [row["fault"] for row in worst] == ["a.x", "b.x", "a.y"]
    assert float(worst[1]["travel"]) == 0.02
    draw_matrix(ROWS, "rows", tmp_path / "rows.png")
    assert (tmp_path / "rows.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.skipif(not FULL, reason="a machine with all faults compiles for 13 s")
def test_the_fault_matrix_of_the_three_axis_arm() -> None:
    rows = {row.fault: row for row in try_faults("three_axis")}
    stuck, sagging = rows["waist.encoder_stuck"], rows["supply_sags"]
    assert stuck.detected_by == "motion controller" and stuck.after < 0.5 and stuck.travel > 0.05
    assert sagging.travel == 0.0, "the move takes less than a fifth of the supply"
    # A tooth that is gone is seen by no encoder of a motor.
    assert rows["elbow.gear_breaks"].travel > 0.02
