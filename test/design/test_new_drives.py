"""Drives of new scenes: sized for their loads, makers' figures before rules, placeholders found."""

import dataclasses
import itertools
import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from arm_emulator.analysis.holding import compute_largest_torque, find_overloads
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.check_scene import check_scene
from arm_emulator.design import new_scene
from arm_emulator.design.data_sheets import STS3215
from arm_emulator.design.new_scene import NewScene, write_new
from arm_emulator.design.sizing import (
    MOTOR_SPEED,
    OVERSIZED,
    PLACEHOLDER,
    UNDERSIZED,
    Demand,
    size_drives,
)
from arm_emulator.design.survey import inspect_arm
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.motion.model.kinematics import Kinematics
from oracles.own_robots import OWN, RobotPart, write_serial


@pytest.fixture
def untuned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains are not computed, for which the machine is compiled: the test is of other numbers."""
    monkeypatch.setattr(new_scene, "tune_servo", lambda _, servo: servo)


@pytest.mark.parametrize("seed", range(50))
def test_a_drive_holds_and_moves_its_rated_load(seed: int) -> None:
    """For any limits in the description, or none, and from a watch to a crane."""
    draw = np.random.default_rng(seed)
    demands = []
    for k in range(int(draw.integers(1, 8))):
        largest = 10.0 ** draw.uniform(-6, 4)
        is_limited = draw.random() < 0.7
        demands.append(
            Demand(
                name=f"j{k}",
                kind=str(draw.choice(["revolute", "prismatic"])),
                start=0.0,
                inertia=(largest * 10.0 ** draw.uniform(-3, 0), largest),
                coupling=(),
                gravity_torque=(weight := largest * 10.0 ** draw.uniform(-2, 1.5) * (k % 5 > 0)),
                bare_torque=weight * draw.choice([1.0, 0.3]),
                tool_weight=weight * draw.uniform(1.0, 2.0),
                tool_inertia=largest * draw.uniform(1.0, 3.0),
                effort=10.0 ** draw.uniform(-6, 9) if is_limited else None,
                velocity=10.0 ** draw.uniform(-3, 5) if is_limited else None,
            )
        )
    N = len(demands)
    M = np.diag([demand.inertia[1] for demand in demands])
    for i, j in itertools.combinations(range(N), 2):
        M[i, j] = M[j, i] = draw.uniform() * math.sqrt(M[i, i] * M[j, j])
    demands = [
        dataclasses.replace(joint_demand, coupling=tuple(row))
        for joint_demand, row in zip(demands, M, strict=True)
    ]
    supply, drives = size_drives(demands)
    a = np.array([drive.acceleration for drive in drives])
    needs = [needed(joint_demand, [drive.speed for drive in drives]) for joint_demand in demands]
    alone = [
        links_alone(joint_demand, [drive.speed for drive in drives]) for joint_demand in demands
    ]
    for j, (demand, drive) in enumerate(zip(demands, drives, strict=True)):
        if trusted := drive.notes["torque"] == "URDF":
            assert drive.peak_torque == demand.effort >= demand.bare_torque
        else:
            assert drive.peak_torque >= 1.3 * demand.gravity_torque
        # Any one joint's acceleration, and the weight, leave some torque to every joint that has
        # some to spare.
        left = drive.peak_torque - demand.gravity_torque
        if left > 0.1 * drive.peak_torque:
            assert (M[j] * a).max() < left
        motor, gear = drive.joint.motor, drive.joint.gear
        assert isinstance(motor, DcMotor) and gear.stiffness is not None
        assert drive.acceleration > 0.0
        # Numbers are written with three digits: 1 % between them and the rule.
        current = drive.peak_torque * gear.ratio / motor.torque_constant
        back_emf = motor.back_emf_constant * drive.speed / gear.ratio
        assert motor.resistance * current + back_emf < 0.87 * supply, "the supply suffices"
        assert gear.ratio * MOTOR_SPEED == pytest.approx(drive.speed, rel=1e-2)
        rate = math.sqrt(gear.stiffness / demand.inertia[1])
        assert rate > 0.99 * 2.0 * math.pi * {"revolute": 12.0, "prismatic": 30.0}[demand.kind]
        # A count of wind-up accelerates a link by 5 % of its limit at most, or has 15 bit; no bit
        # more than that takes.
        counts = drive.joint.counts_per_turn
        swings = 2.0 * math.pi * gear.ratio / counts * gear.stiffness / demand.inertia[0]
        assert counts == 2**15 or swings < 0.0505 * drive.acceleration
        assert counts == 2**13 or swings > 0.0245 * drive.acceleration
        holds = demand.effort is not None and demand.effort >= demand.bare_torque
        moves = demand.effort is not None and demand.effort >= alone[j] / UNDERSIZED
        sane = demand.effort is not None and demand.effort <= PLACEHOLDER * needs[j]
        sane = sane and any(
            joint_demand.effort <= OVERSIZED * need
            for joint_demand, need in zip(demands, needs, strict=True)
            if joint_demand.effort is not None
        )
        assert trusted == (holds and moves and sane), "a maker's torque that holds the arm is kept"


def needed(demand: Demand, speeds: list[float]) -> float:
    """Torque for its weight with a margin, and for full speed in 0.25 s: alone, or with a tool."""
    speed = speeds[int(demand.name[1:])]
    loaded = 1.3 * demand.tool_weight + demand.tool_inertia * speed / 0.25
    return max(links_alone(demand, speeds), loaded)


def links_alone(demand: Demand, speeds: list[float]) -> float:
    """Torque without a tool, where all joints reach full speed at a time."""
    ramp = math.hypot(*(M * v for M, v in zip(demand.coupling, speeds, strict=True)))
    return 1.3 * demand.gravity_torque + ramp / 0.25


def arm(efforts: list[float | None], first_axis: str = "0 1 0") -> str:
    """An arm of three joints, 17 kg, 0.9 m, whose weight takes 55, 14 and 0.25 N m."""
    axes, lengths, masses = (first_axis, "0 1 0", "0 1 0"), (0.4, 0.4, 0.1), (8.0, 6.0, 0.5)
    parts = [
        RobotPart(axis, (length, 0.0, 0.0), mass, effort=effort, velocity=2.0)
        for axis, length, mass, effort in zip(axes, lengths, masses, efforts, strict=True)
    ]
    return write_serial("arm", parts)


def make_new(folder: Path, text: str, payload: float | None = None) -> tuple[NewScene, list[str]]:
    """Its scene, and where each torque comes from."""
    folder.mkdir()
    file = folder / "arm.urdf"
    file.write_text(text)
    written = write_new(file, folder / "new", payload=payload)
    return written, [drive.notes["torque"].partition(",")[0] for drive in written.drives]


@pytest.mark.usefixtures("untuned")
def test_a_makers_torque_remains_and_a_placeholder_is_replaced_joint_by_joint(
    tmp_path: Path,
) -> None:
    # Of 70 N m at the shoulder 55 hold it: the arm is slow, the figure stays.
    written, how = make_new(tmp_path / "weak", arm([70.0, 20.0, 1000.0]))
    assert how == ["URDF", "URDF", "guess"]
    assert [drive.peak_torque for drive in written.drives[:2]] == [70.0, 20.0]
    assert 10.0 < written.drives[2].peak_torque < 30.0, "a wrist that holds a tool of 7 kg"
    strong, how = make_new(tmp_path / "strong", arm([400.0, 100.0, None]))
    assert how == ["URDF", "URDF", "guess"]
    weak, able = ([drive.acceleration for drive in arm.drives] for arm in (written, strong))
    assert weak[0] < 0.5 * able[0], "less torque, less acceleration"
    assert weak[1:] == pytest.approx(able[1:]), "of the joint that lacks it alone"
    scene = load_scene(written.file)
    for joint, drive in zip(scene.joints, written.drives, strict=True):
        torque = compute_largest_torque(joint, scene.supply_voltage)
        assert torque == pytest.approx(drive.peak_torque, rel=1e-2), "the machine has it, too"
    assert not written.overloads


@pytest.mark.slow
def test_loads_that_the_arm_cannot_hold_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By pose and by payload; against the closed form of an arm that is stretched out."""
    text = arm([70.0, 20.0, None])
    written, how = make_new(tmp_path / "loaded", text, payload=5.0)
    assert not find_overloads(load_scene(written.file, {"payload.mass": 0.5}))
    assert how[:2] == ["URDF", "URDF"], "a payload is no reason to raise a maker's figure"
    names = {load.joint: load for load in written.overloads}
    assert set(names) == {"j1", "j2"}
    stretched = 9.81 * (8.0 * 0.2 + 6.0 * 0.6 + 0.5 * 0.85 + 5.0 * 0.9)
    assert 0.95 < names["j1"].takes / stretched <= 1.0, "the worst of the poses drawn, N m"
    assert names["j1"].gives == pytest.approx(70.0, rel=1e-2)
    capsys.readouterr()
    check_scene(str(written.file))
    warned = capsys.readouterr().err
    for joint in ("j1", "j2"):
        assert f"joints.{joint}: its motor gives" in warned
    with pytest.raises(Refusal, match="--payload must be from 0 to"):
        make_new(tmp_path / "refused", text, payload=-1.0)


@pytest.mark.usefixtures("untuned")
def test_published_figures_come_before_rules(tmp_path: Path) -> None:
    """A servo's motor is that of its data sheet: stall torque and no-load speed at its supply."""
    five = [RobotPart("0 1 0", (0.08, 0.0, 0.0), 0.1, effort=35.0, velocity=1.0)] * 5
    written, how = make_new(tmp_path / "hobby", write_serial("so101_new_calib", five))
    assert how == ["published"] * 5
    scene = load_scene(written.file)
    assert scene.supply_voltage == STS3215.supply == 12.0
    for joint in scene.joints:
        motor, Ng = joint.motor, joint.gear.ratio
        assert isinstance(motor, DcMotor)
        stall = motor.torque_constant * 12.0 / motor.resistance / Ng
        free = 12.0 / motor.back_emf_constant * Ng
        assert stall == pytest.approx(2.94, rel=1e-2) and free == pytest.approx(4.71, rel=1e-2)
    unknown, how = make_new(tmp_path / "unknown", write_serial("my_arm", five[:2]))
    assert how == ["guess"] * 2, "35 N m in every joint of an arm that needs 0.5"
    assert load_scene(unknown.file).supply_voltage == 24.0


@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_placeholder_limit_is_no_limit(kind: str, tmp_path: Path) -> None:
    """+-999999, as descriptions of mobile bases have it: the joint goes on without end.

    It has a drive all the same, whose speed, acceleration and torque references must keep.
    """
    robot = ET.fromstring(OWN["gantry" if kind == "prismatic" else "planar"]())
    joint = next(
        joint_element
        for joint_element in robot.findall("joint")
        if joint_element.get("type") == kind
    )
    limit = joint.find("limit")
    assert limit is not None
    limit.attrib |= {"lower": "-999999", "upper": "999999"}
    file = tmp_path / "endless.urdf"
    file.write_bytes(ET.tostring(robot))
    written = write_new(file, tmp_path / "endless")
    scene = load_scene(written.file)
    assert [joint.stops is None for joint in scene.joints].count(True) == 1
    assert scene.joints[scene.joint_names.index(joint.get("name", ""))].stops is None
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    assert kinematics.reach < 100.0, "m: the slide counts nothing"
    for limit in ("velocity_limit", "acceleration_limit", "effort_limit"):
        assert np.isfinite(getattr(kinematics, limit)).all(), limit


@pytest.mark.usefixtures("untuned")
def test_the_survey_bounds_the_demands_of_poses(tmp_path: Path) -> None:
    """A rod on a hinge: its inertia and weight are known in closed form."""
    length, mass = 0.5, 2.0
    file = tmp_path / "rod.urdf"
    file.write_text(write_serial("rod", [RobotPart("0 1 0", (length, 0.0, 0.0), mass, radius=0.0)]))
    scene = load_scene(write_new(file, tmp_path / "new").file)
    result = inspect_arm(scene, Kinematics(scene.urdf, scene.joint_names, scene.tool))
    np.testing.assert_allclose(result.inertia, mass * length**2 / 3.0, rtol=1e-12)
    # The heaviest of the poses drawn is not quite the horizontal one.
    assert 0.99 < result.gravity_torque[0] / (mass * 9.81 * length / 2.0) <= 1.0


@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize("share", [0.005, 0.1])
def test_a_torque_that_hardly_moves_its_joint_is_a_placeholder(
    tmp_path: Path, share: float
) -> None:
    """On a vertical axis no weight refutes it."""
    free, _ = make_new(tmp_path / "free", arm([None, 100.0, 5.0], "0 0 1"))
    needed = free.drives[0].peak_torque
    written, how = make_new(tmp_path / "weak", arm([share * needed, 100.0, 5.0], "0 0 1"))
    placeholder = share < 0.05
    assert how[0] == ("guess" if placeholder else "URDF")
    torque = written.drives[0].peak_torque
    assert torque == pytest.approx(needed if placeholder else share * needed)


@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize("last", [10.0, 9.0])
def test_a_figure_of_all_joints_that_is_impossible_for_a_joint_is_a_placeholder(
    tmp_path: Path, last: float
) -> None:
    """10 N m do not hold the second joint; about a vertical axis nothing refutes them."""
    free, _ = make_new(tmp_path / "free", arm([None, None, None], "0 0 1"))
    written, how = make_new(tmp_path / "same", arm([10.0, 10.0, last], "0 0 1"))
    if last == 10.0:
        assert how == ["guess"] * 3
        assert [drive.peak_torque for drive in written.drives] == [
            drive.peak_torque for drive in free.drives
        ]
        notes = [drive.notes["torque"] for drive in written.drives]
        assert "that of all joints, which j2 cannot have" in notes[0]
        assert "does not hold its own links" in notes[1]
    else:
        assert how == ["URDF", "guess", "URDF"]
