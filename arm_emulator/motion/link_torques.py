"""The torques that an arm's links need, by its robot description."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.kinematics_model import JOINT, whole_model

FloatArray = npt.NDArray[np.float64]


class LinkTorques:
    """Inverse dynamics of the links: gravity, and what their motion takes.

    Rotors, gears and friction are the servo's business.

    Args:
        urdf_xml: the robot description, with masses.
        joint_names: the joints commanded, in the order of all arrays; the others stay at 0.
        gravity: acceleration of gravity along the world's axes (3,) [m/s2].

    Raises:
        Refusal: no robot description, or masses that are not taken.
    """

    def __init__(self, urdf_xml: str, joint_names: Sequence[str], gravity: Sequence[float]) -> None:
        self._model = whole_model(urdf_xml, masses=True)
        self._model.gravity.linear = np.array(gravity, dtype=np.float64)
        self._data = self._model.createData()
        joints = [self._model.joints[self._model.getJointId(JOINT + n)] for n in joint_names]
        self._columns = [joint.idx_v for joint in joints]
        self._neutral = pin.neutral(self._model)
        if not np.isfinite(self.at(np.zeros(len(joints)), np.zeros(len(joints)))).all():
            raise Refusal("robot_description", "its masses", "be finite", "others")

    def at(self, q: FloatArray, v: FloatArray, a: FloatArray | None = None) -> FloatArray:
        """Return the torques (N,) [N m] at angles [rad], speeds [rad/s], accelerations [rad/s2]."""
        full_v, full_a = np.zeros(self._model.nv), np.zeros(self._model.nv)
        full_v[self._columns] = v
        if a is not None:
            full_a[self._columns] = a
        step = np.zeros(self._model.nv)
        step[self._columns] = q
        configuration = pin.integrate(self._model, self._neutral, step)
        tau = pin.rnea(self._model, self._data, configuration, full_v, full_a)
        return np.asarray(tau[self._columns], dtype=np.float64)
