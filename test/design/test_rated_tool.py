"""Drives that a description does not rate: sized for a tool, as makers rate their wrists."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from draws import some
from test_new_drives import untuned

from arm_emulator.design.new_scene import NewScene, write_new
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from oracles.own_robots import RobotPart, write_serial

__all__ = ["untuned"]  # a fixture
pytestmark = pytest.mark.usefixtures("untuned")

WRISTS = Path(__file__).parent / "wrists.csv"
WRIST = 3  # joints
FACTOR = 3.0  # of a published torque
G = 9.81


def rows() -> dict[str, list[dict[str, str]]]:
    """Return the published joints of each arm in the table, base to tool."""
    arms: dict[str, list[dict[str, str]]] = {}
    with WRISTS.open() as file:
        for row in csv.DictReader(file):
            arms.setdefault(row["arm"], []).append(row)
    return arms


ARMS = rows()


def described(name: str, joints: list[dict[str, str]]) -> str:
    """Return an arm of rods with the axes, lengths, masses and speeds of a published one."""
    parts = []
    for joint in joints:
        x, y, z = (float(joint[f"rod_{axis}"]) for axis in "xyz")
        axis = " ".join(joint[f"axis_{axis}"] for axis in "xyz")
        speed = float(joint["speed"])
        parts.append(RobotPart(axis, (x, y, z), float(joint["mass"]), velocity=speed))
    return write_serial(name, parts)


def make_new(folder: Path, text: str, payload: float | None) -> NewScene:
    """Return the scene of a description, with a payload."""
    folder.mkdir()
    file = folder / "arm.urdf"
    file.write_text(text)
    return write_new(file, folder / "new", payload=payload)


def shares(folder: Path, names: list[str], payload: bool | float) -> np.ndarray:
    """Return torques of wrists over the published ones, (arms, 3); True: the maker's payload."""
    out = []
    for name in names:
        joints = ARMS[name]
        rating = float(joints[0]["payload"]) if payload is True else payload
        mass = None if payload is False else float(rating)
        written = make_new(folder / f"{name}_{payload}", described(name, joints), mass)
        assert all(drive.notes["torque"].startswith("guess") for drive in written.drives)
        for motor in motors(written):
            assert motor.resistance <= 100.0 and 1e-5 < motor.inductance <= 0.1, name
            assert 0.01 < motor.torque_constant < 2.0, name
        torques = [drive.peak_torque for drive in written.drives[-WRIST:]]
        out.append([T / float(j["torque"]) for T, j in zip(torques, joints[-WRIST:], strict=True)])
    return np.array(out)


def motors(written: NewScene) -> Iterator[DcMotor]:
    """Yield the motors of a scene."""
    for drive in written.drives:
        assert isinstance(drive.joint.motor, DcMotor)
        yield drive.joint.motor


@pytest.mark.slow
def test_wrists_are_as_strong_as_makers_build_them(tmp_path: Path) -> None:
    """The torques that we choose for wrists are within a factor of 3 of those that makers publish.

    The 25 arms carry payloads from 3 to 600 kg. This holds for nine of ten arms, at each joint of
    the wrist.
    """
    names = some(sorted(ARMS), 10)
    share = shares(tmp_path, names, payload=True)
    within = (np.maximum(share, 1.0 / share) < FACTOR).mean(axis=0)
    assert (within >= 0.9).all(), dict(zip(names, share.round(2).tolist(), strict=True))
    # Without a tool the last joint turns a flange.
    assert (shares(tmp_path, names[:3], payload=0.0)[:, -1] < 0.1).all()


@pytest.mark.slow
def test_without_a_payload_wrists_follow_from_the_arm(tmp_path: Path) -> None:
    """Payloads of arms of one mass and speed differ by a factor of 1.6, their torques by more."""
    names = some(sorted(ARMS), 10)
    share = shares(tmp_path, names, payload=False)
    within = (np.maximum(share, 1.0 / share) < FACTOR).mean(axis=0)
    assert (within >= 0.8).all(), dict(zip(names, share.round(2).tolist(), strict=True))


@pytest.mark.parametrize("axis", ["1 0 0", "-1 0 0"])
@pytest.mark.parametrize("payload", [0.5, 7.0, 200.0])
def test_a_flange_that_rolls_holds_and_rotates_a_cube_beside_its_axis(
    payload: float, axis: str, tmp_path: Path
) -> None:
    """In closed form: a cube as dense as water, half an edge off the axis and off the flange."""
    speed = 4.0
    parts = [
        RobotPart("0 1 0", (1.0, 0.0, 0.0), 30.0),
        RobotPart(axis, (0.1, 0.0, 0.0), 1e-6, velocity=4.0),
    ]
    written = make_new(tmp_path / "roll", write_serial("roll", parts), payload)
    a = (payload / 1000.0) ** (1.0 / 3.0)
    static, dynamic = payload * G * a / 2.0, payload * (a**2 / 4.0 + a**2 / 6.0)
    # The heaviest of the poses drawn is not quite the horizontal one.
    expected = 1.3 * static + dynamic * speed / 0.25
    assert written.drives[1].peak_torque == pytest.approx(expected, rel=0.02)
    # The first joint holds it beyond the flange; both its directions are drawn.
    (tool,) = written.tools
    assert tool.centre[0] == pytest.approx(a / 2.0) and math.hypot(
        *tool.centre[1:]
    ) == pytest.approx(a / 2.0)
    assert tool.mass == payload and tool.link == "tool0"


def test_a_last_joint_that_bends_the_arm_holds_its_tool_at_the_end(tmp_path: Path) -> None:
    parts = [RobotPart("0 1 0", (0.5, 0.0, 0.0), 5.0), RobotPart("0 1 0", (0.3, 0.0, 0.0), 1e-6)]
    written = make_new(tmp_path / "bend", write_serial("bend", parts), 8.0)
    np.testing.assert_allclose(written.tools[0].centre, [0.1, 0.1, 0.0], atol=1e-9)


def test_both_arms_of_a_tree_have_tools_and_fingers_have_none(tmp_path: Path) -> None:
    left = write_serial("two", [RobotPart("0 1 0", (0.3, 0.0, 0.0), 4.0, velocity=3.0)] * 4)
    right = left
    for k in range(4, 0, -1):
        right = right.replace(f'"l{k}"', f'"r{k}"').replace(f'"j{k}"', f'"i{k}"')
    inner = right.split("</joint>", 1)[1].split('<link name="tool0">')[0]
    finger = (
        '<link name="finger"><inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4"'
        ' izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="finger"'
        ' type="prismatic"><parent link="l4"/><child link="finger"/><axis xyz="0 1 0"/>'
        '<limit lower="0" upper="0.05" effort="20" velocity="0.1"/></joint>'
    )
    file = tmp_path / "two.urdf"
    file.write_text(left.replace("</robot>", f"{inner}{finger}</robot>"))
    written = write_new(file, tmp_path / "new", tree=True, tool="tool0")
    assert [tool.link for tool in written.tools] == ["tool0", "r4"]
    torques = {drive.joint.name: drive.peak_torque for drive in written.drives}
    # The right arm has no frame at its end: its tool is 0.3 m nearer to the joints.
    assert 0.5 * torques["j2"] < torques["i2"] < torques["j2"]
    assert written.tools[1].mass == pytest.approx(written.tools[0].mass, rel=0.02), "a finger more"
