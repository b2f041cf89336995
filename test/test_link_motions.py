"""Speeds of links are the derivatives of their poses; the tool's pose is that of the controller."""

import numpy as np
import pytest

from arm_emulator import Kinematics, load_scene
from arm_emulator.motion.model.link_motions import LinkMotions

H = 1e-6  # s, of central differences: rounding 1e-10, their own error below


@pytest.mark.parametrize("name", ["three_axis", "panda"])
def test_speeds_are_derivatives_and_the_tool_is_where_the_controller_has_it(name: str) -> None:
    rng, scene = np.random.default_rng(3), load_scene(name)
    links = LinkMotions(scene.urdf, scene.joint_names)
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    for _ in range(10):
        q, v = rng.uniform(-1.5, 1.5, (2, len(scene.joints)))
        poses = {}
        for sign in (-1, 1):
            links.place(q + sign * H * v, v)
            poses[sign] = {link: links.pose(link) for link in links.names}
        links.place(q, v)
        for link in links.names:
            (p0, o0), (p1, o1) = poses[-1][link], poses[1][link]
            linear, angular = links.twist(link)
            assert np.abs((p1 - p0) / (2 * H) - linear).max() < 1e-8
            o = links.pose(link)[1]
            rate = (o1 * np.sign(o1 @ o) - o0 * np.sign(o0 @ o)) / (2 * H)
            # The quaternion's rate is half the product of (omega, 0) and itself.
            expected = 0.5 * np.append(o[3] * angular + np.cross(angular, o[:3]), -angular @ o[:3])
            assert np.abs(rate - expected).max() < 1e-8
        if scene.tool in links.names:
            _, p_WT = kinematics.forward(q)
            assert np.abs(links.pose(scene.tool)[0] - p_WT).max() < 1e-12
