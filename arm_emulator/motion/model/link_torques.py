"""The torques that an arm's links need, by its robot description."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.urdf.shafts import Shafts
from arm_emulator.motion.model.pinocchio_model import JOINT, build_full_model


class LinkTorques(SharedObject):
    """Inverse dynamics of the links: gravity and motion.

    Rotors, gears and friction come in `ElasticArm`.

    Args:
        urdf_xml: the robot description, with masses.
        joint_names: the joints commanded, in the order of all arrays; the others stay at 0.
        gravity: acceleration of gravity along the world's axes (3,) [m/s2].

    Attributes:
        outboard: each joint commanded, those at the tips first, and the next ones farther out.

    Raises:
        Refusal: no robot description, or masses that are not taken.
    """

    def __init__(self, urdf_xml: str, joint_names: Sequence[str], gravity: Sequence[float]) -> None:
        self._model = build_full_model(urdf_xml, masses=True)
        self._model.gravity.linear = np.array(gravity, dtype=np.float64)
        self._data = self._model.createData()
        self._shafts = Shafts(urdf_xml, joint_names)
        names = self._shafts.joints
        joints = [self._model.joints[self._model.getJointId(JOINT + n)] for n in names]
        self._columns = np.array([joint.idx_v for joint in joints])
        self._square = np.ix_(self._columns, self._columns)
        self._neutral = pin.neutral(self._model)
        self.outboard = self._order_outboard(
            [self._model.getJointId(JOINT + n) for n in joint_names]
        )
        still = np.zeros(len(joint_names))
        if not np.isfinite(self.compute_torques(still, still)).all():
            raise Refusal("robot_description", "its masses", "be finite", "others")

    def compute_torques(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return the torques (N,) [N m] at angles [rad], speeds [rad/s], accelerations [rad/s2]."""
        configuration, full_v, full_a = self._expand_joints(
            q, v, np.zeros_like(v) if a is None else a
        )
        tau = pin.rnea(self._model, self._data, configuration, full_v, full_a)
        return self._shafts.convert_columns(np.asarray(tau[self._columns], dtype=np.float64))

    def compute_rates(self, q: Array, v: Array, a: Array, jerk: Array) -> tuple[Array, Array]:
        """Return the torques (N,) and their rates (N,) [N m/s], with jerks [rad/s3]."""
        expanded = self._expand_joints(q, v, a)
        by_q, by_v, M = pin.computeRNEADerivatives(self._model, self._data, *expanded)
        M = np.triu(M) + np.triu(M, 1).T  # it computes the upper half only
        v, a, jerk = (self._shafts.convert_rates(rate_of_joints) for rate_of_joints in (v, a, jerk))
        rate = by_q[self._square] @ v + by_v[self._square] @ a + M[self._square] @ jerk
        tau = np.asarray(self._data.tau[self._columns], dtype=np.float64)
        return self._shafts.convert_columns(tau), self._shafts.convert_columns(rate)

    def _order_outboard(self, numbers: list[int]) -> list[tuple[int, tuple[int, ...]]]:
        """Return `outboard` of the model's joints, whose numbers rise from the base outwards."""
        carried = [list[int]() for _ in numbers]
        for j, number in enumerate(numbers):
            inside = [ancestor for ancestor in self._model.supports[number] if ancestor != number]
            for ancestor in reversed(inside):
                if ancestor in numbers:
                    carried[numbers.index(ancestor)].append(j)
                    break
        order = sorted(range(len(numbers)), key=lambda j: -numbers[j])
        return [(j, tuple(carried[j])) for j in order]

    def _expand_joints(self, q: Array, v: Array, a: Array) -> list[Array]:
        """Return Pinocchio's configuration, speeds and accelerations, of all joints."""
        rows = np.zeros((3, self._model.nv))
        shafts = self._shafts
        rows[:, self._columns] = (
            shafts.convert_to_joints(q),
            shafts.convert_rates(v),
            shafts.convert_rates(a),
        )
        return [pin.integrate(self._model, self._neutral, rows[0]), rows[1], rows[2]]
