"""Machines for tests: URDFs and scenes made from a few numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from emulator_node.scene import Scene, load_scene

CONFIG = Path(__file__).resolve().parents[1] / "config"

LINK = """
  <joint name="{name}" type="{kind}">
    <origin xyz="{xyz}" rpy="{rpy}"/>
    <parent link="{parent}"/>
    <child link="{name}_link"/>
    <axis xyz="{axis}"/>
    <limit lower="-10" upper="10" effort="100" velocity="100"/>
  </joint>
  <link name="{name}_link">
    <inertial>
      <origin xyz="{com}" rpy="{com_rpy}"/>
      <mass value="{mass}"/>
      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="{ixz}" iyz="{iyz}"/>
    </inertial>
  </link>"""


def one_link_urdf(mass: float = 2.0, com: float = 0.3, inertia: float = 0.05) -> str:
    """A link that turns about y, its centre of mass at distance `com` along x."""
    return f"""<robot name="one_link"><link name="base"/>{
        LINK.format(
            name="joint", kind="continuous", xyz="0 0 0", rpy="0 0 0", parent="base", axis="0 1 0",
            com=f"{com} 0 0", com_rpy="0 0 0", mass=mass, ixx=inertia, iyy=inertia, izz=inertia,
            ixy=0, ixz=0, iyz=0,
        )
    }</robot>"""  # fmt: skip


def random_chain_urdf(rng: np.random.Generator, joints: int) -> str:
    """A chain of random joints about random axes, fixed joints with masses in between."""
    text, parent = '<robot name="random"><link name="base"/>', "base"
    for index in range(joints):
        for kind in ["fixed"] * int(rng.integers(0, 2)) + [
            str(rng.choice(["revolute", "continuous", "prismatic"], p=[0.4, 0.35, 0.25]))
        ]:
            name = f"{kind}_{index}"
            A = rng.normal(size=(3, 3))
            I = 0.02 * (A @ A.T + np.eye(3))  # noqa: E741
            text += LINK.format(
                name=name, kind=kind, parent=parent, xyz=_words(rng.normal(0, 0.2, 3)),
                rpy=_words(rng.uniform(-3, 3, 3)), axis=_words(rng.normal(size=3)),
                com=_words(rng.normal(0, 0.1, 3)), com_rpy=_words(rng.uniform(-3, 3, 3)),
                mass=rng.uniform(0.5, 3.0), ixx=I[0, 0], iyy=I[1, 1], izz=I[2, 2], ixy=I[0, 1],
                ixz=I[0, 2], iyz=I[1, 2],
            )  # fmt: skip
            parent = f"{name}_link"
    return text + "</robot>"


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def write_scene(folder: Path, urdf: str, joints: dict[str, Any], **keys: Any) -> Path:
    """Write a scene and its URDF into `folder` and return the scene's path."""
    (folder / "robot.urdf").write_text(urdf)
    data = {
        "name": folder.name,
        "urdf": "robot.urdf",
        "tool": "base",
        "supply_voltage": 48.0,
        "joints": joints,
        "integrator": {"scheme": "paper", "dt": 1e-4},
        "servo_period": 1e-3,
        **keys,
    }
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(data))
    return file


def random_chain(folder: Path, seed: int, joints: int, **keys: Any) -> Scene:
    """A random chain whose joints swing freely."""
    urdf = random_chain_urdf(np.random.default_rng(seed), joints)
    names = [n for n in pin.buildModelFromXML(urdf).names if n != "universe"]
    return load_scene(write_scene(folder, urdf, {name: {} for name in names}, **keys))


class Oracle:
    """The scene's links in Pinocchio, with the scene's joint order and plain joint angles."""

    def __init__(self, scene: Scene) -> None:
        self.model = pin.buildModelFromXML(scene.urdf)
        self.model.gravity.linear = np.array(scene.gravity or (0.0, 0.0, 0.0))
        self.data = self.model.createData()
        joints = [self.model.joints[self.model.getJointId(name)] for name in scene.joint_names]
        assert [joint.idx_v for joint in joints] == list(range(self.model.nv))
        self._joints = joints

    def configuration(self, q: np.ndarray) -> np.ndarray:
        """Pinocchio's q: cosine and sine for continuous joints."""
        out = np.zeros(self.model.nq)
        for joint, angle in zip(self._joints, q, strict=True):
            turns = joint.nq == 2
            out[joint.idx_q : joint.idx_q + joint.nq] = (
                (np.cos(angle), np.sin(angle)) if turns else angle
            )
        return out

    def aba(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        return pin.aba(self.model, self.data, self.configuration(q), v, tau)

    def energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """Kinetic and potential energy of the links."""
        at = self.configuration(q)
        kinetic = pin.computeKineticEnergy(self.model, self.data, at, v)
        return float(kinetic + pin.computePotentialEnergy(self.model, self.data, at))
