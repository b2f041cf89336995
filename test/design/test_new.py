"""From a robot description to a machine that moves."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from draws import some, with_slow
from test_new_drives import untuned

from arm_emulator import Kinematics, Refusal, load_gains, load_scene
from arm_emulator.cli.command_line import main
from arm_emulator.cli.commands.tune import tune_scene
from arm_emulator.design.choose_joints import MAX_FINGER, MIN_ARM, choose_joints
from arm_emulator.design.new_scene import write_new
from arm_emulator.design.robot_file import read_limits
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.runs.gains import check_fit
from oracles.any_arm import draw_reachable, move_arm
from oracles.own_robots import OWN, Robot, RobotPart, write_serial

__all__ = ["untuned"]  # a fixture

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
    "[q]",
    "a: b",
    "-",
    "null",
]


def robot_with_gripper(draw: np.random.Generator) -> tuple[str, list[str], list[str]]:
    """Return an arm with a gripper of two or more fingers, the arm's joints and the fingers'."""
    robot = Robot("gripped")
    arm = int(draw.integers(MIN_ARM, 8))
    robot.add_link("base")
    at = "base"
    for k in range(arm):
        part = RobotPart("0 1 0", (0.2, 0.0, 0.0))
        if draw.random() < 0.4:  # frames between the joints
            robot.add_link(f"frame{k}")
            robot.add_joint(f"fixed{k}", "fixed", (at, f"frame{k}"), "0 0 0", "0 0 0|")
            at = f"frame{k}"
        robot.add_link(f"arm{k}", part)
        robot.add_joint(
            f"a{k}", "revolute", (at, f"arm{k}"), "0.2 0 0", '0 0 0|<axis xyz="0 1 0"/>'
        )
        at = f"arm{k}"
    fingers = []
    long = int(draw.integers(1, MAX_FINGER + 1))
    for f in range(int(draw.integers(2, 5))):
        below = at
        for k in range(long):
            name = f"f{f}{k}"
            robot.add_link(name, RobotPart("0 1 0", (0.02, 0.0, 0.0), 0.01))
            mimic = '<mimic joint="f00"/>' if f and draw.random() < 0.5 else ""
            robot.add_joint(name, "revolute", (below, name), "0 0 0", f"0 0 0|{mimic}")
            fingers.append(name)
            below = name
    return robot.write_urdf(), [f"a{k}" for k in range(arm)], fingers


@pytest.mark.parametrize("seed", with_slow(range(30), 10))
def test_a_gripper_is_distinguished_from_the_arm(seed: int) -> None:
    text, arm, fingers = robot_with_gripper(np.random.default_rng(seed))
    choice = choose_joints(ET.fromstring(text), "robot")
    assert list(choice.joints) == arm
    assert sorted(choice.locked) == sorted(fingers)
    to_tool = choose_joints(ET.fromstring(text), "robot", tool="f00")
    assert list(to_tool.joints) == [*arm, "f00"], "the tool that is named decides"
    some = sorted(np.random.default_rng(seed).permutation(arm)[:2].tolist(), key=arm.index)
    chosen = choose_joints(ET.fromstring(text), "robot", joints=some[::-1])
    assert list(chosen.joints) == some, "base to tool, however they are named"
    assert set(chosen.locked) == {*arm, *fingers} - {*some}


@pytest.mark.parametrize("seed", range(3))
def test_a_tree_has_arm_and_fingers(seed: int) -> None:
    """All of them move, those that follow others along; the tool remains that of the arm."""
    text, arm, fingers = robot_with_gripper(np.random.default_rng(seed))
    robot = ET.fromstring(text)
    alone, full_tree = choose_joints(robot, "robot"), choose_joints(robot, "robot", tree=True)
    follow = {
        joint.get("name") for joint in robot.findall("joint") if joint.find("mimic") is not None
    }
    assert {*full_tree.joints} == {*arm, *fingers} - follow
    assert not full_tree.locked and full_tree.tool == alone.tool
    assert set(alone.locked) == {*fingers}
    named = choose_joints(robot, "robot", joints=[*arm, *({*fingers} - follow)], tool=alone.tool)
    assert named.joints == full_tree.joints and not named.locked, "by name"


@pytest.mark.parametrize("joints", [5, 6, 7])
def test_rods_of_a_palletizer_beside_its_wrist_are_no_gripper(joints: int) -> None:
    """As in descriptions of large arms: they follow the elbow, from the upper arm and forearm."""
    parts = [RobotPart("0 1 0", (0.5, 0.0, 0.0))] * joints
    rods = "".join(
        f'<link name="rod{k}"/><joint name="r{k}" type="continuous"><parent link="l{k}"/>'
        f'<child link="rod{k}"/><mimic joint="j3" multiplier="{multiplier}"/></joint>'
        for k, multiplier in ((2, -1), (3, 1))
    )
    text = write_serial("arm", parts).replace("</robot>", f"{rods}</robot>")
    choice = choose_joints(ET.fromstring(text), "robot")
    assert choice.joints == tuple(f"j{k + 1}" for k in range(joints))
    assert choice.tool == "tool0" and set(choice.locked) == {"r2", "r3"}


def test_joints_that_cannot_move_are_refused() -> None:
    text, *_ = robot_with_gripper(np.random.default_rng(0))
    robot = ET.fromstring(text)
    for named, words in (
        (["nobody"], "be joints of the robot that can move, got nobody"),
        ([], "have a joint that moves"),
    ):
        with pytest.raises(Refusal, match=words):
            choose_joints(robot, "robot", joints=named)
    with pytest.raises(Refusal, match="--tool must be a link of the robot, got nowhere"):
        choose_joints(robot, "robot", tool="nowhere")


# Without a payload it is the arm of the demo below, whose machine is there.
@pytest.mark.slow
@pytest.mark.parametrize("payload", some([None, 3.0], 1))
def test_new_and_tune_agree(payload: float | None, tmp_path: Path) -> None:
    (tmp_path / "scara.urdf").write_text(OWN["scara"]())
    file = write_new(tmp_path / "scara.urdf", tmp_path / "new", payload=payload).file
    servo = load_gains(file).servo
    assert tune_scene(str(file), write=True) == 0
    assert load_gains(file).servo == servo


@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize("seed", some(range(2), 1))
def test_odd_names_survive_the_files(seed: int, tmp_path: Path) -> None:
    draw = np.random.default_rng(seed)
    names = draw.permutation(ODD_NAMES)[:4].tolist()
    robot = Robot("odd")
    robot.add_link("base of it")
    at = "base of it"
    for k, name in enumerate(names):
        robot.add_link(f"link {name}".replace('"', "&quot;"), RobotPart("0 1 0", (0.2, 0.0, 0.0)))
        ends = (at, f"link {name}".replace('"', "&quot;"))
        axis = f'0 0 0|<axis xyz="0 {k % 2} {1 - k % 2}"/>'
        robot.add_joint(name.replace('"', "&quot;"), "continuous", ends, "0.2 0 0", axis)
        at = ends[1]
    file = tmp_path / f"{draw.choice(['an arm', 'x.y', 'on', '1', '-'])}.urdf"
    file.write_text(robot.write_urdf(), encoding="utf-8")
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


BODY = "<collision><geometry>{}</geometry></collision>"


def with_shapes(shapes: dict[str, str]) -> ET.Element:
    """Return `five_joints` with shapes for collisions by links."""
    robot = ET.fromstring(OWN["five_joints"]())
    for link in robot.findall("link"):
        if link.get("name") in shapes:
            link.append(ET.fromstring(BODY.format(shapes[link.get("name", "")])))
    return robot


@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize(
    ("shapes", "parameter", "reason"),
    [
        ({}, "auto", "no parts of the arm can touch"),
        ({"base": '<box size="0.2 0.2 0.2"/>', "l4": '<sphere radius="0.05"/>'}, "stop", "before"),
        ({"base": '<mesh filename="package://none/x.stl"/>'}, "off", "cannot be read"),
        (
            {"base": '<mesh filename="package://bodies/x.stl"/>', "l4": '<sphere radius="0.05"/>'},
            "stop",
            "before",
        ),
    ],
)
def test_a_new_arm_does_not_collide_with_its_own_links(
    shapes: dict[str, str], parameter: str, reason: str, tmp_path: Path
) -> None:
    """It does not if its shapes can be read, those of a package beside the description included."""
    (tmp_path / "bodies").mkdir()
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, -0.1)]
    faces = [[corners[k] for k in range(4) if k != left] for left in range(4)]
    rows = ["".join("vertex {} {} {}\n".format(*corner) for corner in face) for face in faces]
    loops = [f"facet normal 0 0 0\nouter loop\n{row}endloop\nendfacet\n" for row in rows]
    (tmp_path / "bodies" / "x.stl").write_text("solid x\n" + "".join(loops) + "endsolid x\n")
    file = tmp_path / "arm.urdf"
    file.write_bytes(ET.tostring(with_shapes(shapes)))
    written = write_new(file, tmp_path / "elsewhere" / "arm")
    text = (written.file.parent / "motion" / "arm.yaml").read_text()
    assert reason in next(line for line in text.splitlines() if "collisions:" in line)
    config = load_gains(written.file).motion
    assert config.collisions == parameter
    scene = load_scene(written.file)
    make_controller(scene.urdf, scene.joint_names, config)  # takes its shapes, from there


@pytest.mark.usefixtures("untuned")
def test_a_rate_below_zero_is_unknown(tmp_path: Path) -> None:
    """-1 for all efforts and speeds: the same drives as without them."""
    robots = [ET.fromstring(OWN["planar"]()) for _ in range(2)]
    for limit in robots[1].iter("limit"):
        limit.attrib |= {"effort": "-1", "velocity": "-1.0"}
    drives = []
    for k, robot in enumerate(robots):
        file = tmp_path / f"arm{k}.urdf"
        file.write_bytes(ET.tostring(robot))
        drives.append(write_new(file, tmp_path / file.stem).drives)
    assert repr(drives[0]) == repr(drives[1])


@pytest.mark.usefixtures("untuned")
def test_bodies_that_are_points_are_taken(tmp_path: Path) -> None:
    """Their inertia about the centre is what rounding leaves of that about the joint."""
    robot = ET.fromstring(OWN["planar"]())
    for body in robot.iter("inertial"):
        mass, inertia, origin = (body.find(name) for name in ("mass", "inertia", "origin"))
        assert mass is not None and inertia is not None and origin is not None
        mass.set("value", "0.3629")
        origin.set("xyz", "-1.29671681e-05 -9.96483011e-05 -0.0235253287")
        inertia.attrib |= dict.fromkeys(("ixx", "iyy", "izz"), "0")
    file = tmp_path / "slender.urdf"
    file.write_bytes(ET.tostring(robot))
    assert len(load_scene(write_new(file, tmp_path / "slender").file).joints) == 2


@pytest.mark.usefixtures("untuned")
def test_visual_shapes_of_a_description_may_be_unsound(tmp_path: Path) -> None:
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
    drives = [write_new(source, tmp_path / source.stem).drives for source in (file, plain)]
    assert repr(drives[0]) == repr(drives[1])


@pytest.mark.usefixtures("untuned")
def test_existing_files_are_not_overwritten(tmp_path: Path) -> None:
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
def test_a_robot_in_place_of_a_scene_is_refused_with_the_command_to_use(
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
    assert f"`arm_emulator new {file}`" in printed, printed


@pytest.mark.usefixtures("untuned")
def test_the_description_reports_the_abilities_of_the_drives(tmp_path: Path) -> None:
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
    limits = read_limits(ET.fromstring(text))
    assert limits["j1"] == {"effort": None, "velocity": None}, "nothing was given"
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


@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize("name", ["rods.urdf.xacro", "rods.urdf"])
def test_a_xacro_source_is_expanded_with_its_arguments(name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text(XACRO)
    for length, arguments in ((0.4, {}), (0.7, {"length": "0.7"})):
        written = write_new(file, tmp_path / f"{length}", arguments=arguments)
        scene = load_scene(written.file)
        assert scene.joint_names == ("upper_joint", "lower_joint")
        assert scene.chain.joints[1].p.max() == pytest.approx(length)
    file.write_text(XACRO.replace("$(arg length)", "$(arg nobody)"))
    with pytest.raises(Refusal, match=r"be expandable by xacro, got .*nobody") as refusal:
        write_new(file, tmp_path / "bad")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
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


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["telescopic", "tilted"], 1))
def test_a_new_arm_goes_where_it_is_sent(name: str, tmp_path: Path) -> None:
    """A few of the moves of `python -m bench.physics.any_arm`."""
    file = tmp_path / f"{name}.urdf"
    file.write_text(OWN[name]())
    written = write_new(file, tmp_path / "new")
    scene, gains = load_scene(written.file), load_gains(written.file)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    rng = np.random.default_rng(3)
    for _ in range(3):
        pair = draw_reachable(kinematics, 0.05, rng)
        assert pair is not None
        outcome = move_arm(scene, gains, "50 mm", *pair)
        assert not outcome.words, outcome.words
        assert outcome.seconds < 12.0 and outcome.peak_speed <= 1.0, outcome


@pytest.mark.slow
def test_a_single_command_from_a_robot_to_a_moving_arm(tmp_path: Path) -> None:
    file = tmp_path / "scara.urdf"
    file.write_text(OWN["scara"]())
    done = subprocess.run(
        [sys.executable, "-m", "arm_emulator", "demo", str(file), "--out", str(tmp_path / "out")],
        capture_output=True, text=True, timeout=300, env=os.environ, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the target is reached, and the residual is the predicted one" in done.stdout
