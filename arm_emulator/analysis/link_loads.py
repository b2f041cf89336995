"""Mass matrix and weight of the links over poses, by Pinocchio.

The bodies are the scene's own, payload and locked joints included.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from arm_emulator.machine.scene import Scene

Array = NDArray[np.float64]


class LinkLoads:
    """The links of a scene, by the angles of its shafts."""

    def __init__(self, scene: Scene) -> None:
        model = pin.Model()
        for joint in scene.chain.links:
            kind = pin.JointModelPZ() if joint.kind == "prismatic" else pin.JointModelRZ()
            at = pin.SE3(joint.R, joint.p)
            number = model.addJoint(joint.parent + 1, kind, at, joint.name)
            body = joint.body
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia
            # As they are about the joint: of a point, rounding leaves anything about its centre.
            numbers = np.array([body.mass, *body.moment, xx, xy, yy, xz, yz, zz])
            inertia = pin.Inertia.FromDynamicParameters(numbers)
            model.appendBodyToJoint(number, inertia, pin.SE3.Identity())
        gravity = np.array(scene.gravity or (0.0, 0.0, 0.0))
        model.gravity.linear = scene.chain.R_BW @ gravity
        self._model, self._data = model, model.createData()
        self._coupling = scene.chain.coupling

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q), (N, N)."""
        C = self._coupling.C
        M = pin.crba(self._model, self._data, self._joints(q))
        whole: Array = C.T @ (np.triu(M) + np.triu(M, 1).T) @ C
        return whole

    def weight(self, q: Array) -> Array:
        """Return the torques that hold the links at q, (N,) [N m or N]."""
        held = pin.computeGeneralizedGravity(self._model, self._data, self._joints(q))
        torque: Array = self._coupling.C.T @ held
        return torque

    def _joints(self, q: Array) -> Array:
        joints: Array = self._coupling.C @ q + self._coupling.offset
        return joints
