"""Scene files: what is valid, and how what is not is refused."""

import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import CONFIG

from arm_emulator import Refusal, load_scene
from arm_emulator.cli.command_line import main
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.urdf_chain import read_chain
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.machine.schemes.known import SCHEMES

URDF = (CONFIG / "urdf" / "three_axis.urdf").read_text()
SCENE = (CONFIG / "three_axis.yaml").read_text()

# Overrides of three_axis.yaml, and what is reported of them.
BAD_VALUES: list[tuple[dict[str, Any], str]] = [
    ({"joints.elbow.gear.stiffness": -3}, "joints.elbow.gear.stiffness must be a number > 0 N m/rad, got -3"),
    ({"joints.elbow.gear.stiffness": None}, "gear.damping must come with a stiffness"),
    ({"joints.elbow.gear": {"ratio": 0.01, "cubic_stiffness": 1}}, "gear.cubic_stiffness must come with a stiffness (a rigid gear has none), got alone"),
    ({"joints.elbow.gear.damping": -1}, "gear.damping must be a number >= 0 N m s/rad, got -1"),
    ({"joints.elbow.motor.speed": 3}, "key joints.elbow.motor.speed must be known, got 'speed'; valid:"),
    ({"joints.elbow.motor": None}, "joints.elbow.gear must belong to a joint with a motor"),
    ({"joints.elbow.motor": 3}, "joints.elbow.motor must be a section of keys and values, got 3"),
    ({"joints.elbow": None}, "joints.elbow must be given, three_axis.urdf moves it, got nothing"),
    ({"joints.hand": {}}, "joints.hand must be a moving joint of three_axis.urdf, got hand; valid: waist"),
    ({"joints": None}, "joints must be a section of keys and values, got nothing"),
    ({"gravity": [0, 0]}, "gravity must be 3 numbers within +-1000 m/s2, got [0, 0]"),
    ({"payload": {"mass": 1, "inertia": [1, 1, 0, 0, 0, 0]}}, "payload.inertia must be positive definite"),
    ({"integrator.scheme": "magic"}, f"integrator.scheme must be one of the known, got 'magic'; valid: {', '.join(SCHEMES)}"),
    ({"integrator.dt": 3e-4}, "integrator.dt must divide the servo period of 0.001 s, got 0.0003; valid: 0.00025 s"),
    ({"servo_period": 1e-3 / 7e5}, "servo_period must be a number from 1e-06 to 1 s"),
    ({"servo_period": 1e-3 / 7}, "servo_period must be a whole number of nanoseconds"),
    ({"integrator.exchange_depth": 5}, "exchange_depth must be a whole number from 1 to 4, got 5"),
    ({"threads": 2, "integrator.scheme": "rosenbrock"}, "threads must be 1 with scheme rosenbrock, whose second stage waits for its first, got 2"),
    ({"cores": [0, 1000]}, "cores must be cores of this machine, got [0.0, 1000.0]; valid: 0"),
    ({"tool": "hand"}, "tool must be a link of the URDF, got hand; valid: base, column"),
    ({"locked": {"wrist": 0.0}}, "locked.wrist must be a joint of the URDF, got wrist; valid: waist"),
    ({"locked": {"elbow": "open"}}, "locked.elbow must be a number from -10000 to 10000 rad or m, got 'open'"),
    ({"urdf": "none.urdf"}, "urdf must be a file, got none.urdf"),
    ({"name": None}, "name must be a text, got nothing"),
    ({"colour": "red"}, "key colour must be known, got 'colour'; valid: assumed, calibration, cores, couplings, demo, energy_flow, external_wrench,"),
]  # fmt: skip

LOOP = '<joint name="loop" type="fixed"><parent link="forearm"/><child link="column"/></joint>'

# Replacements in three_axis.urdf, and what is reported of them.
BAD_URDFS: list[tuple[tuple[str, str], str]] = [
    (("</robot>", ""), "file must be well-formed XML"),
    (("<robot ", "<sdf "), "file must be well-formed XML"),
    (('mass value="6"', 'mass value="-6"'), "link upper_arm: mass must be >= 0 kg, got -6"),
    (('mass value="6"', 'mass value="six"'), "link upper_arm: mass must be a number, got 'six'"),
    (('mass value="6"', 'mass value="1e200"'), "link upper_arm: mass must be from -1e+09 to 1e+09, got 1e+200"),
    (('ixx="0.04875"', 'ixx="1e300"'), "link upper_arm: inertia must be from -1e+15 to 1e+15, got 1e+300"),
    (('<origin xyz="0 0 0.3"/>', '<origin xyz="0 0 1e200"/>'), "joint shoulder: origin xyz must be from -1e+06 to 1e+06, got 1e+200"),
    (('name="elbow" type="continuous">', 'name="elbow" type="revolute"><limit lower="1" upper="-1"/>'), "joint elbow: limit must have lower <= upper, got 1 > -1"),
    (('name="elbow" type="continuous">', 'name="elbow" type="revolute"><limit lower="a" upper="1"/>'), "joint elbow: limit lower must be a number, got 'a'"),
    (('joint name="elbow"', 'joint name="el&#10;bow"'), "joint name must have printable letters only, got 'el\\nbow'"),
    (('<robot ', '<!DOCTYPE robot [<!ENTITY a "b">]><robot '), "file must have no document type"),
    (('</robot>', '<xacro:arm/></robot>'), "file must be a URDF, not a xacro source, got <xacro:arm>"),
    (('</robot>', 70 * "<a>" + 70 * "</a>" + "</robot>"), "file must nest at most 64 levels, got more"),
    (('name="elbow" type="continuous"', 'name="elbow" type="floating"'), "joint elbow: type must be supported, got floating; valid: revolute, continuous, prismatic, fixed, or held where it is in the scene: locked: {elbow: 0.0}"),
    (('name="elbow" type="continuous">', 'name="elbow" type="continuous"><mimic joint="nobody"/>'), "joint elbow: mimic must name a joint of the URDF, got 'nobody'"),
    (("</robot>", f"{LOOP}</robot>"), "link column must hang on one joint (closed loops"),
    (('<child link="forearm"/>', '<child link="hand"/>'), "joint elbow: child must be a link of the URDF, got 'hand'"),
    (('<parent link="base"/>', '<parent link="tool"/>'), "link column must hang on the base (it is in a loop)"),
    (('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>'), "joint waist: axis must have a direction"),
    (('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>'), "joint waist: axis xyz must be three numbers, got '0 1'"),
    (('<link name="forearm">', '<link name="column">'), "link name must be given and unique, got 'column'"),
    (('joint name="elbow"', 'joint name="waist"'), "joint name must be given and unique, got 'waist'"),
]  # fmt: skip


def exit_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and error text of the command line."""
    before, sys.argv = sys.argv, ["arm_emulator", *arguments]
    try:
        with pytest.raises(SystemExit) as ended:
            main()
    finally:
        sys.argv = before
    return int(ended.value.code or 0), capsys.readouterr().err


def copy_scene(folder: Path) -> Path:
    (folder / "urdf").mkdir()
    (folder / "urdf" / "three_axis.urdf").write_text(URDF)
    file = folder / "three_axis.yaml"
    file.write_text(SCENE)
    return file


@pytest.mark.parametrize(("overrides", "words"), BAD_VALUES, ids=lambda value: str(value)[:40])
def test_bad_values_are_refused_in_a_line(overrides: dict[str, Any], words: str) -> None:
    with pytest.raises(Refusal, match=re.escape(words)) as refusal:
        load_scene("three_axis", overrides=overrides)
    assert "\n" not in str(refusal.value)
    assert str(refusal.value).startswith("three_axis.yaml: "), "the file that has the value"


@pytest.mark.parametrize(("change", "words"), BAD_URDFS, ids=lambda value: str(value)[:40])
def test_bad_urdfs_are_refused(
    tmp_path: Path, change: tuple[str, str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one line, with exit code 2."""
    file = copy_scene(tmp_path)
    assert change[0] in URDF
    (tmp_path / "urdf" / "three_axis.urdf").write_text(URDF.replace(*change, 1))
    code, printed = exit_of(["check-scene", str(file)], capsys)
    assert code == 2
    assert printed.startswith("three_axis.urdf: ") and words in printed
    assert printed.count("\n") == 1


def test_unknown_scene_names_those_that_exist(capsys: pytest.CaptureFixture[str]) -> None:
    code, printed = exit_of(["check-scene", "four_axis"], capsys)
    assert code == 2 and "file four_axis must exist" in printed and "three_axis" in printed


@pytest.mark.parametrize("name", sorted(file.stem for file in CONFIG.glob("*.yaml")))
def test_shipped_scenes_are_valid(name: str) -> None:
    if (
        "example-robot-data" in (CONFIG / f"{name}.yaml").read_text()
        and not find_example_robot_data()
    ):
        pytest.skip("needs the package example-robot-data (make robots)")
    scene = load_scene(name)
    assert scene.name == name


def test_three_axis_is_the_papers_arm() -> None:
    """The values that issue and paper give, read from the loaded scene."""
    scene = load_scene("three_axis")
    assert scene.joint_names == ("waist", "shoulder", "elbow")
    assert scene.gravity is None and scene.supply_voltage == 48.0 and scene.servo_period == 1e-3
    assert np.array_equal(scene.start, [0.0, 0.5, 0.8])
    for joint, geometry, mass in zip(scene.joints, scene.chain.joints, (10, 6, 3), strict=True):
        assert isinstance(joint.motor, DcMotor) and joint.encoder is not None
        assert (joint.motor.resistance, joint.motor.inductance) == (1.0, 1e-3)
        assert (joint.motor.torque_constant, joint.motor.back_emf_constant) == (0.05, 0.05)
        assert joint.motor.rotor_inertia == 1e-4
        assert (joint.gear.ratio, joint.gear.stiffness, joint.gear.damping) == (0.01, 1e4, 10.0)
        assert joint.friction.viscous == 0.5 and joint.encoder.counts_per_turn == 1024
        # A solid cylinder of radius 0.05 m and length 0.3 m, seen from its end.
        across = mass * (3 * 0.05**2 + 0.3**2) / 12 + mass * 0.15**2
        moments = np.linalg.eigvalsh(geometry.body.inertia)
        assert geometry.body.mass == mass
        assert moments == pytest.approx([mass * 0.05**2 / 2, across, across], rel=1e-12)


def test_overrides_reach_a_single_joint_or_all() -> None:
    scene = load_scene("three_axis", overrides={"joints.elbow.start": 0.1})
    assert [joint.start for joint in scene.joints] == [0.0, 0.5, 0.1]
    # The file's joints share one motor by a YAML anchor; an override of one leaves the others.
    scene = load_scene("three_axis", overrides={"joints.elbow.motor.resistance": 2.0})
    assert [vars(joint.motor)["resistance"] for joint in scene.joints] == [1.0, 1.0, 2.0]
    scene = load_scene("three_axis", overrides={"joints.*.motor.resistance": 2.0})
    assert [vars(joint.motor)["resistance"] for joint in scene.joints] == [2.0, 2.0, 2.0]


def test_a_step_of_few_digits_divides_the_period_all_the_same() -> None:
    """1/3 ms as it may be written: whole steps shall make a servo period, to the last bit."""
    scene = load_scene("three_axis", overrides={"integrator.dt": 3.3333333333e-4})
    assert scene.integrator.dt == 1e-3 / 3.0, "step [s]"
    for dt in (1e-4, 2.5e-5, 1.25e-4, 2e-5):
        assert load_scene("three_axis", overrides={"integrator.dt": dt}).integrator.dt == dt


TREE = """<robot name="tree"><link name="base"/><link name="a"/><link name="b"/><link name="f"/>
<link name="g"/>
<joint name="ja" type="revolute"><parent link="base"/><child link="a"/></joint>
<joint name="jb" type="revolute"><parent link="a"/><child link="b"/></joint>
<joint name="jf" type="prismatic"><parent link="a"/><child link="f"/></joint>
<joint name="jg" type="prismatic"><parent link="a"/><child link="g"/></joint></robot>"""


@pytest.mark.parametrize("locked", [(), ("jb",), ("jf",), ("jf", "jg"), ("jb", "jf")])
def test_a_tree_has_all_joints_that_are_not_locked(locked: tuple[str, ...]) -> None:
    """Each with the joint that carries it: all but `ja` hang on its link."""
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    robot = ET.fromstring(TREE)
    for link in robot.findall("link"):
        link.append(ET.fromstring(body))
    angles = dict.fromkeys(locked, 0.0)
    chain = read_chain(robot, "tree.urdf", "tree.yaml", locked=angles, tool="b")
    moving = [name for name in ("ja", "jb", "jf", "jg") if name not in locked]
    assert [joint.name for joint in chain.joints] == moving
    assert [joint.parent for joint in chain.joints] == [-1, *[0] * (len(moving) - 1)]
