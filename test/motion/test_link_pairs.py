"""Pairs of links without a test for contact: a planar arm of spheres, and the Panda's own SRDF."""

import math
import xml.etree.ElementTree as ET

import pytest

from arm_emulator import load_scene
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.collision.link_pairs import Reason, find_link_pairs

# Of the base and of the tool, 1 m and 1 m away from each other: they touch where the elbow is bent
# so far that 2 cos(angle / 2) is less than the radii's sum.
RADII = 0.1, 0.15
BENT = 2.0 * math.acos(0.5 * sum(RADII))
ELBOW = {
    "never": (-1.0, 1.0, 0.0, Reason.NEVER),
    "at times": (-math.pi, math.pi, 0.0, None),
    "at rest": (-0.1, 0.1, math.pi, Reason.DEFAULT),
    "but at rest": (0.0, 0.4, BENT - 1e-3, Reason.ALWAYS),
}


def sphere(radius: float, x: float) -> str:
    return (
        f'<collision><origin xyz="{x} 0 0"/><geometry><sphere radius="{radius}"/></geometry>'
        "</collision>"
    )


def planar(lower: float, upper: float, yaw: float) -> str:
    """A shoulder whose upper arm has no shape, an elbow, and a tool on the forearm."""
    limit = f'<axis xyz="0 0 1"/><limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
    return f"""<robot name="planar">
      <link name="base">{sphere(RADII[0], 0.0)}</link>
      <link name="upper"/>
      <link name="fore">{sphere(0.01, 0.5)}</link>
      <link name="tool">{sphere(RADII[1], 0.0)}</link>
      <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
        <axis xyz="0 0 1"/></joint>
      <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
        <origin xyz="1 0 0" rpy="0 0 {yaw}"/>{limit}</joint>
      <joint name="mount" type="fixed"><parent link="fore"/><child link="tool"/>
        <origin xyz="1 0 0"/></joint>
    </robot>"""


@pytest.mark.parametrize("case", ELBOW)
def test_reasons_of_a_planar_arm(case: str) -> None:
    lower, upper, yaw, reason = ELBOW[case]
    pairs = find_link_pairs(planar(lower, upper, yaw), ("shoulder", "elbow"), samples=1000)
    result = {pair[:2]: pair.reason for pair in pairs}
    # No shape stands between base and forearm.
    assert result.pop(("base", "fore")) == result.pop(("fore", "tool")) == Reason.ADJACENT
    assert result == ({} if reason is None else {("base", "tool"): reason})


def test_the_pairs_of_the_panda_are_those_of_its_makers() -> None:
    """The scene holds the fingers closed; the published file has them moving."""
    scene = load_scene("panda")
    ours = {
        pair[:2]: pair.reason.value for pair in find_link_pairs(scene.urdf, scene.joint_names, 2000)
    }
    folder = find_example_robot_data()
    assert folder is not None
    published = ET.parse(folder / "panda_description/srdf/panda.srdf").iter("disable_collisions")
    theirs = {
        (min(pair), max(pair)): element.get("reason")
        for element in published
        if (pair := (element.get("link1", ""), element.get("link2", "")))
    }
    second = {pair for pair in ours.keys() | theirs if ours.get(pair) != theirs.get(pair)}
    assert second == {
        ("panda_leftfinger", "panda_rightfinger"),
        ("panda_link5", "panda_rightfinger"),
    }
