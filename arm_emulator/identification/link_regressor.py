"""Torques of the links as a linear map of their inertias, by Pinocchio."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from arm_emulator.identification.inertia import dynamic
from arm_emulator.identification.spring_torque import known_torque
from emulator_node.chain import Array
from emulator_node.scene import Scene


class LinkRegressor:
    """Torques at the joints of a scene's links for any motion: tau = Y(q, v, a) phi.

    phi has the ten numbers of `inertia.dynamic` for each moving link, with what is fixed to it and
    the payload, in the frames of `emulator_node.chain.ChainJoint`.
    """

    def __init__(self, scene: Scene) -> None:
        self.model = pin.Model()
        chain, parent = scene.chain, 0
        for joint in chain.joints:
            c, s = joint.cos_alpha, joint.sin_alpha
            tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
            c, s = math.cos(joint.theta_0), math.sin(joint.theta_0)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            slides = joint.kind == "prismatic"
            kind = pin.JointModelPZ() if slides else pin.JointModelRZ()
            parent = self.model.addJoint(parent, kind, pin.SE3(tilt @ turn, joint.p), joint.name)
        gravity = np.zeros(3) if scene.gravity is None else chain.R_BW @ scene.gravity
        self.model.gravity.linear = gravity
        self._data = self.model.createData()

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Return Y of every row: (K, N, 10 N)."""
        find, model, data = pin.computeJointTorqueRegressor, self.model, self._data
        rows = [find(model, data, *row).copy() for row in zip(q, v, a, strict=True)]
        N = self.model.nv
        return np.array(rows).reshape(len(q), N, 10 * N)


def torques_of_links(scene: Scene, regressor: LinkRegressor, q: Array, v: Array, a: Array) -> Array:
    """Return what a scene's gears put on the links in a motion (K, N) [N m or N].

    That is inertia, weight and friction of the links, less what springs at them do.
    """
    phi = np.concatenate([dynamic(joint.body) for joint in scene.chain.joints])
    tau: Array = regressor(q, v, a) @ phi
    for j, joint in enumerate(scene.joints):
        friction = joint.friction
        tau[:, j] += friction.viscous * v[:, j] + friction.coulomb * np.sign(v[:, j])
        tau[:, j] -= known_torque(joint, q[:, j])
    return tau
