"""Torques of the links as a linear map of their inertias, by Pinocchio."""

import numpy as np
import pinocchio as pin

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import Scene, ShaftMotion
from arm_emulator_identification.inertia import list_dynamic

ROUNDS = 3  # iterations for friction that depends on the gear torque


class LinkRegressor:
    """Torques at the shafts of a scene's links for any motion: tau = Y(q, v, a) phi.

    phi has the ten numbers of `inertia.dynamic` for each moving link, with what is fixed to it and
    the payload, in the frames of `arm_emulator.machine.chain.ChainJoint`.
    """

    def __init__(self, scene: Scene) -> None:
        self.model = pin.Model()
        chain = scene.chain
        for joint in chain.links:
            slides = joint.kind == "prismatic"
            kind = pin.JointModelPZ() if slides else pin.JointModelRZ()
            at = pin.SE3(joint.R, joint.p)
            self.model.addJoint(joint.parent + 1, kind, at, joint.name)
        gravity = np.zeros(3) if scene.gravity is None else chain.R_BW @ scene.gravity
        self.model.gravity.linear = gravity
        self._data = self.model.createData()
        self._coupling = chain.coupling

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Return Y of every row: (K, N, 10 L), of N shafts and L links."""
        find, model, data = pin.computeJointTorqueRegressor, self.model, self._data
        C = self._coupling.C
        rows = np.empty((len(q), C.shape[1], 10 * len(C)))
        of_joints = q @ C.T + self._coupling.offset, v @ C.T, a @ C.T
        for k, row in enumerate(zip(*of_joints, strict=True)):
            # Of a single joint it comes as a vector.
            rows[k] = C.T @ np.reshape(find(model, data, *row), (len(C), -1))
        return rows


def compute_link_torques(scene: Scene, t: Array, q: Array, v: Array, a: Array) -> Array:
    """Return the torques of a scene's gears on the links in a motion (K, N) [N m or N].

    These are inertia and weight of the links, and the torques of the parts at them.
    """
    phi = np.concatenate([list_dynamic(joint.body) for joint in scene.chain.links])
    alone: Array = LinkRegressor(scene)(q, v, a) @ phi
    tau = alone.copy()
    none = np.zeros_like(t)
    for j, joint in enumerate(scene.joints):
        parts = [part for part in joint.parts if part.shaft == "link"]
        for _ in range(ROUNDS):
            at = ShaftMotion(t, q[:, j], v[:, j], a[:, j], tau[:, j], none, joint.gear.ratio)
            taken = (part.compute_effort(at) for part in parts)
            tau[:, j] = alone[:, j] + sum(effort for effort in taken if effort is not None)
    return tau
