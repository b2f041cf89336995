"""Random chains and trees of links as URDFs."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from itertools import cycle
from typing import Any

import numpy as np

from arm_emulator.base.products import multiply_matrices

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


def write_slides(
    names: Iterable[str],
    axes: Iterable[str] = ("1 0 0",),
    kinds: Iterable[str] = ("prismatic",),
    com: str = "0 0 0",
) -> str:
    """Links of 2 kg on the base that do not feel each other, each along the next of the axes.

    Args:
        names: of the joints.
        axes: of the joints, in turn.
        kinds: of the joints, in turn.
        com: centre of mass of each link, in its frame [m].
    """
    text = '<robot name="slides"><link name="base"/>'
    for name, axis, kind in zip(names, cycle(axes), cycle(kinds), strict=False):
        text += LINK.format(
            name=name, kind=kind, xyz="0 0 0", rpy="0 0 0", parent="base", axis=axis,
            com=com, com_rpy="0 0 0", mass=2.0, ixx=0.1, iyy=0.1, izz=0.1, ixy=0, ixz=0, iyz=0,
        )  # fmt: skip
    return text + "</robot>"


def write_random_chain(rng: np.random.Generator, joints: int) -> str:
    """A chain of random joints about random axes, fixed joints with masses in between."""
    return _write_random_urdf(rng, joints, lambda links: links[-1])


def write_random_tree(rng: np.random.Generator, joints: int) -> str:
    """The same as a tree: each moving link hangs on any link before it, or on the base."""
    return _write_random_urdf(rng, joints, lambda links: str(rng.choice(links)))


def _write_random_urdf(
    rng: np.random.Generator, joints: int, hang: Callable[[list[str]], str]
) -> str:
    text, links = '<robot name="random"><link name="base"/>', ["base"]
    for index in range(joints):
        parent = hang(links)
        for kind in ["fixed"] * int(rng.integers(0, 2)) + [
            str(rng.choice(["revolute", "continuous", "prismatic"], p=[0.4, 0.35, 0.25]))
        ]:
            name = f"{kind}_{index}"
            A = rng.normal(size=(3, 3))
            I = 0.02 * (multiply_matrices(A, A.T) + np.eye(3))  # noqa: E741
            text += LINK.format(
                name=name, kind=kind, parent=parent, xyz=_join_values(rng.normal(0, 0.2, 3)),
                rpy=_join_values(rng.uniform(-3, 3, 3)), axis=_join_values(rng.normal(size=3)),
                com=_join_values(rng.normal(0, 0.1, 3)),
                com_rpy=_join_values(rng.uniform(-3, 3, 3)),
                mass=rng.uniform(0.5, 3.0), ixx=I[0, 0], iyy=I[1, 1], izz=I[2, 2], ixy=I[0, 1],
                ixz=I[0, 2], iyz=I[1, 2],
            )  # fmt: skip
            parent = f"{name}_link"
            links.append(parent)
    return text + "</robot>"


def list_moving_joints(urdf: str) -> list[str]:
    """Return the names of a robot's joints that are not fixed, in their order."""
    joints = ET.fromstring(urdf).findall("joint")
    return [joint.get("name", "") for joint in joints if joint.get("type") != "fixed"]


def _join_values(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
