"""Goals of runs: the exit code states whether they are reached; tables keep the arm's limits."""

import json
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from machines import GANTRY, gantry_urdf, own_three_axis
from own_firmware import command

from arm_emulator.base import warning
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.runs.target_table import check_targets, load_target_table

LIMITS = {"waist": (-2.0, 2.5, 1.5), "shoulder": (-1.0, 1.5, 2.0), "elbow": (-0.2, 2.6, 3.0)}
REST = "t,waist,shoulder,elbow\n0,0,0.5,0.8\n1,0,0.5,0.8\n"
THERE = "t,waist,shoulder,elbow\n0,0,0.5,0.8\n1,0.1,0.5,0.8\n"
STEP = "t,waist,shoulder,elbow\n0,0,0.5,0.8\n0.5,3,0.5,0.8\n0.52,3,0.5,0.8\n"


def limited(folder: Path) -> Scene:
    file = own_three_axis(folder, "")
    urdf = folder / "urdf/three_axis.urdf"
    tree = ET.parse(urdf)
    for joint in tree.iter("joint"):
        if joint.get("name") in LIMITS:
            low, high, speed = LIMITS[joint.attrib["name"]]
            joint.set("type", "revolute")
            ET.SubElement(
                joint, "limit", lower=str(low), upper=str(high), velocity=str(speed), effort="100"
            )
    tree.write(urdf)
    return load_scene(file)


@pytest.mark.parametrize(("words", "missed"), [
    ((), ""),
    (("--displacement", "0", "0.02", "0"), ""),
    (("--displacement", "0", "5", "0", "--seconds", "30"), "unreachable"),
    (("--displacement", "0", "0.05", "0", "--seconds", "0.2"), "moving"),
    ((REST,), ""),
    ((THERE,), ""),
    ((STEP,), "joint waist is "),
])  # fmt: skip
def test_a_run_that_misses_its_goal_ends_with_1_and_a_reason(
    words: tuple[str, ...],
    missed: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if words and words[0].startswith("t,"):
        (tmp_path / "table.csv").write_text(words[0])
        words = "--targets", str(tmp_path / "table.csv")
    code, out, err = command(monkeypatch, capfd, "run", "three_axis", *words, "--json")
    facts = json.loads(out)
    assert code == (1 if missed else 0), err
    assert (facts["missed"] or "").startswith(missed) and bool(facts["missed"]) == bool(missed)
    assert ("arm_emulator: run: goal not reached: " in err) == bool(missed)


def test_tables_are_refused_exactly_where_they_leave_the_limits(tmp_path: Path) -> None:
    scene = limited(tmp_path / "arm")
    low, high, speed = np.array(list(LIMITS.values())).T
    rng, refused = np.random.default_rng(16), 0
    for _ in range(300):
        K = int(rng.integers(1, 6))
        t = np.cumsum(rng.uniform(0.05, 2.0, K))
        q = rng.uniform(1.02 * low, 1.02 * high, (K, 3))
        q = scene.start + (q - scene.start) * rng.uniform(0.0, 1.0)
        outside = ((q < low) | (q > high)).any()
        # A spline may be 1.05 times as fast as its points, see `SPEED_BETWEEN_POINTS`.
        fast = (np.abs(np.diff(q, axis=0)) > 1.05 * speed * np.diff(t)[:, None]).any()
        try:
            check_targets(scene, "table", [f"line {k}" for k in range(K)], t, q)
            saved = True
        except Refusal as refusal:
            saved, text = False, str(refusal)
            assert ("limits, [" in text) == outside, text
        assert saved != bool(outside or fast), (t, q)
        refused += not saved
    assert 50 < refused < 250, "the draws are one-sided"


def test_wrong_units_are_named(tmp_path: Path) -> None:
    """Motions of a degree and more, as people write them: whole rows, and a sine."""
    scene = limited(tmp_path / "arm")
    file, rng = tmp_path / "table.csv", np.random.default_rng(17)
    free = load_scene("three_axis")
    for _ in range(20):
        K = int(rng.integers(12, 40))
        t = np.arange(K) * 0.01 * rng.integers(1, 5)
        profile = np.sin(np.linspace(0.0, rng.uniform(1.0, 6.0), K))
        q = scene.start + np.outer(profile, rng.uniform(0.1, 0.3, 3)) * min(1.0, t[-1])

        def write(t: np.ndarray, q: np.ndarray) -> None:
            rows = [",".join(f"{x:.9g}" for x in row) for row in np.column_stack([t, q])]
            file.write_text("\n".join(["t,waist,shoulder,elbow", *rows]))

        write(t, q)
        warning.issued.clear()
        for arm in (scene, free):
            load_target_table(file, arm.joint_names, partial(check_targets, arm))
        assert not warning.issued, "right units"
        write(t, np.degrees(q))
        with pytest.raises(Refusal, match=r"probably degrees"):
            load_target_table(file, scene.joint_names, partial(check_targets, scene))
        load_target_table(file, free.joint_names, partial(check_targets, free))
        assert len(warning.issued) == 1 and "not degrees" in warning.issued[0]
        write(1000.0 * t, q)
        for arm in (scene, free):
            warning.issued.clear()
            load_target_table(file, arm.joint_names, partial(check_targets, arm))
            assert len(warning.issued) == 1 and "not ms" in warning.issued[0]
    warning.issued.clear()


def test_millimetres_of_sliding_joints_are_named() -> None:
    limit = '<limit lower="0" upper="0.5" velocity="1" effort="1"/></joint>'
    urdf = gantry_urdf().replace("</joint>", limit)
    arm = cast("Scene", SimpleNamespace(
        urdf=urdf, joint_names=GANTRY, tool="z_link", start=np.zeros(3)
    ))  # fmt: skip
    t, q = np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.1, 0.4, 0.2]])
    check_targets(arm, "table", ["line 2", "line 3"], t, q)
    with pytest.raises(Refusal, match=r"line 3, x must keep .* m, got 100, probably mm"):
        check_targets(arm, "table", ["line 2", "line 3"], t, 1000.0 * q)
