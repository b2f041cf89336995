"""The machine's kinematics and the description that controllers have, when both differ."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from draws import some, with_slow
from machines import GRAVITY, Oracle, links_of, own_three_axis, write_scene
from scipy.spatial.transform import Rotation

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.base.calibration.calibration import Calibration, load_calibration
from arm_emulator.base.urdf.urdf_text import parse_urdf
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.machine.session.tool_chain import ToolChain
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.runs.view_of import get_view
from oracles.random_chain import list_moving_joints, write_random_chain, write_random_tree

needs_robots = pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data (make robots)"
)

# Products of some ten frames of 1 m, each rounded.
ROUNDING = 1e-13

# Deltas of three UR10, from the tests of ur_calibration in Universal_Robots_ROS2_Driver (BSD-3):
# theta, a, d, alpha. Common normals of the arm's parallel axes lie up to 446 m away.
UR10 = {
    "theta": (0.0,) * 6, "a": (0.0, -0.612, -0.5723, 0.0, 0.0, 0.0),
    "d": (0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922),
    "alpha": (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0),
}  # fmt: skip
MEASURED = (
    {"theta": (-7.290070070824746e-05, -0.01713897289704999, -0.03707159413492756,
               0.054279462160583214, 1.488984257025741e-07, 1.551499479707493e-05),
     "a": (4.6311376834935676e-05, -0.00012568315331862312, 0.00186216581161458,
           9.918593870679266e-05, 4.215462720453189e-06, 0.0),
     "d": (0.00065609212979853, 1.4442162376284788, 0.854147723854608, -2.2989425877563705,
           -1.573498686836816e-05, 1.9072435590711256e-05),
     "alpha": (0.000211987863869334, -0.0072553625957652995, -0.013483226769541364,
               0.0013495820227329425, -0.001263136163679901, 0.0)},
    {"theta": (1.59613525316931737e-07, -0.917209621528830232, 7.12936131346499469,
               0.0710299029424392298, -1.64258976526054923e-06, 9.17286101034808787e-08),
     "a": (0.000108651068627930392, 0.240324175250532346, 0.00180628180213493472,
           2.63076149165684402e-05, 3.96638632500012715e-06, 0.0),
     "d": (-0.000144894975118076141, 303.469135666158195, -309.88394307789747, 6.41459904397394975,
           -4.48232900190081995e-05, -0.00087071402790364627),
     "alpha": (-0.000444781952841921679, -0.00160215112531214153, 0.00631917793331091861,
               -0.00165055247340828437, 0.000763682515545038854, 0.0)},
    {"theta": (-2.41478068943590252e-07, 1.60233952386694556, -1.68607190752171299,
               0.0837331147700118711, -1.01260355871157781e-07, 3.91986209186123702e-08),
     "a": (2.12234865571205891e-05, 0.632017132627700651, 0.00229833638891230319,
           -4.61409023720933908e-05, -6.39280053471801522e-05, 0.0),
     "d": (-0.000160188285741325043, 439.140974079900957, -446.027059806332147,
           6.88618689642360149, -3.86588496858186748e-05, -0.00087908274257374186),
     "alpha": (-0.000650246557584166496, 0.00139416666825590402, 0.00693818880325995126,
               -0.000811641562390219562, 0.000411120504570705592, 0.0)},
)  # fmt: skip


def homogeneous(R: np.ndarray, p: Any) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def from_origin(xyz: Any, rpy: Any) -> np.ndarray:
    return homogeneous(Rotation.from_euler("ZYX", np.asarray(rpy)[::-1]).as_matrix(), xyz)


def dh(theta: float, d: float, a: float, alpha: float) -> np.ndarray:
    turned = homogeneous(Rotation.from_rotvec([0.0, 0.0, theta]).as_matrix(), [0.0, 0.0, d])
    return turned @ homogeneous(Rotation.from_rotvec([alpha, 0.0, 0.0]).as_matrix(), [a, 0.0, 0.0])


def displaced_urdf(urdf: str, deltas: Mapping[str, Mapping[str, float]]) -> str:
    """The description with joints displaced by x to yaw, in SciPy's rotations."""
    robot = ET.fromstring(urdf)
    for joint in robot.findall("joint"):
        delta = deltas.get(joint.get("name", ""))
        if delta is None:
            continue
        origin = joint.find("origin")
        if origin is None:
            origin = ET.SubElement(joint, "origin")
        xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
        place = from_origin(xyz, rpy) @ from_origin(
            [delta.get(key, 0.0) for key in "xyz"],
            [delta.get(key, 0.0) for key in ("roll", "pitch", "yaw")],
        )
        rpy = Rotation.from_matrix(place[:3, :3]).as_euler("ZYX")[::-1]
        origin.set("xyz", " ".join(map(repr, place[:3, 3].tolist())))
        origin.set("rpy", " ".join(map(repr, rpy.tolist())))
    return ET.tostring(robot, encoding="unicode")


def draw_deltas(rng: np.random.Generator, names: list[str]) -> dict[str, dict[str, float]]:
    """Displacements of some centimetres and degrees, ten times what machines have."""
    sizes = dict.fromkeys("xyz", 0.02) | dict.fromkeys(("roll", "pitch", "yaw"), 0.05)
    return {
        name: {key: float(rng.normal(0.0, size)) for key, size in sizes.items()} for name in names
    }


def tool_by_pinocchio(urdf: str, scene: Scene, q: np.ndarray) -> np.ndarray:
    oracle = Oracle(replace(scene, urdf=urdf))
    pin.framesForwardKinematics(oracle.model, oracle.data, oracle.configuration(q))
    return oracle.data.oMf[oracle.model.getFrameId(scene.tool)].homogeneous


@pytest.mark.parametrize("seed", with_slow(some(range(8), 3), 1))
def test_the_machine_stands_as_its_calibration_has_it(tmp_path: Path, seed: int) -> None:
    """Turning and sliding joints, fixed ones and branches: dynamics and tool."""
    rng = np.random.default_rng(seed)
    make = (write_random_chain, write_random_tree)[seed % 2]
    urdf = make(rng, 4)
    names = [element.get("name", "") for element in ET.fromstring(urdf).findall("joint")]
    deltas = draw_deltas(rng, names)
    joints = {name: {} for name in list_moving_joints(urdf)}
    tool = f"{names[-1]}_link"
    keys = {"gravity": GRAVITY, "tool": tool, "calibration": {"joints": deltas}}
    scene = load_scene(write_scene(tmp_path, urdf, joints, **keys))
    expected = displaced_urdf(urdf, deltas)
    oracle, links = Oracle(replace(scene, urdf=expected)), links_of(scene)
    for _ in range(20):
        q, v, tau = rng.normal(size=(3, len(scene.joints)))
        a = links.accelerations(q, v, tau)
        assert a == pytest.approx(oracle.aba(q, v, tau), rel=1e-9), "condition numbers below 1e5"
        place = tool_by_pinocchio(expected, scene, q)
        p = ToolChain(scene).compute_positions(q[:, None])[:, 0]
        assert p == pytest.approx(place[:3, 3], abs=ROUNDING), "the machine's tool"
        nominal = tool_by_pinocchio(scene.urdf, scene, q)
        assert nominal == pytest.approx(tool_by_pinocchio(urdf, scene, q), abs=ROUNDING)
        assert np.abs(nominal - place).max() > 1e-3, "the controllers' description is another"


def dh_urdf(rows: np.ndarray, kinds: list[str], flange: np.ndarray) -> str:
    """An arm of rows theta, d, a, alpha, whose links stand in random frames about their axes."""
    rng = np.random.default_rng(int(1e6 * abs(rows[0, 1])) + 1)
    text, before = '<robot name="dh"><link name="base"/>', np.eye(4)
    parent = "base"
    for k, (row, kind) in enumerate(zip(rows, kinds, strict=True)):
        # The joint's frame: any that its axis passes through the origin of.
        R = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        slide = homogeneous(R, [0.0, 0.0, rng.normal(0.0, 0.2)])
        text += joint_text(f"j{k}", kind, parent, before @ slide, axis=R.T[:, 2])
        before, parent = np.linalg.inv(slide) @ dh(*row), f"j{k}_link"
    return text + joint_text("mount", "fixed", parent, before @ flange) + "</robot>"


def joint_text(
    name: str, kind: str, parent: str, place: np.ndarray, axis: np.ndarray | None = None
) -> str:
    rpy = Rotation.from_matrix(place[:3, :3]).as_euler("ZYX")[::-1]
    words = [" ".join(map(repr, map(float, row))) for row in (place[:3, 3], rpy)]
    along = "" if axis is None else f'<axis xyz="{" ".join(map(repr, axis.tolist()))}"/>'
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{words[0]}" rpy="{words[1]}"/>'
        f'<parent link="{parent}"/><child link="{name}_link"/>{along}'
        '<limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        f'<link name="{name}_link"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def dh_tool(rows: np.ndarray, kinds: list[str], q: np.ndarray, flange: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    for row, kind, q_joint in zip(rows, kinds, q, strict=True):
        at = row.copy()
        at[1 if kind == "prismatic" else 0] += q_joint
        T = T @ dh(*at)
    return T @ flange


@pytest.mark.parametrize("seed", range(20))
def test_deltas_are_added_to_the_numbers_of_denavit_and_hartenberg(
    tmp_path: Path, seed: int
) -> None:
    """Arms made of such rows by the test, with other rows; skew, parallel and crossing axes."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    kinds = [str(rng.choice(["revolute", "revolute", "prismatic"])) for _ in range(count)]
    rows = np.zeros((count, 4))
    rows[:, 0] = rng.uniform(-1.5, 1.5, count)  # within a quarter turn, as x goes on
    rows[:, 1:3] = rng.normal(0.0, 0.3, (count, 2))
    rows[:, 2] *= rng.random(count) < 0.7  # the others cross
    rows[:, 3] = rng.choice([np.pi / 2, -np.pi / 2, 0.7, -2.0], count)
    parallel = (rng.random(count) < 0.3) & (np.arange(count) < count - 1)
    rows[parallel, 1], rows[parallel, 3] = 0.0, 0.0
    rows[parallel & (rows[:, 2] == 0.0), 2] = 0.3  # the same axis twice has no common normal
    flange = homogeneous(Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix(), [0.0, 0.0, 0.1])
    urdf = dh_urdf(rows, kinds, flange)
    keys = ("delta_theta", "delta_d", "delta_a", "delta_alpha")
    deltas = rng.normal(0.0, 0.02, (count, 4))
    deltas_by_joint = {
        f"j{k}": dict(zip(keys, map(float, row), strict=True)) for k, row in enumerate(deltas)
    }
    joints: dict[str, Any] = {name: {} for name in deltas_by_joint}
    file = write_scene(
        tmp_path, urdf, joints, tool="mount_link", calibration={"joints": deltas_by_joint}
    )
    scene = load_scene(file)
    for _ in range(5):
        q = rng.normal(size=count)
        expected = dh_tool(rows + deltas, kinds, q, flange)
        actual = tool_by_pinocchio(scene.true_urdf, scene, q)
        assert actual == pytest.approx(expected, abs=1e-11), "rows where axes are parallel to 1e-4"
        p = ToolChain(scene).compute_positions(q[:, None])[:, 0]
        assert p == pytest.approx(expected[:3, 3], abs=1e-11)


def test_a_planar_arm_has_the_closed_form(tmp_path: Path) -> None:
    text = '<robot name="planar"><link name="base"/>'
    text += joint_text("one", "revolute", "base", np.eye(4), np.array([0.0, 0.0, 1.0]))
    step = homogeneous(np.eye(3), [0.5, 0.0, 0.0])
    text += joint_text("two", "revolute", "one_link", step, np.array([0.0, 0.0, 1.0]))
    text += joint_text("tip", "fixed", "two_link", homogeneous(np.eye(3), [0.3, 0.0, 0.0]))
    deltas = {"one": {"delta_a": 2e-3, "delta_theta": 1e-3}, "two": {"delta_a": -1e-3,
              "delta_theta": -2e-3}}  # fmt: skip
    file = write_scene(
        tmp_path, text + "</robot>", {"one": {}, "two": {}}, tool="tip_link",
        calibration={"joints": deltas},
    )  # fmt: skip
    scene = load_scene(file)
    for q_1, q_2 in np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2)):
        t_1, t_2 = q_1 + 1e-3, q_1 + q_2 + 1e-3 - 2e-3
        expected = [0.502 * np.cos(t_1) + 0.299 * np.cos(t_2),
                    0.502 * np.sin(t_1) + 0.299 * np.sin(t_2), 0.0]  # fmt: skip
        p = ToolChain(scene).compute_positions(np.array([[q_1], [q_2]]))[:, 0]
        assert p == pytest.approx(expected, abs=1e-14)


def ur10_scene(folder: Path, calibration: Mapping[str, Any]) -> Scene:
    urdf = "example-robot-data:ur_description/urdf/ur10_robot.urdf"
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    joints = {f"{name}_joint": {} for name in names}
    file = write_scene(folder, "<robot name='unused'/>", joints, tool="tool0")
    return load_scene(file, {"urdf": urdf, "calibration": calibration})


def ur10_rows(deltas: Mapping[str, Any] | None = None) -> np.ndarray:
    keys = ("theta", "d", "a", "alpha")
    nominal = np.array([UR10[key] for key in keys]).T
    return nominal if deltas is None else nominal + np.array([deltas[key] for key in keys]).T


def controller_file(folder: Path, deltas: Mapping[str, Any], **more: str) -> Path:
    lines = [f"delta_{key} = [{', '.join(map(repr, row))}]" for key, row in deltas.items()]
    rest = {
        "calibration_status": "2 # 0 = notInitialized, 1 = notLinearised, 2 = Linearised",
        "joint_checksum": "[0xb630883c, 0xb61f6e2e, 0xb5484b61, 0xb612c3a2, 0xb62bd7bc, 0x1]",
    }
    lines += [f"{key} = {value}" for key, value in (rest | more).items()]
    file = folder / "calibration.conf"
    file.write_text("[mounting]\n" + "\n".join(lines) + "\n")
    return file


def driver_file(folder: Path, rows: np.ndarray) -> Path:
    """Write the driver's form: each joint's placement as a URDF has it, from rows at q = 0."""
    text, before = "kinematics:\n", np.eye(4)
    for link, (theta, d, a, alpha) in zip(
        ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"), rows, strict=True
    ):
        place = before @ dh(theta, d, 0.0, 0.0)
        rpy = Rotation.from_matrix(place[:3, :3]).as_euler("ZYX")[::-1]
        numbers = zip(("x", "y", "z", "roll", "pitch", "yaw"), (*place[:3, 3], *rpy), strict=True)
        text += f"  {link}:\n" + "".join(f"    {k}: {float(v)!r}\n" for k, v in numbers)
        before = dh(0.0, 0.0, a, alpha)
    file = folder / "my_robot_calibration.yaml"
    file.write_text(text + "  hash: calib_12788084448423163542\n")
    return file


@needs_robots
@pytest.mark.parametrize("form", ["controller", "driver"])
@pytest.mark.parametrize("deltas", MEASURED)
def test_calibrations_of_universal_robots_are_read(
    tmp_path: Path, deltas: Mapping[str, Any], form: str
) -> None:
    rows = ur10_rows(deltas)
    if form == "controller":
        controller_file(tmp_path, deltas)
    else:
        driver_file(tmp_path, rows)
    name = {"controller": "calibration.conf", "driver": "my_robot_calibration.yaml"}[form]
    scene = ur10_scene(tmp_path, {"file": name})
    turned = homogeneous(np.diag([-1.0, -1.0, 1.0]), [0.0, 0.0, 0.0])  # base_link to base
    last = dh(0.0, 0.0, rows[5, 2], rows[5, 3])  # 0 and 0 of these arms
    rng = np.random.default_rng(1)
    for q in rng.uniform(-3.0, 3.0, (20, 6)):
        expected = turned @ dh_tool(rows, ["revolute"] * 6, q, np.linalg.inv(last))
        actual = tool_by_pinocchio(scene.true_urdf, scene, q)
        assert actual == pytest.approx(expected, abs=2e-11), "446 m to the frames on the way"
        nominal = turned @ dh_tool(ur10_rows(), ["revolute"] * 6, q, np.eye(4))
        tool_pose = tool_by_pinocchio(scene.urdf, scene, q)
        assert tool_pose == pytest.approx(nominal, abs=2e-5), "the description's digits"
        apart = np.linalg.norm(expected[:3, 3] - nominal[:3, 3])
        assert 1e-4 < apart < 0.02, "what the driver's page calls centimetres"
    for name, deviation in scene.calibration.deviations.items():
        assert max(abs(deviation.x), abs(deviation.y), abs(deviation.z)) < 0.01, (
            f"{name} stays where it was"
        )


@needs_robots
def test_foreign_files_of_universal_robots_are_refused(tmp_path: Path) -> None:
    deltas = dict(MEASURED[0])
    calibration = {"file": "calibration.conf"}
    controller_file(tmp_path, deltas, calibration_status="1")
    with pytest.raises(Refusal, match="calibration_status must be 2, linearised, got 1"):
        ur10_scene(tmp_path, calibration)
    for spoiled, words in (
        ({"theta": (1.0,) * 5}, "delta_theta must be a row of 6 numbers"),
        ({"a": ("x",) * 6}, "delta_a must be numbers"),
        ({"d": (1e9,) * 6}, "delta_d must be a number within"),
    ):
        controller_file(tmp_path, deltas | spoiled)
        with pytest.raises(Refusal, match=words):
            ur10_scene(tmp_path, calibration)
    for text, words in (
        ("delta_theta = [1]", "file must be a calibration of the controller"),
        ("[joints]\na = 1", "section mounting must be given, got nothing; valid: joints"),
    ):
        (tmp_path / "calibration.conf").write_text(text)
        with pytest.raises(Refusal, match=words):
            ur10_scene(tmp_path, calibration)
    driver = driver_file(tmp_path, ur10_rows())
    driver.write_text(driver.read_text().replace("forearm", "elbow"))
    with pytest.raises(Refusal, match=r"kinematics.forearm must be a section"):
        ur10_scene(tmp_path, {"file": driver.name})
    file = write_scene(tmp_path, write_random_chain(np.random.default_rng(0), 3), {})
    controller_file(tmp_path, deltas)
    names = list_moving_joints((tmp_path / "robot.urdf").read_text())
    with pytest.raises(Refusal, match="arm must have 6 revolute joints to its flange"):
        load_scene(file, {"joints": {name: {} for name in names}, "calibration": calibration,
                          "tool": f"{names[-1]}_link"})  # fmt: skip


def test_machine_data_of_kuka_are_read(tmp_path: Path) -> None:
    """An axis that is mastered 0.5 degrees beside its mark reports as much more."""
    text = "; machine data\n$MAMES[1]=0.0\n$MAMES[2]=-90.0  ;DEG\n$MAMES[3]=90.0\n"
    (tmp_path / "type.dat").write_text(text)
    (tmp_path / "own.dat").write_text(text.replace("-90.0", "-89.5"))
    keys = "calibration: {file: own.dat, nominal: type.dat}\n"
    own = own_three_axis(tmp_path, keys)
    scene = load_scene(own)
    zeros = [deviation.encoder_zero for deviation in scene.calibration.deviations.values()]
    assert zeros == pytest.approx([0.0, np.deg2rad(0.5), 0.0], abs=1e-15)
    (tmp_path / "own.dat").write_text("$MAMES[1]=0.0\n$MAMES[2]=x\n")
    with pytest.raises(Refusal, match=r"\$MAMES\[2\] must be a number, got 'x'"):
        load_scene(own)
    (tmp_path / "own.dat").write_text("$MAMES[1]=0.0\n")
    with pytest.raises(Refusal, match=r"\$MAMES\[2\] must be given, as of joint shoulder"):
        load_scene(own)
    (tmp_path / "own.dat").write_text(text.replace("-90.0", "9000.0"))
    with pytest.raises(Refusal, match=r"own.dat: encoder_zero of joint shoulder must be a number"):
        load_scene(own)
    (tmp_path / "own.dat").write_text("$MACHINE=1\n")
    with pytest.raises(Refusal, match=r"file must have lines \$MAMES"):
        load_scene(own)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"joints": {"elbow": {"a": 1.0}}}, "key calibration.joints.elbow.a must be known"),
        ({"joints": {"elbow": {"x": 2.0}}}, "calibration.joints.elbow.x must be a number from -1"),
        ({"joints": {"elbow": {"x": "1"}}}, "calibration.joints.elbow.x must be a number"),
        ({"joints": {"hip": {"x": 0.1}}}, "calibration.joints.hip must be a joint of the URDF"),
        (
            {"joints": {"tool_mount": {"encoder_zero": 0.1}}},
            "calibration.joints.tool_mount.encoder_zero must belong to a joint that moves",
        ),
        (
            {"joints": {"tool_mount": {"delta_a": 0.1}}},
            "calibration.joints.tool_mount.delta_a must be of a joint that moves the flange",
        ),
        ({"joints": {"elbow": 1.0}}, "calibration.joints.elbow must be a section"),
        ({"file": "none.yaml"}, "calibration.file must be a file, got none.yaml"),
        ({"file": "hip.yaml"}, "hip.yaml: joints.hip must be a joint of the URDF"),
        ({"file": "own.urdf"}, "file must be a calibration, got .urdf"),
        ({"file": "own.dat"}, "calibration.nominal must be the machine data of the type"),
        ({"nominal": "none.dat"}, "calibration.nominal must come with a key file"),
        ({"file": "own.dat", "nominal": "none.dat"}, "calibration.nominal must be a file"),
        ({"base": "hip"}, "calibration.base must be a link of the URDF"),
        ({"flange": "hip"}, "calibration.flange must be a link of the URDF"),
        (
            {"base": "hip", "joints": {"elbow": {"delta_a": 1e-3}}},
            "calibration.base must be a link",
        ),
        ({"flange": "base", "joints": {"elbow": {"delta_a": 1e-3}}}, "be moved by a joint"),
        ({"base": "tool", "joints": {"elbow": {"delta_a": 1e-3}}}, "be fixed to the root link"),
    ],
)
def test_calibrations_that_are_not_taken(tmp_path: Path, keys: dict[str, Any], words: str) -> None:
    file = own_three_axis(tmp_path, "")
    for name in ("own.dat", "own.urdf"):
        (tmp_path / name).write_text("")
    (tmp_path / "hip.yaml").write_text("joints: {hip: {x: 0.1}}\n")
    with pytest.raises(Refusal, match=words):
        load_scene(file, {"calibration": keys})


def test_our_files_are_read_and_changed_by_the_scene(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "joints:\n  elbow: {x: 1.0e-3, encoder_zero: 0.01}\n  waist: {delta_theta: 2.0e-3}\n"
    )
    keys = {"file": "mine.yaml", "joints": {"elbow": {"x": 3e-3}}}
    scene = load_scene(own_three_axis(tmp_path, ""), {"calibration": keys})
    elbow = scene.calibration.deviations["elbow"]
    assert elbow.nonzero == {"x": 3e-3, "encoder_zero": 0.01}
    assert scene.calibration.deviations["waist"].nonzero == {"delta_theta": 2e-3}


@pytest.mark.slow
def test_encoders_report_their_zeros(tmp_path: Path) -> None:
    """Counts are those of the position with the zero; truth and stops are the joint's own."""
    zero = 0.01
    file = own_three_axis(tmp_path, "")
    overrides = {"calibration": {"joints": {"elbow": {"encoder_zero": zero}}}}
    plain, scene = Plant(load_scene(file)), load_scene(file, overrides)
    plant = Plant(scene)
    assert plant.state.q.tolist() == plain.state.q.tolist() == scene.start.tolist()
    more = plant.measured.encoder_counts - plain.measured.encoder_counts
    joint = scene.joints[2]
    per_rad = joint.counts_per_turn / (2.0 * np.pi * joint.gear.ratio)
    assert more[:2].tolist() == [0, 0]
    assert abs(more[2] - zero * per_rad) <= 1.0, "whole counts"
    with pytest.raises(Refusal, match=r"tool_mount.encoder_zero must belong to a joint"):
        load_scene(file, {"calibration": {"joints": {"tool_mount": {"encoder_zero": zero}}}})


def test_a_controller_corrects_its_description(tmp_path: Path) -> None:
    """With the machine's calibration it places the tool by what the encoders report."""
    rng = np.random.default_rng(3)
    file = own_three_axis(tmp_path, "")
    names = load_scene(file).joint_names
    joints = draw_deltas(rng, list(names))
    for joint in joints.values():
        joint |= {"encoder_zero": float(rng.normal(0.0, 0.02)), "delta_a": 1e-3}
    cal = tmp_path / "mine.yaml"
    lines = [f"  {name}: {{{', '.join(f'{k}: {v!r}' for k, v in fields.items())}}}\n"
             for name, fields in joints.items()]  # fmt: skip
    cal.write_text("joints:\n" + "".join(lines))
    scene = load_scene(file, {"calibration": {"file": "mine.yaml"}})
    zeros = np.array([joints[name]["encoder_zero"] for name in names])
    config = MotionConfig(tool=scene.tool, calibration=str(cal))
    corrected = make_controller(scene.urdf, names, config).kinematics
    nominal = make_controller(scene.urdf, names, replace(config, calibration="")).kinematics
    for q in rng.uniform(-1.0, 1.0, (10, 3)):
        place = tool_by_pinocchio(scene.true_urdf, scene, q)
        R_WT, p_WT = corrected.forward(q + zeros)
        assert p_WT == pytest.approx(place[:3, 3], abs=ROUNDING)
        assert pytest.approx(place[:3, :3], abs=ROUNDING) == R_WT
        assert np.linalg.norm(nominal.forward(q + zeros)[1] - place[:3, 3]) > 1e-3


def test_without_deviations_nothing_changes(tmp_path: Path) -> None:
    file = own_three_axis(tmp_path, "")
    plain = load_scene(file)
    for keys in ({}, {"joints": {}}, {"joints": {"elbow": {}}}, {"joints": {"elbow": {"x": 0.0}}}):
        scene = load_scene(file, {"calibration": keys})
        assert write_scene_unit(scene) == write_scene_unit(plain), f"{keys}: the same machine"
    assert plain.true_urdf == plain.urdf
    assert plain.calibration == Calibration()


def test_each_door_prints_the_calibration(tmp_path: Path) -> None:
    """The description that controllers get is nominal, what shows the machine is true."""
    overrides = {"calibration": {"joints": {"elbow": {"z": 0.01}}}}
    scene = load_scene(own_three_axis(tmp_path, ""), overrides)
    assert get_view(scene)["urdf_xml"] == scene.true_urdf != scene.urdf
    robot = parse_urdf(scene.urdf, "nominal")
    loaded = load_calibration_of(tmp_path, robot, scene.tool)
    assert loaded.deviations["elbow"].z == 0.01


def load_calibration_of(folder: Path, robot: ET.Element, tool: str) -> Calibration:
    (folder / "elbow.yaml").write_text("joints: {elbow: {z: 0.01}}")
    return load_calibration(folder / "elbow.yaml", robot, tool)
