"""Arms of which only the kinematics count."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from arm_emulator import JacobianController, Kinematics, Pose

CONFIG = Path(__file__).resolve().parents[2] / "config"

THREE_AXIS = (CONFIG / "urdf" / "three_axis.urdf").read_text()

NAMES = ("waist", "shoulder", "elbow")

START = np.array([0.0, 0.5, 0.8])


def three_axis(**arguments: float) -> JacobianController:
    return JacobianController(Kinematics(THREE_AXIS, NAMES, "tool"), **arguments)


def turning_chain(joints: int) -> str:
    """Revolute joints about z, y, x, z, ..., 0.3 m apart, the tool 0.3 m beyond the last."""
    parts = ['<robot name="chain"><link name="base"/>']
    parent = "base"
    for index in range(joints):
        axis = ("0 0 1", "0 1 0", "1 0 0")[index % 3]
        parts.append(
            f'<joint name="j{index}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{index}"/><origin xyz="0 0 0.3"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
            f'<link name="l{index}"><inertial><mass value="1"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        parent = f"l{index}"
    parts.append(
        f'<joint name="mount" type="fixed"><parent link="{parent}"/><child link="tool"/>'
        '<origin xyz="0.1 0 0.3"/></joint><link name="tool"/></robot>'
    )
    return "".join(parts)


def chain(joints: int, task: str = "auto") -> Kinematics:
    names = [f"j{index}" for index in range(joints)]
    return Kinematics(turning_chain(joints), names, "tool", task)


def arm(joints: int, **arguments: float) -> JacobianController:
    return JacobianController(chain(joints), **arguments)


def bent(joints: int, seed: int = 0) -> np.ndarray:
    """A pose far from singular ones."""
    return 0.7 + 0.3 * np.random.default_rng(seed).uniform(-1, 1, joints)


def pose_at(controller: JacobianController, q: np.ndarray) -> Pose:
    R_WT, p_WT = controller.kinematics.forward(q)
    return Pose(p_WT, R_WT)


def moved(pose: Pose, twist: np.ndarray) -> Pose:
    """The pose moved by a translation and a rotation vector along the world's axes."""
    turn = Rotation.from_rotvec(twist[3:]).as_matrix()
    return Pose(pose.p_WT + twist[:3], turn @ pose.R_WT)
