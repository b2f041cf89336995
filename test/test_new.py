"""From a robot description to a machine that moves."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from draws import some

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command_line import main
from arm_emulator.cli.new import write_new
from arm_emulator.design.choose_joints import LEAST_ARM, MOST_FINGER, choose_joints
from arm_emulator.design.robot_limits import read_limits
from arm_emulator.design.sizing import GRAVITY_MARGIN, LOWEST_RESONANCE, MOTOR_SPEED, Demand, size
from arm_emulator.design.survey import survey
from arm_emulator.machine.parts.dc_motor import DcMotor
from arm_emulator.machine.scene import load_scene
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.runs.gains import check_fit, load_gains
from oracles.any_arm import move, reachable
from oracles.own_robots import OWN, Part, Robot, serial

# Names that YAML, ROS or a shell might take for something else.
ODD_NAMES = [
    "on",
    "1",
    "no",
    "a.b",
    "1e3",
    "Gelenk eins",
    "ß",
    "x:y",
    "# c",
    "'q'",
    '"d"',
    "{a}",
    "~",
]


def robot_with_gripper(draw: np.random.Generator) -> tuple[str, list[str], list[str]]:
    """Return an arm with a gripper of two or more fingers, the arm's joints and the fingers'."""
    robot = Robot("gripped")
    arm = int(draw.integers(LEAST_ARM, 8))
    robot.link("base")
    at = "base"
    for k in range(arm):
        part = Part("0 1 0", (0.2, 0.0, 0.0))
        if draw.random() < 0.4:  # frames between the joints
            robot.link(f"frame{k}")
            robot.joint(f"fixed{k}", "fixed", (at, f"frame{k}"), "0 0 0", "0 0 0|")
            at = f"frame{k}"
        robot.link(f"arm{k}", part)
        robot.joint(f"a{k}", "revolute", (at, f"arm{k}"), "0.2 0 0", '0 0 0|<axis xyz="0 1 0"/>')
        at = f"arm{k}"
    fingers = []
    long = int(draw.integers(1, MOST_FINGER + 1))
    for f in range(int(draw.integers(2, 5))):
        below = at
        for k in range(long):
            name = f"f{f}{k}"
            robot.link(name, Part("0 1 0", (0.02, 0.0, 0.0), 0.01))
            mimic = '<mimic joint="f00"/>' if f and draw.random() < 0.5 else ""
            robot.joint(name, "revolute", (below, name), "0 0 0", f"0 0 0|{mimic}")
            fingers.append(name)
            below = name
    return robot.text(), [f"a{k}" for k in range(arm)], fingers


@pytest.mark.parametrize("seed", range(30))
def test_a_gripper_is_reported_from_the_arm(seed: int) -> None:
    text, arm, fingers = robot_with_gripper(np.random.default_rng(seed))
    choice = choose_joints(ET.fromstring(text), "robot")
    assert list(choice.joints) == arm
    assert sorted(choice.held) == sorted(fingers)
    whole = choose_joints(ET.fromstring(text), "robot", tool="f00")
    assert list(whole.joints) == [*arm, "f00"], "the tool that is named decides"
    some = sorted(np.random.default_rng(seed).permutation(arm)[:2].tolist(), key=arm.index)
    chosen = choose_joints(ET.fromstring(text), "robot", joints=some[::-1])
    assert list(chosen.joints) == some, "base to tool, however they are named"
    assert set(chosen.held) == {*arm, *fingers} - {*some}


def test_joints_that_are_not_in_a_row_are_refused() -> None:
    text, arm, fingers = robot_with_gripper(np.random.default_rng(0))
    robot = ET.fromstring(text)
    last = [name for name in fingers if name.endswith("0")]
    for named, words in (
        ([arm[0], *last[:2]], "be in one row" if "mimic" not in text else "--joints"),
        (["nobody"], "be joints of the robot that can move, got nobody"),
        ([], "have a joint that moves"),
    ):
        with pytest.raises(Refusal, match=words):
            choose_joints(robot, "robot", joints=named)
    with pytest.raises(Refusal, match="--tool must be a link of the robot, got nowhere"):
        choose_joints(robot, "robot", tool="nowhere")


@pytest.mark.parametrize("seed", range(50))
def test_a_drive_holds_and_moves_what_it_was_sized_for(seed: int) -> None:
    """Whatever the description states or leaves out, and from a watch to a crane."""
    draw = np.random.default_rng(seed)
    demands = []
    for k in range(int(draw.integers(1, 8))):
        most = 10.0 ** draw.uniform(-6, 4)
        given = draw.random() < 0.7
        demands.append(
            Demand(
                name=f"j{k}",
                kind=str(draw.choice(["revolute", "prismatic"])),
                start=0.0,
                inertia=(most * 10.0 ** draw.uniform(-3, 0), most),
                coupling=(),
                gravity_torque=most * 10.0 ** draw.uniform(-2, 1.5) * float(draw.random() < 0.8),
                effort=10.0 ** draw.uniform(-6, 9) if given else None,
                velocity=10.0 ** draw.uniform(-3, 5) if given else None,
            )
        )
    N = len(demands)
    M = np.diag([demand.inertia[1] for demand in demands])
    for i, j in itertools.combinations(range(N), 2):
        M[i, j] = M[j, i] = draw.uniform() * math.sqrt(M[i, i] * M[j, j])
    demands = [
        dataclasses.replace(one, coupling=tuple(row)) for one, row in zip(demands, M, strict=True)
    ]
    supply, drives = size(demands)
    a = np.array([drive.acceleration for drive in drives])
    for j, (demand, drive) in enumerate(zip(demands, drives, strict=True)):
        # Any one joint's acceleration, and the weight, leave some torque to every joint.
        assert (M[j] * a).max() + demand.gravity_torque < drive.peak_torque
        motor, gear = drive.joint.motor, drive.joint.gear
        assert isinstance(motor, DcMotor) and gear.stiffness is not None
        assert drive.peak_torque >= GRAVITY_MARGIN * demand.gravity_torque
        assert drive.acceleration > 0.0
        # Numbers are written with three digits: 1 % between them and the rule.
        current = drive.peak_torque * gear.ratio / motor.torque_constant
        back_emf = motor.back_emf_constant * drive.speed / gear.ratio
        assert motor.resistance * current + back_emf < 0.87 * supply, "the supply suffices"
        assert gear.ratio * MOTOR_SPEED == pytest.approx(drive.speed, rel=1e-2)
        rate = math.sqrt(gear.stiffness / demand.inertia[1])
        assert rate > 0.99 * LOWEST_RESONANCE[demand.kind]
        trusted = drive.notes["torque"] == "URDF"
        assert trusted == (drive.peak_torque == demand.effort), "what is reported is what is done"


@pytest.mark.parametrize("seed", some(range(2), 1))
def test_odd_names_survive_the_files(seed: int, tmp_path: Path) -> None:
    draw = np.random.default_rng(seed)
    names = draw.permutation(ODD_NAMES)[:4].tolist()
    robot = Robot("odd")
    robot.link("base of it")
    at = "base of it"
    for k, name in enumerate(names):
        robot.link(f"link {name}".replace('"', "&quot;"), Part("0 1 0", (0.2, 0.0, 0.0)))
        ends = (at, f"link {name}".replace('"', "&quot;"))
        axis = f'0 0 0|<axis xyz="0 {k % 2} {1 - k % 2}"/>'
        robot.joint(name.replace('"', "&quot;"), "continuous", ends, "0.2 0 0", axis)
        at = ends[1]
    file = tmp_path / f"{draw.choice(['an arm', 'x.y', 'on', '1', '-'])}.urdf"
    file.write_text(robot.text(), encoding="utf-8")
    written = write_new(file, tmp_path / "out")
    scene, gains = load_scene(written.file), load_gains(written.file)
    check_fit(scene, gains.servo, gains.motion)
    assert list(scene.joint_names) == names
    assert list(gains.servo.joint_names) == names
    assert scene.tool == f"link {names[-1]}"
    for joint, drive, servo in zip(scene.joints, written.drives, gains.servo.joints, strict=True):
        assert joint == drive.joint, "the file holds the numbers that were computed"
        assert servo.gear_ratio == joint.gear.ratio
        assert isinstance(joint.motor, DcMotor) and servo.resistance == joint.motor.resistance


def test_what_a_description_shows_need_not_be_sound(tmp_path: Path) -> None:
    """No name, and a look that no viewer draws: the machine is sound."""
    robot = ET.fromstring(OWN["planar"]())
    del robot.attrib["name"]
    for link in robot.findall("link"):
        link.append(ET.fromstring("<visual><geometry><cyliNder/></geometry><material/></visual>"))
    ET.SubElement(robot, "material")
    file = tmp_path / "odd.urdf"
    file.write_bytes(ET.tostring(robot))
    plain = tmp_path / "plain.urdf"
    plain.write_text(OWN["planar"]())
    drives = [write_new(one, tmp_path / one.stem).drives for one in (file, plain)]
    assert repr(drives[0]) == repr(drives[1])


def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(OWN["planar"]())
    written = write_new(file, tmp_path / "out")
    before = written.file.read_text()
    written.file.write_text(before + "# mine\n")
    with pytest.raises(Refusal, match=r"arm\.(yaml|urdf) must not be there yet"):
        write_new(file, tmp_path / "out")
    assert written.file.read_text().endswith("# mine\n")
    write_new(file, tmp_path / "out", force=True)
    assert written.file.read_text() == before, "the same robot gives the same files"


@pytest.mark.parametrize("command", ["run", "check-scene", "up", "compile"])
def test_a_robot_in_the_place_of_a_scene_is_reported_what_to_do(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    file = tmp_path / "arm.urdf"
    file.write_text(OWN["planar"]())
    monkeypatch.setattr(sys, "argv", ["arm_emulator", command, str(file)])
    with pytest.raises(SystemExit) as end:
        main()
    printed = capsys.readouterr().err.strip()
    assert end.value.code == 2 and "\n" not in printed
    assert f"`python -m arm_emulator new {file}`" in printed, printed


def test_the_description_reports_what_the_drives_can(tmp_path: Path) -> None:
    """The motion controller has its limits from there; meshes are still found."""
    text = OWN["gantry_with_turn"]().replace(
        '<link name="l1">',
        '<link name="l1"><visual><mesh filename="meshes/part one.stl"/></visual>',
    )
    file = tmp_path / "away" / "gantry.urdf"
    file.parent.mkdir()
    file.write_text(text)
    written = write_new(file, tmp_path / "new")
    scene = load_scene(written.file)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    for j, drive in enumerate(written.drives):
        assert kinematics.velocity_limit[j] == pytest.approx(drive.speed, rel=1e-5)
        assert kinematics.acceleration_limit[j] == pytest.approx(drive.acceleration, rel=1e-2)
    asked = read_limits(ET.fromstring(text))
    assert asked["j1"] == {"effort": None, "velocity": None}, "nothing was given"
    assert f"{file.parent.as_uri()}/meshes/part%20one.stl" in scene.urdf


XACRO = """<?xml version="1.0"?>
<robot name="tested" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="length" default="0.4"/>
  <xacro:macro name="rod" params="name parent">
    <link name="${name}"><inertial><origin xyz="${$(arg length) / 2} 0 0"/><mass value="2"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
    <joint name="${name}_joint" type="revolute"><parent link="${parent}"/><child link="${name}"/>
      <origin xyz="$(arg length) 0 0"/><axis xyz="0 1 0"/></joint>
  </xacro:macro>
  <link name="base"/>
  <xacro:rod name="upper" parent="base"/>
  <xacro:rod name="lower" parent="upper"/>
</robot>
"""


def test_a_xacro_source_is_expanded_with_its_arguments(tmp_path: Path) -> None:
    file = tmp_path / "rods.urdf.xacro"
    file.write_text(XACRO)
    for length, arguments in ((0.4, {}), (0.7, {"length": "0.7"})):
        written = write_new(file, tmp_path / f"{length}", arguments=arguments)
        scene = load_scene(written.file)
        assert scene.joint_names == ("upper_joint", "lower_joint")
        assert scene.chain.joints[1].p.max() == pytest.approx(length)
    file.write_text(XACRO.replace("$(arg length)", "$(arg nobody)"))
    with pytest.raises(Refusal, match=r"be what xacro expands, got .*nobody") as refusal:
        write_new(file, tmp_path / "bad")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: text.replace("inertial", "ignored"), "mass"),
        (lambda text: text.replace('type="revolute"', 'type="fixed"'), "have a joint that moves"),
        (lambda text: text.replace('type="revolute"', 'type="rubber"'), "rubber"),
        (lambda text: text.replace('lower="', 'lower="x'), "limit lower must be a number"),
        (lambda text: text[: len(text) // 2], "well-formed"),
        (lambda text: "", "well-formed"),
    ],
)
def test_a_robot_that_cannot_be_emulated_is_refused_by_name(
    spoil: object, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    file = tmp_path / "arm.urdf"
    file.write_text(spoil(OWN["five_joints"]()))  # type: ignore[operator]
    monkeypatch.setattr(
        sys, "argv", ["arm_emulator", "new", str(file), "--out", str(tmp_path / "o")]
    )
    with pytest.raises(SystemExit) as end:
        main()
    printed = capsys.readouterr().err.strip()
    assert end.value.code == 2, printed
    assert words in printed and "\n" not in printed and printed.startswith("arm.urdf"), printed
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("name", some(["telescopic", "tilted"], 1))
def test_a_new_arm_goes_where_it_is_sent(name: str, tmp_path: Path) -> None:
    """A few of the moves of `python -m bench.any_arm`."""
    file = tmp_path / f"{name}.urdf"
    file.write_text(OWN[name]())
    written = write_new(file, tmp_path / "new")
    scene, gains = load_scene(written.file), load_gains(written.file)
    limits = np.array([drive.speed for drive in written.drives])
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    rng = np.random.default_rng(3)
    for _ in range(3):
        pair = reachable(kinematics, 0.05, rng)
        assert pair is not None
        words, seconds, peak = move(scene, gains, *pair, limits)
        assert not words, words
        assert seconds < 12.0 and peak <= 1.0, f"{seconds} s, {peak} of the speed limit"


def test_the_survey_bounds_what_poses_ask_for(tmp_path: Path) -> None:
    """A rod on a hinge: its inertia and weight are known in closed form."""
    length, mass = 0.5, 2.0
    file = tmp_path / "rod.urdf"
    file.write_text(serial("rod", [Part("0 1 0", (length, 0.0, 0.0), mass, radius=0.0)]))
    scene = load_scene(write_new(file, tmp_path / "new").file)
    seen = survey(scene, Kinematics(scene.urdf, scene.joint_names, scene.tool))
    np.testing.assert_allclose(seen.inertia, mass * length**2 / 3.0, rtol=1e-12)
    # The heaviest of the poses drawn is not quite the horizontal one.
    assert 0.99 < seen.gravity_torque[0] / (mass * 9.81 * length / 2.0) <= 1.0


def test_one_command_from_a_robot_to_a_moving_arm(tmp_path: Path) -> None:
    file = tmp_path / "scara.urdf"
    file.write_text(OWN["scara"]())
    done = subprocess.run(
        [sys.executable, "-m", "arm_emulator", "demo", str(file), "--out", str(tmp_path / "out")],
        capture_output=True, text=True, timeout=300, env=os.environ, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the residual is within the prediction" in done.stdout
