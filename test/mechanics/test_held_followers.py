"""Joints that follow one that is held: by the law of the description, position = multiplier times
that of the joint which they follow, plus offset (urdf/XML/joint, element mimic)."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from draws import some
from machines import write_scene

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.design.choose_joints import choose_joints
from oracles.random_chain import LINK

ARM = ("j1", "j2", "j3")
GRIPPER = ("grip", "finger_1", "finger_2", "finger_3", "finger_4")
PARENTS = {"grip": "j3", "finger_1": "grip", "finger_2": "j3", "finger_3": "j3", "finger_4": "j3"}


def robot(seed: int) -> tuple[str, dict[str, tuple[str, float, float]]]:
    """An arm with a gripper of one joint and four that follow it, and their laws.

    A chain: finger_1 follows grip, finger_2 finger_1, finger_3 finger_2; finger_4 follows grip.
    """
    rng = np.random.default_rng([seed, 15])
    text, parent = '<robot name="held"><link name="base"/>', "base"
    mimics = {}
    for name in (*ARM, *GRIPPER):
        kind = "prismatic" if name in GRIPPER and rng.random() < 0.5 else "revolute"
        parent = f"{PARENTS[name]}_link" if name in PARENTS else parent
        link = LINK.format(
            name=name, kind=kind, parent=parent, xyz="0.1 0.02 0.2", rpy="0.3 -0.2 0.5",
            axis="0 0.6 0.8", com="0 0 0.05", com_rpy="0 0 0", mass=0.5,
            ixx=0.01, iyy=0.01, izz=0.01, ixy=0, ixz=0, iyz=0,
        )  # fmt: skip
        inner = ""
        if name == "grip":
            low = float(rng.choice([-0.5, 0.05]))  # 0 is a position of it, or is not
            inner = f'<limit lower="{low}" upper="0.9" effort="1" velocity="1"/>'
        elif name in GRIPPER:
            of = {"finger_1": "grip", "finger_2": "finger_1", "finger_3": "finger_2"}.get(
                name, "grip"
            )
            factor, offset = rng.uniform(-2.0, 2.0, 2).round(3)
            mimics[name] = (of, float(factor), float(offset))
            inner = f'<mimic joint="{of}" multiplier="{factor}" offset="{offset}"/>'
        element = ET.fromstring(f"<all>{link}</all>")
        joint = element.find("joint")
        assert joint is not None
        for old in joint.findall("limit") if inner.startswith("<limit") else []:
            joint.remove(old)
        joint.extend(ET.fromstring(f"<more>{inner}</more>"))
        text += "".join(ET.tostring(child, encoding="unicode") for child in element)
        parent = f"{name}_link"
    return text + "</robot>", mimics


def positions(mimics: dict[str, tuple[str, float, float]], grip: float) -> dict[str, float]:
    """Return where the gripper's joints stand, one after the other."""
    result = {"grip": grip}
    for name, (of, factor, offset) in mimics.items():
        result[name] = factor * result[of] + offset
    return result


def placed(urdf: str, at: dict[str, float]) -> np.ndarray:
    """Return the places of the gripper's links in Pinocchio (5, 4, 4), with joints at positions."""
    model = pin.buildModelFromXML(urdf)
    data, q = model.createData(), pin.neutral(model)
    for name, value in at.items():
        if model.existJointName(name):
            q[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    return np.array([data.oMf[model.getFrameId(f"{name}_link")].homogeneous for name in GRIPPER])


def without_mimics(urdf: str) -> str:
    return re.sub(r"<mimic[^>]*/>", "", urdf)


@pytest.mark.parametrize("seed", some(range(200), 20))
def test_new_holds_those_that_follow_where_their_joint_takes_them(seed: int) -> None:
    urdf, mimics = robot(seed)
    holding = choose_joints(ET.fromstring(urdf), "robot", joints=ARM).locked
    low = float(ET.fromstring(urdf).findall("joint")[3].find("limit").get("lower"))  # type: ignore
    expected = positions(mimics, max(0.0, low))
    # Sums of four products, in another order.
    for name in GRIPPER:
        assert holding[name].position == pytest.approx(expected[name], rel=1e-12, abs=1e-12), name


def scene_of(folder: Path, urdf: str, locked: dict[str, float]) -> Scene:
    joints: dict[str, Any] = {name: {} for name in ARM}
    return load_scene(write_scene(folder, urdf, joints, tool="j3_link", locked=locked))


@pytest.mark.parametrize("seed", some(range(200), 20))
def test_a_refusal_names_the_position_of_the_law(seed: int, tmp_path: Path) -> None:
    """Followed to the letter, refusal by refusal, the links stand where Pinocchio has them."""
    urdf, mimics = robot(seed)
    grip = float(np.random.default_rng([seed, 16]).uniform(0.1, 0.8))
    locked = {"grip": grip}
    for _ in mimics:
        with pytest.raises(Refusal, match="must follow joints on the way") as refused:
            scene_of(tmp_path, urdf, locked)
        advice = re.search(r"locked: \{(\w+): (\S+)\}", str(refused.value.valid))
        assert advice, refused.value
        locked[advice[1]] = float(advice[2])
    scene = scene_of(tmp_path, urdf, locked)
    expected = placed(without_mimics(urdf), positions(mimics, grip))
    np.testing.assert_allclose(placed(scene.urdf, {}), expected, rtol=0.0, atol=1e-12)


def test_a_joint_that_follows_a_moving_joint_too_has_no_fixed_position(tmp_path: Path) -> None:
    urdf, _ = robot(0)
    couplings = {"finger_1": {"grip": 0.5, "j3": 1.0}}
    with pytest.raises(Refusal, match=r"follow joints on the way .*at a position of j3"):
        load_scene(
            write_scene(
                tmp_path, without_mimics(urdf), {name: {} for name in ARM}, tool="j3_link",
                locked=dict.fromkeys(("grip", *GRIPPER[2:]), 0.1), couplings=couplings,
            )
        )  # fmt: skip
