"""Any file is accepted, or refused in one line that names it, within 2 s."""

import re
import sys
import time
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from draws import some, with_slow
from random_scenes import NAMES, SCENE, URDF, draw, number, verdict

from arm_emulator import Kinematics, Refusal, load_scene, load_servo_config
from arm_emulator.base.io.yaml_file import MAX_LEVELS, MAX_VALUES, parse_yaml
from arm_emulator.cli.command_line import main
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.motion.model.kinematics import list_moving_joints
from arm_emulator.runs.gains import check_fit
from arm_emulator.servo.servo_config import ServoConfig


@pytest.mark.parametrize("block", with_slow(some(range(10), 5), 2))
def test_random_scenes_are_taken_or_refused(tmp_path: Path, block: int) -> None:
    """40 draws a block; `verdict` states what else may not come of it."""
    taken = 0
    for seed in range(40 * block, 40 * block + 40):
        path = draw(np.random.default_rng(seed), tmp_path / str(seed))
        try:
            taken += not verdict(path)
        except Exception as error:
            error.add_note(f"seed {seed}: {path}")
            raise
    assert 0 < taken < 40, "draws of one kind only: they show nothing"


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must be refused, and return its line."""
    before, sys.argv = sys.argv, ["arm_emulator", *arguments]
    started = time.process_time()
    try:
        with pytest.raises(SystemExit) as ended:
            main()
    finally:
        sys.argv = before
    printed = capsys.readouterr()
    assert ended.value.code == 2 and printed.out == "", (arguments, printed)
    assert printed.err.count("\n") == 1, (arguments, printed.err)
    assert time.process_time() - started < 2.0, arguments
    return printed.err


HOSTILE: dict[str, bytes] = {
    "nest at most": b"[" * 100_000,
    "nest at most 32": b"a: " + b"{a: " * 5000,
    "hold at most": b"- a\n" * 250_000,
    "have at most": b"a: 1\n" * 400_000,
    "hold at most 20000": b"a: &a [x, x, x, x, x, x, x, x, x]\n"
    + b"".join(
        b"%c: &%c [%s]\n" % (98 + i, 98 + i, b", ".join([b"*%c" % (97 + i)] * 9)) for i in range(9)
    ),
    "have no recursive anchors": b"a: &a [*a]",
    "a key is a text": b"? [1, 2]\n: 3",
    "a key is a text, not a list or section": b"{a: 1}: 2",
    "without tags": b"a: !!python/object/apply:os.system [echo]",
    "given twice": b"1: 2\n'1': 3",
    "hold one document": b"a: 1\n---\nb: 1",
    "written in UTF-8": "a: ä".encode("latin-1"),
    "written in UTF-8, got": "a: 1".encode("utf-16"),
    "well-formed YAML": b"a: \0",
    "mapping of keys to values, got nothing": b"",
}


@pytest.mark.parametrize("words", HOSTILE)
def test_yaml_that_is_no_scene(
    tmp_path: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a scene, and in what lies beside it."""
    file = tmp_path / "scene.yaml"
    file.write_bytes(HOSTILE[words])
    assert words in refused(capsys, "check-scene", str(file))
    for load in (load_servo_config, load_motion_config):
        with pytest.raises(Refusal) as refusal:
            load(file)
        assert words in str(refusal.value) and str(refusal.value).startswith("scene.yaml: ")


def test_yaml_is_read_by_version_1_2_with_text_keys() -> None:
    """Numbers as in YAML 1.2, every key a text; a byte order mark does no harm."""
    printed = parse_yaml(
        "\ufeffa: 010\nb: 1e-4\nc: 1:30\nd: 2001-01-01\n1: 2\ntrue: 3\n~: [.inf, null]".encode(),
        "f",
    )
    inf = float("inf")
    assert printed == {"a": 10, "b": 1e-4, "c": "1:30", "d": "2001-01-01", "1": 2, "true": 3,
                    "~": [inf, None]}  # fmt: skip
    assert parse_yaml("x: " + "9" * 400, "f") == {"x": inf}
    assert len(parse_yaml("- a\n" * (MAX_VALUES - 1), "f")) == MAX_VALUES - 1
    assert parse_yaml("[" * MAX_LEVELS + "]" * MAX_LEVELS, "f")


def write(folder: Path, urdf: str, **changes: Any) -> Path:
    data = {**yaml.safe_load(SCENE), "urdf": "robot.urdf", **changes}
    (folder / "robot.urdf").write_text(urdf)
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(data, allow_unicode=True))
    return file


def with_fixed_links(folder: Path, count: int, in_a_row: bool) -> Path:
    folder.mkdir()
    parts = [
        f'<link name="f{i}"><inertial><origin xyz="0 0.1 0" rpy="0 0.3 0"/><mass value="1e-4"/>'
        '<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        f'<joint name="f{i}" type="fixed"><origin xyz="0 0 1e-5" rpy="0 0.1 0"/><parent link='
        f'"{f"f{i - 1}" if in_a_row and i else "forearm"}"/><child link="f{i}"/></joint>'
        for i in range(count)
    ]
    return write(folder, URDF.replace("</robot>", "".join(parts) + "</robot>"))


@pytest.mark.parametrize("in_a_row", some([True, False], 1))
def test_work_grows_as_the_number_of_fixed_links(tmp_path: Path, in_a_row: bool) -> None:
    """In emulator and motion controller: five times the links take five times the calls.

    A loop within a loop takes 25 times. Calls are counted, since a time depends on what else runs.
    """
    few, many = (with_fixed_links(tmp_path / str(n), n, in_a_row) for n in (300, 1_500))
    calls = []
    for file in (few, many):
        counted = Counter[str]()
        sys.setprofile(lambda _frame, event, _arg, of=counted: of.update((event,)))
        try:
            scene = load_scene(file)
            names = list_moving_joints(scene.urdf)
        finally:
            sys.setprofile(None)
        assert names == scene.joint_names
        calls.append(counted["call"] + counted["c_call"])
    assert scene.chain.joints[2].body.mass == pytest.approx(3.0 + 0.15, rel=1e-9)
    assert calls[1] < 5.5 * calls[0], calls


def with_joint_mentioned_again(rng: np.random.Generator, robot: ET.Element) -> None:
    tag = str(rng.choice(["transmission", "ros2_control", "gazebo"]))
    name = str(rng.choice(["waist", "shoulder", "elbow", "tool_mount"]))
    again = ET.SubElement(ET.SubElement(robot, tag, name="t"), "joint", name=name)
    ET.SubElement(again, "hardwareInterface").text = "effort"


def with_world(rng: np.random.Generator, robot: ET.Element) -> None:
    if robot.find("link[@name='world']") is not None:
        return
    ET.SubElement(robot, "link", name="world")
    joint = ET.SubElement(robot, "joint", name="world_to_base", type="fixed")
    ET.SubElement(joint, "parent", link="world")
    ET.SubElement(joint, "child", link="base")


def with_thin_link(rng: np.random.Generator, robot: ET.Element) -> None:
    """A rod, a plate's edge, a point or a tensor without mass, fixed to the arm."""
    links = ("base", "column", "upper_arm", "forearm", "tool")
    name = f"thin {len(robot)}"
    link = ET.SubElement(robot, "link", name=name)
    shape = {"ixx": 0.0, "iyy": 1e-3, "izz": 1e-3, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
    inertial = ET.SubElement(link, "inertial")
    kind = rng.integers(3)
    ET.SubElement(inertial, "mass", value="0" if kind == 0 else "0.1")
    scale = 0.0 if kind == 1 else 1.0
    ET.SubElement(inertial, "inertia", {key: repr(scale * value) for key, value in shape.items()})
    joint = ET.SubElement(robot, "joint", name=name, type="fixed")
    ET.SubElement(joint, "parent", link=str(rng.choice(links)))
    ET.SubElement(joint, "child", link=name)


def with_odd_names(rng: np.random.Generator, robot: ET.Element) -> None:
    """A joint called as a link, or with dots, blanks and other letters."""
    allowed = re.compile(r"(?! )[\w .+():/#\[\]-]{1,100}(?<! )")
    names = [n for n in NAMES if allowed.fullmatch(n) and n not in ("tool", "base", 300 * "é")]
    joint = robot.findall("joint")[int(rng.integers(3))]
    if joint.get("type") != "fixed":
        taken = {j.get("name") for j in robot.findall("joint")}
        joint.set("name", str(rng.choice([n for n in [*names, "column"] if n not in taken])))


def without_limits(rng: np.random.Generator, robot: ET.Element) -> None:
    joint = robot.findall("joint")[int(rng.integers(3))]
    if joint.get("type") != "fixed":
        joint.set("type", str(rng.choice(["revolute", "prismatic"])))
        for limit in joint.findall("limit"):
            joint.remove(limit)
        if rng.random() < 0.5:
            ET.SubElement(joint, "limit", effort="10", velocity="2")


HABITS = (
    with_joint_mentioned_again, with_world, with_thin_link, with_odd_names, without_limits,
)  # fmt: skip


@pytest.mark.parametrize("seed", with_slow(some(range(60), 30), 8))
def test_published_habits_are_taken_alike_by_all_three(tmp_path: Path, seed: int) -> None:
    """Emulator, servo and motion controller name the same joints, unlimited where no limit is."""
    rng = np.random.default_rng(seed)
    robot = ET.fromstring(URDF)
    for index in rng.integers(0, len(HABITS), 6):
        HABITS[index](rng, robot)
    sections = yaml.safe_load(SCENE)["joints"]
    moving = [j for j in robot.findall("joint") if j.get("type") != "fixed"]
    names = [str(joint.get("name")) for joint in moving]
    joints = dict(zip(names, sections.values(), strict=True))
    scene = load_scene(write(tmp_path, ET.tostring(robot, encoding="unicode"), joints=joints))
    assert scene.joint_names == tuple(names) == list_moving_joints(scene.urdf)
    kinematics = Kinematics(scene.urdf, names, "tool")
    for low, high in zip(kinematics.lower, kinematics.upper, strict=True):
        assert low <= -1e9 and high >= 1e9, "a joint without limits is held somewhere"
    assert np.isfinite(kinematics.forward(scene.start)[1]).all()
    field = dict(
        gear_ratio=0.01, counts_per_turn=1024, resistance=1.0, torque_constant=0.05,
        back_emf_constant=0.05, rotor_inertia=1e-4, velocity_limit=1.0, position_gain=20.0,
        velocity_gain=100.0, integral_time=0.1, observer_bandwidth=300.0,
    )  # fmt: skip
    flat = {f"joints.{name}.{key}": value for name in names for key, value in field.items()}
    scalars = {"period": 1e-3, "motion_period": 0.05, "hold_after": 0.2, "cut_after": 2.0,
               "supply_voltage": 48.0, "joint_names": names}  # fmt: skip
    servo = ServoConfig.from_mapping({**scalars, **flat}, "servo")
    nested = ServoConfig.from_mapping(
        {**scalars, "joints": {name: dict(field) for name in names}}, "servo"
    )
    assert servo == nested and servo.joint_names == scene.joint_names
    motion = load_motion_config(Path(__file__).parents[2] / "config/motion/three_axis.yaml")
    check_fit(scene, servo, motion)
    for name in names:
        changed = load_scene(tmp_path / "scene.yaml", {f"joints.{name}.start": 0.25})
        assert changed.start[names.index(name)] == 0.25, f"an override of {name!r} went elsewhere"


@pytest.mark.slow
@pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data"
)
def test_every_robot_of_example_robot_data_is_taken_or_refused_with_the_reason(
    tmp_path: Path,
) -> None:
    """Trees with any branches are accepted; what has none is refused for that."""
    folder = find_example_robot_data()
    assert folder is not None
    reasons = (
        "have a moving joint", "be a link of the URDF", "held where it is in the scene",
        "move on its own", "have mass and inertia", "be positive definite", "be > 0 kg",
    )  # fmt: skip
    taken = []
    for file in sorted(folder.rglob("*.urdf")):
        robot = ET.parse(file).getroot()
        joints = [j for j in robot.findall("joint") if j.get("type") != "fixed"]
        locked = {str(j.get("name")): 0.0 for j in joints if j.find("mimic") is not None}
        names = {str(j.get("name")): {} for j in joints if j.get("name") not in locked}
        links = [str(link.get("name")) for link in robot.findall("link")] or ["none"]
        changes = {"tool": links[-1], "joints": names, **({"locked": locked} if locked else {})}
        changes["trusted_inertias"] = []
        scene = write(tmp_path, "", **changes)
        urdf = f"example-robot-data:{file.relative_to(folder)}"
        scene.write_text(scene.read_text().replace("robot.urdf", urdf))
        line = verdict(scene)
        if line:
            # For a tool that is no link, the refusal names the file with this tool.
            files = f"{file.name}: ", f"{scene.name}: tool must be a link"
            assert line.startswith(files) and any(r in line for r in reasons), line
        else:
            taken.append(file.stem)
            loaded = load_scene(scene)
            assert {*list_moving_joints(loaded.urdf)} == {*loaded.joint_names}, file.name
    arms = {"panda", "kinova", "ur3_robot", "ur5_robot", "ur10_robot", "xarm7", "z1", "so101",
            "finger_edu", "double_pendulum"}  # fmt: skip
    assert arms <= set(taken), arms - set(taken)


def test_a_body_that_no_motion_is_possible_with_is_refused_with_its_links(tmp_path: Path) -> None:
    """A rod about its own length, a point on the axis: file, joint and links are named."""
    at = re.search(r'<link name="forearm">\s*<inertial>.*?</inertial>', URDF, re.S)
    assert at is not None
    rod = '<mass value="1"/><inertia ixx="1" iyy="{}" izz="1" ixy="0" ixz="0" iyz="0"/>'
    for inertia, words in (
        (rod.format(0), "inertia about the axis moved by joint elbow (links forearm, tool) must"),
        (rod.format(-1), "inertia moved by joint elbow (links forearm, tool) must have principal"),
        (rod.format(1).replace('mass value="1"', 'mass value="0"'), "mass moved by joint elbow"),
        ('<mass value="1e-300"/><inertia ixx="1e-320" iyy="1e-320" izz="1e-320" ixy="0" ixz="0" '
         'iyz="0"/>', "mass moved by joint elbow (links forearm, tool) must be >= 1e-12 kg"),
    ):  # fmt: skip
        link = f'<link name="forearm"><inertial>{inertia}</inertial>'
        with pytest.raises(Refusal) as refusal:
            load_scene(write(tmp_path, URDF.replace(at[0], link)))
        assert str(refusal.value).startswith("robot.urdf: ") and words in str(refusal.value)
    file = write(tmp_path, URDF.replace(at[0], '<link name="forearm">'))
    assert load_scene(file, {"payload": {"mass": 1.0}}).joint_names, "its tool has a mass"
    with pytest.raises(Refusal, match=r"inertia about the axis moved by joint elbow"):
        load_scene(file, {"payload": {"mass": 1.0}, "tool": "forearm"})


@pytest.mark.parametrize("seed", with_slow(range(20), 2))
def test_combinations_of_numbers_are_sound(tmp_path: Path, seed: int) -> None:
    """Motor and gear of any size: refused, or all that the core divides by is well in range."""
    rng = np.random.default_rng(seed)
    taken = 0
    for _ in range(30):
        changes = {}
        for key in ("motor.resistance", "motor.rotor_inertia", "motor.torque_constant",
                    "motor.back_emf_constant", "gear.ratio", "gear.stiffness"):  # fmt: skip
            if rng.random() < 0.4:
                changes[f"joints.elbow.{key}"] = abs(number(rng))
        try:
            joint = load_scene(write(tmp_path, URDF), changes).joints[2]
        except Refusal as refusal:
            assert str(refusal).startswith("scene.yaml: joints.elbow."), refusal
            continue
        taken += 1
        assert isinstance(joint.motor, DcMotor) and joint.gear.stiffness is not None
        ratio = joint.gear.ratio
        for value in (
            joint.motor.rotor_inertia / ratio**2, joint.motor.torque_constant / ratio,
            1.0 / joint.motor.resistance, 1.0 / joint.motor.rotor_inertia, 1.0 / ratio,
            1.0 / joint.gear.stiffness,
        ):  # fmt: skip
            assert 0.0 < value <= 1.001e15, (changes, value)
    assert taken, "every draw was refused: it shows nothing"
